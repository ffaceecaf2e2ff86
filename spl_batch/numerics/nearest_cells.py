"""Nearest cell of a grid that holds something, for each of its cells.

Two passes [Meijster, Roerdink & Hesselink 2000]: the nearest cell of each column, and from there
along each row by the columns that are nearest somewhere in it. scipy's distance transform finds the
same cells.
"""

import math

import numpy as np
from numpy.typing import NDArray

from spl_batch.numerics.compiled import njit

Index = NDArray[np.int64]
Mask = NDArray[np.bool_]


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
