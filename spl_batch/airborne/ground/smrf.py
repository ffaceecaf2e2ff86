"""Simple morphological filter [Pingel, Clarke & McBride 2013].

| source | here |
|---|---|
| ZImin, grid of lowest heights | the caller's: layer means, which low noise does not pull down |
| low outliers, opening of the inverted grid | the caller's: nodes far below those around |
| inpainting of empty cells | :func:`fill_gaps` |
| progressive opening, threshold slope x radius | :func:`.object_cells` |
| disk of radius k | an octagon of radius k (:func:`.octagon`) |

Deviations: gaps are filled by a TIN through their rims rather than by a partial
differential equation, which differs only inside the gap; an octagon costs what its
radius is, not its area.
"""

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from spl_batch.airborne.ground.morphology import object_cells
from spl_batch.numerics.nearest_cells import nearest_cells
from spl_batch.numerics.triangulation.tin import interpolate, triangulate

_JITTER_CELLS = np.finfo(np.float32).eps
"""Twice the largest step aside of a grid node in a triangulation: seen in double precision, and far
below what any height is known by [cells]."""

Grid = NDArray[np.float64]


def fill_gaps(surface: Grid) -> Grid:
    """Surface without gaps: a TIN through the rims of its gaps, level beyond its hull.

    Parameters
    ----------
    surface : (rows, columns) float64
        Heights [m]; NaN in gaps, not everywhere.

    Returns
    -------
    (rows, columns) float64
    """
    gaps = np.isnan(surface)
    if not gaps.any():
        return surface
    filled: Grid = surface[nearest_cells(~gaps)]
    rim = ~gaps & ndimage.binary_dilation(gaps, structure=np.ones((3, 3), dtype=np.bool_))
    row, column = np.nonzero(rim)
    place = np.column_stack([column, row]) + _jitter(surface[rim])
    tin = triangulate(np.column_stack([place, surface[rim]]))
    if tin is None:
        return filled
    row, column = np.nonzero(gaps)
    inside = interpolate(tin, column.astype(np.float64), row.astype(np.float64))
    filled[gaps] = np.where(np.isnan(inside), filled[gaps], inside)
    return filled


def _jitter(height: NDArray[np.float64]) -> NDArray[np.float64]:
    """Small steps aside that heights alone decide: (n, 2) [cells].

    Four corners of a square have two Delaunay triangulations; which one Qhull takes may
    depend on points far away. Steps aside leave one, in whatever cutout a cell is seen.
    """
    turns = height[:, None] * np.array([1e3 * np.sqrt(2.0), 1e3 * np.sqrt(3.0)])
    steps: NDArray[np.float64] = _JITTER_CELLS * (turns - np.floor(turns) - 0.5)
    return steps


def provisional_terrain(lowest: Grid, cell_m: float, slope: float, window_m: float) -> Grid:
    """Terrain model from which points are judged.

    Parameters
    ----------
    lowest : (rows, columns) float64
        Lowest heights [m]; NaN where there are none, not everywhere.
    cell_m : float
        Edge of a cell [m].
    slope : float
        Tolerated slope [rise/run].
    window_m : float
        Largest radius of the window [m].

    Returns
    -------
    (rows, columns) float64
    """
    surface = fill_gaps(lowest)
    objects = object_cells(surface, cell_m, slope, window_m)
    bare = np.where(objects | np.isnan(lowest), np.nan, surface)
    return fill_gaps(bare) if not np.isnan(bare).all() else surface
