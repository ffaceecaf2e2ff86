"""Margin of a cell: how far beyond what it owns it reads.

A chain of neighbourhood steps is exact at a seam only with the sum of their reaches. Each step
states its own reach; tasks carry the margin in their arguments.
"""

from spl_batch.airborne.classes import buildings
from spl_batch.airborne.filter import denoise
from spl_batch.airborne.noise import haze
from spl_batch.airborne.products import surface_rasters
from spl_batch.airborne.products.reflectance import reflectance
from spl_batch.airborne.settings.workflow import Workflow


def halo_m(workflow: Workflow) -> float:
    """Margin of a cell of ``denoise``: reaches of the filter and of noise in air, added up [m]."""
    air = denoise.asks_for_air(workflow.filter, workflow.noise)
    return denoise.reach_m(workflow.filter) + (haze.REACH_M if air else 0.0)


def surface_reach_m(workflow: Workflow) -> float:
    """Margin that a ground cell's rasters read [m]."""
    reaches = [surface_rasters.reach_m(workflow.products), reflectance.reach_m(workflow.products)]
    return max(*reaches, buildings.REACH_M if workflow.classes.building else 0.0)
