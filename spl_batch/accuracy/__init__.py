"""Rasters against reference linear-mode lidar: differences by class of surface, statistics.

Differences are raster minus reference [m]. They are gathered over any number of chunks of
reference points (:func:`terrain_differences`, :func:`surface_differences`, :func:`merge`)
and summed up once (:func:`accuracy_report`): medians cannot be merged, differences can.
"""

from spl_batch.accuracy.differences import (
    Differences,
    difference_raster,
    merge,
    surface_differences,
    terrain_differences,
)
from spl_batch.accuracy.located import Raster, Reference
from spl_batch.accuracy.summary import STATISTICS, accuracy_report, statistics

__all__ = [
    "STATISTICS",
    "Differences",
    "Raster",
    "Reference",
    "accuracy_report",
    "difference_raster",
    "merge",
    "statistics",
    "surface_differences",
    "terrain_differences",
]
