"""Points in raster cells: order inside cells, robust means, supported tops, void filling.

Cells are numbered ``row * cols + col``, row 0 being the *southernmost*; the stage turns the
finished raster north up. Coordinates are integer differences to the corner of the raster, so every
comparison is exact and the order of points does not matter.
"""

import numpy as np
from numpy.typing import NDArray

from spl_batch.constants import NODATA
from spl_batch.lattice.tables import PointTable
from spl_batch.lattice.tiles import Bounds
from spl_batch.numerics.compiled import njit
from spl_batch.numerics.nearest_cells import distances
from spl_batch.numerics.sorting import sort

Places = tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int32]]
"""Easting, northing and height of points [quanta]."""


def sort_into_cells(
    cell: NDArray[np.int64], z: NDArray[np.int32], cells: int
) -> tuple[NDArray[np.intp], NDArray[np.int64]]:
    """Order points by cell, highest first inside each.

    Of fewer than 2**32 points, by ``cell`` (n,) of fewer than 2**31: their ``order``, and where
    each cell begins in it, ``start`` (cells + 1,).
    """
    order = np.empty(len(cell), dtype=np.intp)
    start = np.zeros(cells + 1, dtype=np.int64)
    _sort_into_cells(cell, z, start, order)
    return order, start


@njit()
def _sort_into_cells(
    cell: NDArray[np.int64],
    z: NDArray[np.int32],
    start: NDArray[np.int64],
    order: NDArray[np.intp],
) -> None:
    """Counting sort by cell, then each cell's points by height and, where these are equal, row."""
    for c in cell:
        start[c + 1] += 1
    for c in range(len(start) - 1):
        start[c + 1] += start[c]
    after, key = np.empty(len(start) - 1, np.int64), np.empty(len(cell), np.int64)
    for c in range(len(after)):
        after[c] = start[c]
    for i in range(len(cell)):
        # ~z falls as z rises, and fits into the upper half for any z.
        key[after[cell[i]]] = (np.int64(~z[i]) << np.int64(32)) | np.int64(i)
        after[cell[i]] += 1
    for c in range(len(start) - 1):
        sort(key[start[c] : start[c + 1]])
    for i in range(len(key)):
        order[i] = key[i] & np.int64(0xFFFF_FFFF)


