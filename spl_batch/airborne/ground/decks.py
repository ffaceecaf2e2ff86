"""Ends of bridge decks that an opening leaves.

Over a slope a deck rises gently above the ground beside it. A window that is wider than the deck
reaches the ground at its sides only as far up the slope as it is narrow there: it lowers the deck
step by step, so that no step is an object's. But a deck is level across and ends in a sharp fall on
both sides, no farther apart than a road is wide. Ridges fall from their middle, rims on one side
only, and the sides of a bank over a longer way. What is left of a deck lies less than such a fall
above the ground.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.numerics.compiled import njit

WIDTH_M: Final = 26.0
"""Width of the widest deck, across or aslant [m]."""

NARROW_M: Final = 4.0
"""What is narrower is a wall or a crest [m]."""

FALL_M: Final = 2.0
"""Fall from one cell to the next at the side of a deck: that of a bank is less [m]."""

LEVEL_M: Final = 0.25
SLOPE: Final = 0.05
"""A deck is level across within this, and this slope [m, rise/run]."""

Float = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.int64]


def on_decks(xyz: Float, grid: Index, nearest: Index, ground: Mask, cell_m: float) -> Mask:
    """Ground nodes that stand level between two sharp falls: (n,) bool.

    Parameters
    ----------
    xyz : (n, 3) float64
        Nodes [m].
    grid, nearest : (rows, columns) int64
        A node for each cell, or -1, and that of the nearest cell with one.
    ground : (n,) bool
        Nodes of the ground.
    cell_m : float
        Edge of a cell [m].
    """
    asked = (grid >= 0) & ground[grid]
    found = np.zeros(grid.shape, dtype=np.bool_)
    span = round(NARROW_M / cell_m), round(WIDTH_M / cell_m)
    _between_falls(xyz[nearest, 2], asked, *span, SLOPE * cell_m, found)
    decks = np.zeros(len(xyz), dtype=np.bool_)
    decks[grid[found]] = True
    return decks


@njit()
def _between_falls(
    height: Float, asked: Mask, narrow: int, wide: int, rise_m: float, out: Mask
) -> None:
    """Fill with cells that have a sharp fall on two opposite sides in one of four directions."""
    slant = np.sqrt(0.5)
    rows, columns = height.shape
    for r in range(rows):
        for c in range(columns):
            if not asked[r, c]:
                continue
            for north, east in ((0.0, 1.0), (1.0, 0.0), (slant, slant), (slant, -slant)):
                one = _level_for(height, r, c, north, east, wide, rise_m)
                if one == 0:
                    continue
                other = _level_for(height, r, c, -north, -east, wide - one, rise_m)
                if other > 0 and one + other >= narrow:
                    out[r, c] = True
                    break


@njit()
def _level_for(
    height: Float, row: int, column: int, north: float, east: float, far: int, rise_m: float
) -> int:
    """After how many cells the surface falls that was level so far; 0 where it does not."""
    rows, columns = height.shape
    last = height[row, column]
    for step in range(1, far + 1):
        r, c = int(np.rint(row + step * north)), int(np.rint(column + step * east))
        if r < 0 or c < 0 or r >= rows or c >= columns:
            return 0
        if height[r, c] <= last - FALL_M:
            return step
        last = height[r, c]
        if abs(last - height[row, column]) > LEVEL_M + rise_m * step:
            return 0
    return 0
