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
from scipy import ndimage

from spl_batch.numerics.compiled import njit

WIDTH_M: Final = 26.0
"""Width of the widest deck, across or aslant [m]."""

NARROW_M: Final = 4.0
"""What is narrower is a wall or a crest [m]."""

LEAST_M2: Final = 40.0
"""What is smaller is a step of rough ground [m2]."""

FALL_M: Final = 2.0
END_FALL_M: Final = 1.0
"""Fall from one cell to the next at the side of a deck, and where it goes on to an end: that of a
bank is less [m]."""

AXES: Final = 8
"""Directions across a deck that are tried: aslant one side looks at ground farther on [count]."""

ENCLOSED: Final = 5
"""So many of the eight cells around a hole of a deck are of the deck [count]."""

ROUNDS: Final = 12
"""So many cells a deck goes on at most [count]."""

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
    held = grid >= 0
    span = round(NARROW_M / cell_m), round(WIDTH_M / cell_m)
    height = xyz[nearest, 2]
    found, ends = np.zeros((2, *grid.shape), dtype=np.bool_)
    _between_falls(height, held, *span, SLOPE * cell_m, FALL_M, found)
    _between_falls(height, held & ground[grid] & ~found, *span, SLOPE * cell_m, END_FALL_M, ends)
    _go_on(height, held, ends, SLOPE * cell_m, found)
    numbers, _ = ndimage.label(found, np.ones((3, 3)))
    large = np.bincount(numbers.ravel()) * cell_m**2 >= LEAST_M2
    found &= large[numbers]
    decks = np.zeros(len(xyz), dtype=np.bool_)
    decks[grid[found]] = True
    return decks


@njit()
def _between_falls(
    height: Float,
    asked: Mask,
    narrow: int,
    wide: int,
    rise_m: float,
    fall_m: float,
    out: Mask,
) -> None:
    """Fill with cells that have a sharp fall on two opposite sides across one of the axes."""
    rows, columns = height.shape
    axes = np.empty((AXES, 2))
    for k in range(AXES):
        axes[k, 0], axes[k, 1] = np.sin(np.pi * k / AXES), np.cos(np.pi * k / AXES)
    for r in range(rows):
        for c in range(columns):
            if not asked[r, c]:
                continue
            for k in range(AXES):
                north, east = axes[k, 0], axes[k, 1]
                one = _level_for(height, r, c, north, east, wide, rise_m, fall_m)
                if one == 0:
                    continue
                other = _level_for(height, r, c, -north, -east, wide - one, rise_m, fall_m)
                if other == 0:
                    continue
                if one + other < narrow:
                    out[r, c] = False
                    break
                between = 0.5 * (one - other)
                middle = int(np.rint(r + between * north)), int(np.rint(c + between * east))
                out[r, c] |= not _ends(height, *middle, east, -north, one + other, fall_m)


@njit()
def _ends(
    height: Float, row: int, column: int, north: float, east: float, far: int, fall_m: float
) -> bool:
    """Whether the surface falls on the way along, in front or behind, as at a corner or a roof."""
    rows, columns = height.shape
    for way in (1, -1):
        last = height[row, column]
        for step in range(1, far + 1):
            r = row + int(np.rint(way * step * north))
            c = column + int(np.rint(way * step * east))
            if r < 0 or c < 0 or r >= rows or c >= columns:
                break
            if height[r, c] <= last - fall_m:
                return True
            last = height[r, c]
    return False


@njit()
def _level_for(
    height: Float,
    row: int,
    column: int,
    north: float,
    east: float,
    far: int,
    rise_m: float,
    fall_m: float,
) -> int:
    """After how many cells the surface falls that was level so far; 0 where it does not."""
    rows, columns = height.shape
    last = height[row, column]
    for step in range(1, far + 1):
        r, c = int(np.rint(row + step * north)), int(np.rint(column + step * east))
        if r < 0 or c < 0 or r >= rows or c >= columns:
            return 0
        if height[r, c] <= last - fall_m:
            return step
        last = height[r, c]
        if abs(last - height[row, column]) > LEVEL_M + rise_m * step:
            return 0
    return 0


@njit()
def _go_on(height: Float, held: Mask, ends: Mask, rise_m: float, decks: Mask) -> None:
    """Add ends that decks go on to at their own height, cell by cell, and what they enclose."""
    rows, columns = height.shape
    for _ in range(ROUNDS):
        joins = np.zeros(decks.shape, dtype=np.bool_)
        for r in range(rows):
            for c in range(columns):
                if held[r, c] and not decks[r, c]:
                    beside = _level_beside(height, decks, r, c, LEVEL_M + rise_m)
                    joins[r, c] = beside >= ENCLOSED or (ends[r, c] and beside > 0)
        if not joins.any():
            break
        decks |= joins


@njit()
def _level_beside(height: Float, decks: Mask, row: int, column: int, rise_m: float) -> int:
    """How many of the eight cells around are of a deck as high as one."""
    rows, columns = height.shape
    count = 0
    for r in range(max(row - 1, 0), min(row + 2, rows)):
        for c in range(max(column - 1, 0), min(column + 2, columns)):
            count += decks[r, c] and abs(height[r, c] - height[row, column]) <= rise_m
    return count
