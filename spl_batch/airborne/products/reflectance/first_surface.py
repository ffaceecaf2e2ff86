"""The surface that beams meet first, for the rays of beamlets that were not seen.

Domain: space. A raster of heights and slopes. It is not the DSM, but the median of the first
returns of a cell, whatever is below them, without what noise has left in the air.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.products.cell_values import fill_voids, ring_offsets, sort_into_cells
from spl_batch.airborne.products.reflectance.exposed_cells import COARSE, Grid
from spl_batch.airborne.settings import ProductSettings
from spl_batch.constants import QUANTUM_M

ALIKE_CELLS: Final = 2.0
"""Neighbouring cells no farther apart in height than this are of one surface [cells]."""

SUPPORT_SHARE: Final = 0.05
"""First returns that a surface has at least, in shares of the ordinary one."""

NEAR_SURE_M: Final = 15.0
"""Sideways and upwards, how far a surface in doubt may be from a sure one [m]."""


def first_surface(
    cell: NDArray[np.int64],
    z: NDArray[np.int32],
    shape: tuple[int, int],
    settings: ProductSettings,
) -> Grid:
    """Median height of the first returns of each cell, small voids filled, and its slope.

    ``cell, z``: cell of each first return, row by row, and its height [quanta].
    """
    rows, cols = shape
    order, start = sort_into_cells(cell, z, rows * cols)
    count = np.diff(start)
    median = np.full(rows * cols, np.nan)
    used = np.flatnonzero(count)
    median[used] = z[order[start[used] + (count[used] - 1) // 2]] * QUANTUM_M
    credible = credible_heights(median.reshape(shape), count.reshape(shape), settings.cell_m)
    height = np.empty(shape)
    reach = settings.dsm_void_max_m / settings.cell_m
    fill_voids(credible, ring_offsets(reach), height)
    low, high = (bounds(height, keep) for keep in (np.fmin, np.fmax))
    return Grid(settings.cell_m, height, slopes(height, settings.cell_m), low, high)


def credible_heights(
    height: NDArray[np.float64], count: NDArray[np.int64], cell_m: float
) -> NDArray[np.float64]:
    """Heights of cells without those where noise may be taken for a surface (NaN).

    A surface goes on in at least two of the eight neighbours. Where few returns support it, it is
    dark, or few beamlets were fired at it: then it is no farther than :data:`NEAR_SURE_M` above or
    below the nearest sure one.
    """
    padded = np.pad(height, 1, constant_values=np.nan)
    returns = np.pad(count, 1)
    rows, cols = height.shape
    like, support = np.zeros(height.shape, dtype=np.int64), count.copy()
    for dr, dc in ring_offsets(1.5)[:, :2]:
        there = slice(1 + dr, 1 + dr + rows), slice(1 + dc, 1 + dc + cols)
        alike = np.abs(padded[there] - height) <= ALIKE_CELLS * cell_m
        like += alike
        support += np.where(alike, returns[there], 0)
    usual = float(count.sum()) / max(int(np.count_nonzero(count)), 1)
    goes_on = like >= 2
    sure = goes_on & (support >= SUPPORT_SHARE * 9 * usual)
    nearest = np.empty(height.shape)
    fill_voids(np.where(sure, height, np.nan), ring_offsets(NEAR_SURE_M / cell_m), nearest)
    beside = np.abs(height - nearest) <= NEAR_SURE_M
    return np.where(sure | (goes_on & beside), height, np.nan)


def slopes(height: NDArray[np.float64], cell_m: float) -> NDArray[np.float64]:
    """Gradient of a surface that does not look across edges, to east and north: (., ., 2).

    Along each axis the flatter of the steps to both neighbours counts, and none where they lead to
    opposite sides: beside a wall it is that of the roof, in a crown it is small.
    """
    out = np.zeros((*height.shape, 2))
    for k, axis in enumerate((1, 0)):
        if height.shape[axis] < 2:
            continue
        step = np.diff(height, axis=axis) / cell_m
        edge = [(0, 0), (0, 0)]
        edge[axis] = (1, 0)
        behind = np.pad(step, edge, constant_values=np.nan)
        edge[axis] = (0, 1)
        ahead = np.pad(step, edge, constant_values=np.nan)
        behind, ahead = (
            np.where(np.isnan(behind), ahead, behind),
            np.where(np.isnan(ahead), behind, ahead),
        )
        flat = np.where(np.abs(behind) < np.abs(ahead), behind, ahead)
        out[..., k] = np.where(behind * ahead > 0, flat, 0.0)
    return out


def bounds(height: NDArray[np.float64], keep: np.ufunc) -> NDArray[np.float64]:
    """Lowest or highest of the cells in and around each coarse square."""
    rows, cols = height.shape
    padded = np.pad(height, ((0, -rows % COARSE), (0, -cols % COARSE)), constant_values=np.nan)
    coarse = padded.reshape(padded.shape[0] // COARSE, COARSE, -1, COARSE)
    square: NDArray[np.float64] = keep.reduce(keep.reduce(coarse, axis=3), axis=1)
    for axis in (0, 1):
        edge = [(0, 0), (0, 0)]
        edge[axis] = (1, 1)
        around = np.pad(square, edge, constant_values=np.nan)
        n = square.shape[axis]
        taken = [np.take(around, np.arange(k, k + n), axis=axis) for k in range(3)]
        square = keep(keep(taken[0], taken[1]), taken[2])
    return square
