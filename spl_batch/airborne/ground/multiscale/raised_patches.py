"""Raised flat patches of a building's size in the terrain: roofs that were taken for ground.

Where a ground filter leaves a roof, the terrain ends in a wall nearly all around it: from a place
on it the surface goes on without a step and then falls, in most directions. A ramp that leads up
takes some of these. From a terrace, a bank or a hillside the terrain falls to one side only, from a
mound it falls on beyond the edge, and a crest is narrow. A flat rock or a spur with walls on three
sides looks the same as a roof.

The nodes of such patches are taken off again, but for those whose walls are too low or too high for
a house, as in quarries. On a real town 1.0 % of the roofs are ground without this, 0.8 % with it
(``docs/evidence/terrain.md``).

Walls are looked for among the lowest ground of squares, where gaps take that of the nearest one: a
terrain model that is interpolated across a gap turns walls into ramps.
"""

from collections.abc import Iterator
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from spl_batch.airborne.ground.multiscale.grown_ground import steps_to_wall
from spl_batch.airborne.ground.scales import BESIDE_M, HIGH_M, MOST, SIDES, WALL_M, WINDOW_M
from spl_batch.numerics.compiled import njit
from spl_batch.numerics.nearest_cells import nearest_cells

LEAST_M2: Final = 60.0
"""Area of a small house [m2]."""

MIN_SQUARES_PER_PLANE: Final = 6
"""Squares with ground that determine a plane [count]."""

NARROW: Final = 2.0
"""A patch that holds no three by three squares may be a crest [squares from its middle to the
next that is none]."""

FLAT_M: Final = 0.5
SLOPE: Final = 0.3
"""Standard deviation about the plane of a flat patch, and its slope, at most [m, rise/run]."""

RIM_M: Final = WALL_M / 2
"""So far the terrain falls from a building to most squares around it [m]."""

Grid = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.int64]


def on_houses(xyz: Grid, ground: Mask) -> Mask:
    """Ground nodes that lie on a raised flat patch with the walls of a house: (n,) bool.

    Parameters
    ----------
    xyz : (n, 3) float64
        Nodes [m].
    ground : (n,) bool
        Those of the ground.
    """
    column, row = np.floor(xyz[ground, :2] / BESIDE_M).astype(np.int64).T
    column, row = column - column.min(), row - row.min()
    lowest = np.full((int(row.max()) + 1, int(column.max()) + 1), np.inf)
    np.minimum.at(lowest, (row, column), xyz[ground, 2])
    raised = np.zeros(lowest.shape, np.bool_)
    for near, mine, fall in _buildings(np.where(np.isinf(lowest), np.nan, lowest), BESIDE_M):
        if WALL_M <= np.median(fall) < HIGH_M:
            raised[near] |= mine
    out = np.zeros(len(xyz), np.bool_)
    out[ground] = raised[row, column]
    return out


def walled_in(surface: Grid, reach: int) -> Mask:
    """Squares from which the surface ends in a wall in most directions: (rows, columns) bool.

    Parameters
    ----------
    surface : (rows, columns) float64
        Heights without gaps [m].
    reach : int
        How far off a wall counts [squares].
    """
    found = _between_walls(surface, reach)
    # Directions a quarter apart follow each other: most hillsides fail the first ones.
    asked = np.arange(2 * SIDES).reshape(4, -1).T.ravel()
    angle = 2 * np.pi * asked / len(asked)
    towards = np.column_stack([np.sin(angle), np.cos(angle)])
    towards /= np.abs(towards).max(axis=1, keepdims=True)
    steps = (reach / np.hypot(*towards.T)).astype(np.int64)
    _keep_walled(surface, towards, steps, found)
    return found


@njit()
def _keep_walled(surface: Grid, towards: Grid, steps: Index, found: Mask) -> None:
    """Keep the squares from which the surface ends in a wall in enough directions."""
    for r in range(len(surface)):
        for c in range(surface.shape[1]):
            left = (1.0 - MOST) * len(steps)
            for k in range(len(steps)):
                if not found[r, c]:
                    break
                north, east = towards[k]
                left -= not steps_to_wall(surface, r, c, north, east, 1, steps[k], WALL_M)
                found[r, c] = left >= 0


def _between_walls(surface: Grid, reach: int) -> Mask:
    """Squares with the top of a wall within reach in three of the directions of the grid."""
    lower = ndimage.minimum_filter(surface, 3, mode="nearest") <= surface - WALL_M
    count = np.zeros(surface.shape, np.int64)
    if lower.any():
        for axis in (0, 1):
            for origin in (reach // 2, -(reach // 2)):
                count += ndimage.maximum_filter1d(
                    lower, 2 * (reach // 2) + 1, axis=axis, origin=origin, mode="constant"
                )
    between: Mask = count >= 3
    return between


def _buildings(lowest: Grid, edge_m: float) -> Iterator[tuple[tuple[slice, ...], Mask, Grid]]:
    """Raised squares that hang together as a flat patch with a wall around.

    Parameters
    ----------
    lowest : (rows, columns) float64
        Lowest ground of squares [m]; NaN without.
    edge_m : float
        Edge of a square [m].

    Yields
    ------
    near : (slice, slice)
        Rows and columns of the patch and two more on each side.
    mine : (...) bool
        Squares of the patch there.
    fall : (n,) float64
        How far the squares around it lie below [m].
    """
    held = ~np.isnan(lowest)
    if not held.any():
        return
    surface = lowest[nearest_cells(held)]
    numbers, _ = ndimage.label(walled_in(surface, round(WINDOW_M / edge_m)))
    for number, box in enumerate(ndimage.find_objects(numbers), start=1):
        near = tuple(slice(max(side.start - 2, 0), side.stop + 2) for side in box)
        mine, heights = numbers[near] == number, surface[near]
        if mine.sum() * edge_m**2 < LEAST_M2 or not is_flat(heights, mine & held[near], edge_m):
            continue
        rim, beyond = _rings(mine)
        fall = np.median(heights[mine]) - heights[rim]
        if np.mean(fall > RIM_M) < MOST:
            continue
        if beyond.any() and np.median(heights[rim]) - np.median(heights[beyond]) > RIM_M:
            continue
        if ndimage.distance_transform_edt(np.pad(mine, 1)).max() < NARROW:
            continue
        yield near, mine, fall


def _rings(mine: Mask) -> tuple[Mask, Mask]:
    """Squares beside some, and those beside these."""
    around = np.ones((3, 3), np.bool_)
    once, twice = (ndimage.binary_dilation(mine, around, iterations=k) for k in (1, 2))
    return once & ~mine, twice & ~once


def is_flat(heights: Grid, known: Mask, edge_m: float) -> bool:
    """Whether some squares lie on a plane that is hardly tilted."""
    row, column = np.nonzero(known)
    if len(row) < MIN_SQUARES_PER_PLANE:
        return False
    design = np.column_stack([np.ones(len(row)), row * edge_m, column * edge_m])
    plane = np.linalg.lstsq(design, heights[known], rcond=None)[0]
    off = heights[known] - design @ plane
    return bool(np.std(off) <= FLAT_M and np.hypot(*plane[1:]) <= SLOPE)
