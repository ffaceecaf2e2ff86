"""Nearest cell of a grid that holds something, for each of its cells.

Two passes [Meijster, Roerdink & Hesselink 2000]: the nearest cell of each column, and from there
along each row by the columns that are nearest somewhere in it. scipy's distance transform finds the
same cells.

Of points that are sorted by cell, the nearest to the centres of cells, and how high they let a
surface be there.
"""

import math

import numpy as np
from numpy.typing import NDArray

from spl_batch.numerics.compiled import njit

Index = NDArray[np.int64]
Mask = NDArray[np.bool_]
Places = tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int32]]

NEAREST = 5
"""Points that tell how high a surface is at a place [count]."""

_DAMPING = 1e-4
"""Added to the scatter of their places [cells2]."""


def nearest_cells(held: Mask) -> tuple[Index, Index]:
    """Row and column of the nearest cell that holds something: two (rows, columns) int64.

    Parameters
    ----------
    held : (rows, columns) bool
        Cells that do; at least one. Of equally near ones that of the first column counts, then that
        of the first row.
    """
    row, column = np.empty((2, *held.shape), dtype=np.int64)
    _nearest(held, row, column)
    return row, column


def distances(held: Mask) -> NDArray[np.float64]:
    """Distance of each cell to the nearest that holds something: (rows, columns) float64 [cells].

    ``held``: as :func:`nearest_cells` has it. scipy's distance transform of the others has the same
    numbers: distances are roots of whole ones.
    """
    away = np.empty(held.shape)
    _distances(held, away)
    return away


@njit()
def _distances(held: Mask, away: NDArray[np.float64]) -> None:
    """Fill with the distances to the nearest cells."""
    rows, columns = held.shape
    along = _nearest_of_columns(held)
    some = np.flatnonzero(along[0] >= 0)
    at, begin = np.empty((2, columns), np.int64)
    for r in range(rows):
        last = _nearest_in_row(along[r], r, some, at, begin)
        for c in range(columns - 1, -1, -1):
            while begin[last] > c:
                last -= 1
            up, aside = along[r, at[last]] - r, at[last] - c
            away[r, c] = math.sqrt(up * up + aside * aside)


@njit()
def _nearest(held: Mask, row: Index, column: Index) -> None:
    """Fill with row and column of the nearest cells."""
    rows, columns = held.shape
    along = _nearest_of_columns(held)
    some = np.flatnonzero(along[0] >= 0)
    at, begin = np.empty((2, columns), np.int64)
    for r in range(rows):
        last = _nearest_in_row(along[r], r, some, at, begin)
        for c in range(columns - 1, -1, -1):
            while begin[last] > c:
                last -= 1
            row[r, c], column[r, c] = along[r, at[last]], at[last]


@njit()
def _nearest_in_row(along: Index, r: int, some: Index, at: Index, begin: Index) -> int:
    """Fill which columns are nearest in a row, and from where on; the number of the last."""
    last = -1
    for c in some:
        off = (along[c] - r) ** 2
        first = 0
        while last >= 0:
            other = at[last]
            # The last place where the other one is no farther.
            up_to = c * c - other * other + off - (along[other] - r) ** 2
            first = 1 + up_to // (2 * (c - other))
            if first > begin[last]:
                break
            last, first = last - 1, 0
        if first < len(along):
            last += 1
            at[last], begin[last] = c, first
    return last


@njit()
def _nearest_of_columns(held: Mask) -> Index:
    """Row of the nearest cell in each cell's column; beyond reach where that has none."""
    rows, columns = held.shape
    found = np.full(held.shape, -rows - columns, dtype=np.int64)
    for r in range(rows):
        for c in range(columns):
            if held[r, c]:
                found[r, c] = r
            elif r > 0:
                found[r, c] = found[r - 1, c]
    for r in range(rows - 2, -1, -1):
        for c in range(columns):
            if abs(found[r + 1, c] - r) < r - found[r, c]:
                found[r, c] = found[r + 1, c]
    return found


