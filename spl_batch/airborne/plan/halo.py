"""Halo of each unit: how far beyond what it owns a block or a ground cell reads.

A chain of neighbourhood steps is exact at a seam only with the sum of their reaches. Each step
says its own reach; tasks carry the halo in their arguments.
"""

from spl_batch.airborne.classes import buildings
from spl_batch.airborne.filter import denoise
from spl_batch.airborne.noise import haze
from spl_batch.airborne.products import surface_rasters
from spl_batch.airborne.products.reflectance import reflectance
from spl_batch.airborne.settings.workflow import Workflow


def halo_m(workflow: Workflow) -> float:
    """Halo of a denoise block: the sum of the reaches of the filter and of the noise in air [m]."""
    air = denoise.asks_for_air(workflow.filter, workflow.noise)
    return denoise.reach_m(workflow.filter) + (haze.REACH_M if air else 0.0)


def filter_reach_m(workflow: Workflow) -> float:
    """What of its halo the filter itself looks at [m]."""
    return denoise.reach_m(workflow.filter)


def surface_reach_m(workflow: Workflow) -> float:
    """Margin that a ground cell's rasters read [m]."""
    reaches = [surface_rasters.reach_m(workflow.products), reflectance.reach_m(workflow.products)]
    return max(*reaches, buildings.REACH_M if workflow.classes.building else 0.0)
