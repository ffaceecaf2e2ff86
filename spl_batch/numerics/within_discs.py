"""Cells of a grid that lie within a disc around one that holds something.

scipy's distance transform tells it as well, and the distance, which nobody asks for: of a disc of
known radius each column says how far it reaches along a row, and two sweeps along the row join
that. Nothing depends on how large the disc is.
"""

import math

import numpy as np
from numpy.typing import NDArray

from spl_batch.numerics.compiled import njit

Mask = NDArray[np.bool_]


def within_discs(held: Mask, radius: float) -> Mask:
    """Cells whose distance to one that holds something is no more than a radius.

    Parameters
    ----------
    held : (rows, columns) bool
        Cells that do; there may be none.
    radius : float
        Radius between the middles of cells [cells], >= 0.

    Returns
    -------
    (rows, columns) bool
    """
    found = np.zeros(held.shape, np.bool_)
    if not held.size:
        return found
    _within(np.ascontiguousarray(held), _half_widths(radius), found)
    return found


def _half_widths(radius: float) -> NDArray[np.int64]:
    """How far a disc reaches to either side, by rows from its middle: distances are whole roots."""
    square = math.floor(radius * radius)
    square += math.sqrt(square + 1) <= radius
    square -= math.sqrt(square) > radius
    return np.array([math.isqrt(square - k * k) for k in range(math.isqrt(square) + 1)])


@njit()
def _within(held: Mask, half: NDArray[np.int64], out: Mask) -> None:
    """Mark the cells within discs."""
    rows, columns = held.shape
    away = _along_columns(held, len(half))
    for r in range(rows):
        end = -1
        for c in range(columns):
            if away[r, c] < len(half):
                end = max(end, c + half[away[r, c]])
            out[r, c] = c <= end
        end = columns
        for c in range(columns - 1, -1, -1):
            if away[r, c] < len(half):
                end = min(end, c - half[away[r, c]])
            out[r, c] |= c >= end


@njit()
def _along_columns(held: Mask, beyond: int) -> NDArray[np.int64]:
    """Distance to the nearest cell of a column that holds something, up to one that is beyond."""
    rows, columns = held.shape
    away = np.full(held.shape, beyond, np.int64)
    for c in range(columns):
        if held[0, c]:
            away[0, c] = 0
    for r in range(1, rows):
        for c in range(columns):
            away[r, c] = 0 if held[r, c] else min(away[r - 1, c] + 1, beyond)
    for r in range(rows - 2, -1, -1):
        for c in range(columns):
            away[r, c] = min(away[r, c], away[r + 1, c] + 1)
    return away