@njit()
def _spread2(z: NDArray[np.int32], begin: int, end: int, middle2: np.int64) -> np.int64:
    """Lower median of ``|2 z - middle2|`` over a run sorted by falling height."""
    n = end - begin
    right = begin + n // 2
    left = right - 1
    deviation = np.int64(0)
    for _ in range((n + 1) // 2):
        above = 2 * np.int64(z[left]) - middle2 if left >= begin else np.int64(2**62)
        below = middle2 - 2 * np.int64(z[right]) if right < end else np.int64(2**62)
        if above <= below:
            deviation = above
            left -= 1
        else:
            deviation = below
            right += 1
    return deviation


@njit()
def robust_cell_means(
    xyz: Places,
    start: NDArray[np.int64],
    floor: float,
    means: NDArray[np.float64],
) -> None:
    """Mean position of the returns of each cell without its outliers in height.

    A return counts within 3 robust standard deviations (1.4826 times the lower median absolute
    deviation) of the cell's median height, and always within ``floor`` [quanta]. Both bounds are
    symmetric, so nothing of a tilted plane is cut on one side; with means of x and y the mean lies
    on the plane. Sums are integers: exact in any order. ``xyz`` in the order of
    :func:`sort_into_cells`; ``means`` (cells, 3), NaN in cells without returns [quanta].
    """
    x, y, z = xyz
    for cell in range(len(start) - 1):
        begin, end = start[cell], start[cell + 1]
        n = end - begin
        if n == 0:
            for axis in range(3):
                means[cell, axis] = np.nan
            continue
        middle2 = np.int64(z[begin + (n - 1) // 2]) + np.int64(z[begin + n // 2])
        limit2 = max(3.0 * 1.4826 * _spread2(z, begin, end, middle2), 2.0 * floor)
        count, sx, sy, sz = 0, np.int64(0), np.int64(0), np.int64(0)
        for p in range(begin, end):
            if abs(2 * np.int64(z[p]) - middle2) <= limit2:
                count += 1
                sx += x[p]
                sy += y[p]
                sz += z[p]
        means[cell, 0] = sx / count
        means[cell, 1] = sy / count
        means[cell, 2] = sz / count


def ring_offsets(reach_cells: float) -> NDArray[np.int64]:
    """Steps to the cells within a distance between centres [cells], nearest first: (m, 3).

    In rows, in columns, and the squared distance; the cell itself is left out.
    """
    reach = int(reach_cells)
    side = np.arange(-reach, reach + 1, dtype=np.int64)
    dr, dc = (a.ravel() for a in np.meshgrid(side, side, indexing="ij"))
    d2 = dr * dr + dc * dc
    near = (d2 > 0) & (d2 <= reach_cells * reach_cells)
    table = np.stack([dr[near], dc[near], d2[near]], axis=1)
    return table[np.lexsort([table[:, 1], table[:, 0], table[:, 2]])]


def fill_voids(values: NDArray[np.float64], reach_cells: float) -> NDArray[np.float64]:
    """Give each empty cell (NaN) the value of its nearest filled one, of several the lowest.

    No height between two neighbours is invented: an occluded strip beside a wall belongs to the
    roof or to the ground, never to something half way up. NaN stays where the centre of none is
    within ``reach_cells``.
    """
    filled, empty = values.copy(), np.isnan(values)
    if empty.all():
        return filled
    # Squares of distances are whole numbers.
    away2, offsets = np.rint(distances(~empty) ** 2), ring_offsets(reach_cells)
    row, col = np.nonzero(empty & (away2 <= reach_cells * reach_cells))
    of_void, rim = away2[row, col], int(reach_cells)
    padded = np.pad(values, rim, constant_values=np.nan)
    for d2 in np.unique(of_void):
        at = row[of_void == d2], col[of_void == d2]
        for dr, dc in offsets[offsets[:, 2] == d2, :2]:
            # fmin prefers what is not NaN
            filled[at] = np.fmin(filled[at], padded[at[0] + rim + dr, at[1] + rim + dc])
    return filled


def shape_of(bounds: Bounds, size: int) -> tuple[int, int]:
    """Rows and columns of raster cells of an edge [quanta]."""
    return (bounds.ymax - bounds.ymin) // size, (bounds.xmax - bounds.xmin) // size


def cell_number(table: PointTable, bounds: Bounds, size: int) -> NDArray[np.int64]:
    """Number of the raster cell of each point within bounds, row by row from the south-west."""
    number = table["y"] - bounds.ymin
    number //= size
    number *= shape_of(bounds, size)[1]
    number += (table["x"] - bounds.xmin) // size
    return number


def by_cell(
    table: PointTable, bounds: Bounds, size: int
) -> tuple[Places, NDArray[np.int64], NDArray[np.intp]]:
    """Points within bounds by raster cell, the highest first in each.

    Their places from the corner of the bounds [quanta], where each cell begins in them, and their
    order, as :func:`sort_into_cells` has both.
    """
    rows, cols = shape_of(bounds, size)
    order, start = sort_into_cells(cell_number(table, bounds, size), table["z"], rows * cols)
    x, y = (table["x"].take(order) - bounds.xmin, table["y"].take(order) - bounds.ymin)
    return (x.astype(np.int32), y.astype(np.int32), table["z"].take(order)), start, order


def north_up(values: NDArray[np.float64]) -> NDArray[np.float32]:
    """Raster cells from the south as they are delivered: row 0 northernmost, nodata for NaN."""
    return np.ascontiguousarray(np.where(np.isnan(values), NODATA, values)[::-1], np.float32)


def owned(core: Bounds, edge: int) -> Bounds:
    """Columns and rows of the squares whose centres lie in a region; each has one owner."""
    return Bounds(*(-(-(side - edge // 2) // edge) for side in core))


def held(
    x: NDArray[np.int64], y: NDArray[np.int64], squares: Bounds, edge: int
) -> NDArray[np.bool_]:
    """Which squares hold a place, row 0 southernmost: (rows, columns) bool."""
    found = np.zeros(shape_of(squares, 1), np.bool_)
    row, column = y // edge - squares.ymin, x // edge - squares.xmin
    there = (row >= 0) & (row < found.shape[0]) & (column >= 0) & (column < found.shape[1])
    found[row[there], column[there]] = True
    return found


def at_centres(
    cells: NDArray[np.bool_], core: Bounds, squares: Bounds, edge: int
) -> NDArray[np.bool_]:
    """What cells that make up a region hold at the centres of the squares that it owns."""
    size = (core.xmax - core.xmin) // cells.shape[1]
    x = np.arange(squares.xmin, squares.xmax) * edge + edge // 2
    y = np.arange(squares.ymin, squares.ymax) * edge + edge // 2
    found: NDArray[np.bool_] = cells[np.ix_((y - core.ymin) // size, (x - core.xmin) // size)]
    return found
