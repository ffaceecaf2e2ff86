"""Surfaces as rasters, and many surfaces as one: cells lie on whole multiples of their edge.

They count from where easting and northing are 0, wherever the local frame begins: cells of
acquisitions from several places fit onto each other. Rows count from the south, as in
:mod:`spl_batch.numerics.triangulation.tin_raster`.

Deviation: the source's raster is the array itself, whose pixels lie unevenly on the water. Here
cells are equal, and take their depth from the triangles between pixels.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spl_batch.numerics.triangulation.tin_raster import tin_raster

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Grid:
    """Cells of a raster."""

    #: east, north: of the south-west corner [cell], counted from easting and northing 0.
    east: int
    north: int
    rows: int
    cols: int
    cell_m: float
    #: Easting and northing of the local frame's origin [m].
    origin_m: tuple[float, float] = (0.0, 0.0)


def grid_around(
    places_m: Floats, cell_m: float, origin_m: tuple[float, float] = (0.0, 0.0)
) -> Grid | None:
    """Smallest grid around places, north, east, down [m]; None where none is known.

    ``origin_m``: easting and northing of the local frame's origin [m].
    """
    known = places_m[np.isfinite(places_m).all(axis=-1)]
    if not len(known):
        return None
    place_m = known[:, 1::-1] + np.array(origin_m)
    low = np.floor(place_m.min(axis=0) / cell_m).astype(np.int64)
    high = np.floor(place_m.max(axis=0) / cell_m).astype(np.int64) + 1
    cols, rows = (int(n) for n in high - low)
    return Grid(int(low[0]), int(low[1]), rows, cols, cell_m, origin_m)


def height_raster(places_m: Floats, grid: Grid) -> Floats:
    """Heights (less down) at the centres of cells: (rows, cols) float64 [m], NaN where unknown.

    ``places_m``: north, east, down [m]; NaN where unknown. ``grid``: where to.
    """
    known = places_m[np.isfinite(places_m).all(axis=-1)]
    corner = grid.cell_m * np.array([grid.east, grid.north]) - np.array(grid.origin_m)
    vertices = np.column_stack([known[:, 1] - corner[0], known[:, 0] - corner[1], -known[:, 2]])
    # Pixels are about evenly spaced: a centre farther than a few spacings lies outside.
    area = grid.rows * grid.cols * grid.cell_m**2
    reach = max(3.0 * math.sqrt(area / max(len(known), 1)), 1.5 * grid.cell_m)
    return tin_raster(vertices, grid.cell_m, (grid.rows, grid.cols), reach)
