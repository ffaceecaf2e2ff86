"""Rasters against reference linear-mode lidar: differences by class of surface, statistics.

Differences are raster minus reference [m]. Each place finds its own
(:func:`terrain_differences`, :func:`surface_differences`) and counts them by size
(:class:`Tally`); counts are added up (:func:`add_up`) and summed up once
(:func:`accuracy_report`): medians cannot be merged, counts can.
"""

from spl_batch.airborne.accuracy.accuracy_report import accuracy_report
from spl_batch.airborne.accuracy.differences import (
    Differences,
    difference_sums,
    ground_differences,
    return_differences,
    surface_differences,
    terrain_differences,
)
from spl_batch.airborne.accuracy.error_tally import STEPS_PER_M, Tallies, Tally, add_up, tallies
from spl_batch.airborne.accuracy.raster_and_reference import Grid, Raster, Reference
from spl_batch.numerics.error_statistics import STATISTICS, statistics

__all__ = [
    "STATISTICS",
    "STEPS_PER_M",
    "Differences",
    "Grid",
    "Raster",
    "Reference",
    "Tallies",
    "Tally",
    "accuracy_report",
    "add_up",
    "difference_sums",
    "ground_differences",
    "return_differences",
    "statistics",
    "surface_differences",
    "tallies",
    "terrain_differences",
]