@njit()
def nearest_heights(
    xyz: Places,
    start: Index,
    lattice: tuple[int, int, int],
    reach: float,
    out: NDArray[np.float64],
) -> None:
    """Heights that the returns around the centres of cells allow there.

    Range of the :data:`NEAREST` nearest returns, and all at the same distance as the last of them,
    widened by what their slope makes of their distance.

    Parameters
    ----------
    xyz : three (n,) int32
        Points, those of a cell together [quanta].
    start : (rows * cols + 1,) int64
        Where each cell begins.
    lattice : (int, int, int)
        Columns; cells around those that are asked, where returns count too; edge [quanta].
    reach : float
        A centre farther than this from all returns is left out [quanta].
    out : (2, rows - 2 rim, cols - 2 rim) float64, written
        Lowest and highest [quanta]; NaN where too few returns are near.
    """
    _, rim, size = lattice
    nearest = np.empty(NEAREST)
    for row in range(out.shape[1]):
        for col in range(out.shape[2]):
            cell = row + rim, col + rim
            ring = _find_nearest(xyz, start, lattice, cell, nearest)
            out[:, row, col] = np.nan
            if nearest[0] <= reach * reach and nearest[-1] <= ((rim + 0.5) * size) ** 2:
                out[:, row, col] = _allowed(xyz, start, lattice, cell, ring, nearest[-1])


@njit()
def _find_nearest(
    xyz: Places,
    start: Index,
    lattice: tuple[int, int, int],
    cell: tuple[int, int],
    nearest: NDArray[np.float64],
) -> int:
    """Squared distances from a centre to the nearest returns; how many cells aside they are."""
    x, y, _ = xyz
    cols, rim, size = lattice
    row, col = cell
    nearest[:] = np.inf
    ring = -1
    while ring < rim and (ring < 0 or nearest[-1] > ((ring + 0.5) * size) ** 2):
        ring += 1
        for r in range(row - ring, row + ring + 1):
            step = 1 if abs(r - row) == ring else 2 * ring
            for c in range(r * cols + col - ring, r * cols + col + ring + 1, max(step, 1)):
                for p in range(start[c], start[c + 1]):
                    d2 = (x[p] - (col + 0.5) * size) ** 2 + (y[p] - (row + 0.5) * size) ** 2
                    for k in range(len(nearest)):
                        nearest[k], d2 = min(nearest[k], d2), max(nearest[k], d2)
    return ring


@njit()
def _allowed(
    xyz: Places,
    start: Index,
    lattice: tuple[int, int, int],
    cell: tuple[int, int],
    ring: int,
    farthest2: float,
) -> tuple[float, float]:
    """Lowest and highest of the returns that are no farther, widened by their slope's share."""
    x, y, z = xyz
    cols, _, size = lattice
    row, col = cell
    # Whole numbers of half quanta: sums are exact in any order.
    n, low, high, sums = 0, np.inf, -np.inf, np.zeros(8)
    for r in range(row - ring, row + ring + 1):
        for p in range(start[r * cols + col - ring], start[r * cols + col + ring + 1]):
            u, v, w = x[p] - (col + 0.5) * size, y[p] - (row + 0.5) * size, float(z[p])
            if u * u + v * v <= farthest2:
                low, high, n = min(low, w), max(high, w), n + 1
                for k, value in enumerate((u, v, w, u * u, u * v, v * v, u * w, v * w)):
                    sums[k] += value
    u, v, w, uu, uv, vv, uw, vw = sums / n
    # The damping keeps returns on one line from telling a slope across it.
    damping = _DAMPING * size * size
    uu, uv, vv = uu - u * u + damping, uv - u * v, vv - v * v + damping
    uw, vw = uw - u * w, vw - v * w
    rise = np.hypot(vv * uw - uv * vw, uu * vw - uv * uw) / (uu * vv - uv * uv)
    share = rise * np.sqrt(farthest2)
    return low - share, high + share
