"""Rasters against reference linear-mode lidar: differences by class of surface, statistics.

Differences are raster minus reference [m]. Each place finds its own
(:mod:`~spl_batch.airborne.accuracy.differences`) and counts them by size; counts are added up and
summed up once (:mod:`~spl_batch.airborne.accuracy.error_tally`).
"""
