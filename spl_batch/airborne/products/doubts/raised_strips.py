"""Raised strips between two walls in the terrain: decks of wide bridges that stayed ground.

A narrow deck is cut off. One that is about as wide as it is long is as good as ground to a method:
no opening of a deck's width leaves the cutting below. What gives it away is its shape: the surface
ends in a wall on two opposite sides, beyond both walls it goes on level and at one height, as the
floor of a cutting does, and to the two other sides it goes on at its own height. The foot of a
crest's sides is not level within a few metres, a dam holds water higher on one side, a roof has
walls on more sides, a terrace on fewer. A bank between two pits, and a pier between two basins look
the same. Strips are told, and nothing is removed. Our own rule: no source has one.
"""

from collections.abc import Iterator
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from spl_batch.airborne.ground.multiscale.raised_patches import (
    LEAST_M2,
    SQUARE_M,
    WALL_M,
    Patch,
    is_flat,
    lowest_of_squares,
    patch_of,
)
from spl_batch.numerics.compiled import njit
from spl_batch.numerics.nearest_cells import nearest_cells

DOMAIN: Final = "space"

REACH_M: Final = 40.0
"""Width of a strip at most, and how far it goes on at least [m]."""

AXES: Final = 8
"""Directions of a strip that are tried [count]."""

BEYOND_M: Final = 8.0
LEVEL_M: Final = 1.0
"""So far beyond a wall the floor is looked at, and it rises and falls by no more there [m, m]."""

ALIKE: Final = 0.25
"""Difference of the two floors over the height of the strip, at most."""

WIDER: Final = 2
OPEN: Final = 0.5
"""A strip ends where the ground so many times as far off as its walls lies no lower than this share
of its height below it: that of a road's bank never does."""

Grid = NDArray[np.float64]
Index = NDArray[np.int64]


def raised_strips(ground: Grid, cell_m: float) -> Iterator[Patch]:
    """Raised strips between two walls, row by row.

    Parameters
    ----------
    ground : (rows, columns) float64
        Mean height of the ground in each cell [m]; NaN without.
    cell_m : float
        Edge of a cell [m].
    """
    step = max(1, round(SQUARE_M / cell_m))
    edge_m = step * cell_m
    lowest = lowest_of_squares(ground, step)
    held = ~np.isnan(lowest)
    if not held.any():
        return
    above = between_walls(lowest[nearest_cells(held)], edge_m)
    numbers, _ = ndimage.label(above > 0.0)
    for number, box in enumerate(ndimage.find_objects(numbers), start=1):
        mine = numbers[box] == number
        if mine.sum() * edge_m**2 < LEAST_M2:
            continue
        if not is_flat(lowest[box], mine & held[box], edge_m):
            continue
        yield patch_of(mine, box, step, cell_m, float(np.median(above[box][mine])))


def between_walls(surface: Grid, edge_m: float) -> Grid:
    """How far squares of raised strips stand above the floor on both sides.

    Parameters
    ----------
    surface : (rows, columns) float64
        Heights without gaps [m].
    edge_m : float
        Edge of a square [m].

    Returns
    -------
    (rows, columns) float64
        Zero where a square is none of a strip [m].
    """
    angle = np.pi * np.arange(AXES) / AXES
    across = np.column_stack([np.sin(angle), np.cos(angle)])
    across /= np.abs(across).max(axis=1, keepdims=True)
    steps = (REACH_M / edge_m / np.hypot(*across.T)).astype(np.int64)
    beyond = np.maximum(BEYOND_M / edge_m / np.hypot(*across.T), 2.0).astype(np.int64)
    above = np.zeros(surface.shape)
    _measure(surface, across, steps, beyond, above)
    return above


@njit()
def _measure(surface: Grid, across: Grid, steps: Index, beyond: Index, above: Grid) -> None:
    """Heights of strips above the floor on both sides."""
    for r in range(len(surface)):
        for c in range(surface.shape[1]):
            for k in range(len(steps)):
                north, east = across[k]
                there = _wall(surface, r, c, north, east, steps[k])
                if there <= 0:
                    continue
                back = _wall(surface, r, c, -north, -east, steps[k] - there)
                if back <= 0:
                    continue
                one = _floor(surface, r, c, north, east, there, beyond[k])
                two = _floor(surface, r, c, -north, -east, back, beyond[k])
                tall = surface[r, c] - max(one, two)
                # Where a floor is not level nothing equals NaN.
                if not (tall >= WALL_M and abs(one - two) <= ALIKE * tall):
                    continue
                # Seen along the strip, one wall is on the left and the other on the right.
                near, far = WIDER * there, WIDER * back
                if not _opens(surface, r, c, east, -north, near, far, steps[k], OPEN * tall):
                    continue
                if not _opens(surface, r, c, -east, north, far, near, steps[k], OPEN * tall):
                    continue
                for i in range(1 - back, there):
                    at = r + int(np.rint(i * north)), c + int(np.rint(i * east))
                    above[at] = max(above[at], tall)


@njit()
def _wall(surface: Grid, row: int, column: int, north: float, east: float, steps: int) -> int:
    """Step at which the surface falls by a wall, before it rises by one; 0 if it does not."""
    rows, columns = surface.shape
    top = last = surface[row, column]
    for k in range(1, steps + 1):
        r, c = row + int(np.rint(k * north)), column + int(np.rint(k * east))
        if r < 0 or c < 0 or r >= rows or c >= columns:
            return 0
        here = surface[r, c]
        if here <= min(top, last) - WALL_M:
            return k
        if here >= top + WALL_M:
            return 0
        last = here
    return 0


@njit()
def _floor(
    surface: Grid, row: int, column: int, north: float, east: float, wall: int, steps: int
) -> float:
    """Height of the floor behind a wall; NaN where it is not level [m]."""
    rows, columns = surface.shape
    low, high = np.inf, -np.inf
    for k in range(wall + 1, wall + steps + 1):
        r, c = row + int(np.rint(k * north)), column + int(np.rint(k * east))
        if r < 0 or c < 0 or r >= rows or c >= columns:
            return np.nan
        low, high = min(low, surface[r, c]), max(high, surface[r, c])
    return low if high - low <= LEVEL_M else np.nan


@njit()
def _opens(
    surface: Grid,
    row: int,
    column: int,
    north: float,
    east: float,
    left: int,
    right: int,
    steps: int,
    fall: float,
) -> bool:
    """Whether a strip leads, without a step, to ground that does not fall off beside it.

    ``left, right``: how far off that ground is looked at [squares]; ``fall``: by how much [m].
    """
    rows, columns = surface.shape
    last = surface[row, column]
    least = last - fall
    for k in range(1, steps + 1):
        r, c = row + int(np.rint(k * north)), column + int(np.rint(k * east))
        if r < 0 or c < 0 or r >= rows or c >= columns or abs(surface[r, c] - last) >= WALL_M:
            return False
        last = surface[r, c]
        least = max(least, last - fall)
        if _lowest(surface, r, c, -east, north, left) < least:
            continue
        if _lowest(surface, r, c, east, -north, right) >= least:
            return True
    return False


@njit()
def _lowest(surface: Grid, row: int, column: int, north: float, east: float, steps: int) -> float:
    """Lowest height on the way from a square; minus infinity where the survey ends [m]."""
    rows, columns = surface.shape
    low = np.inf
    for k in range(1, steps + 1):
        r, c = row + int(np.rint(k * north)), column + int(np.rint(k * east))
        if r < 0 or c < 0 or r >= rows or c >= columns:
            return -np.inf
        low = min(low, surface[r, c])
    return low
