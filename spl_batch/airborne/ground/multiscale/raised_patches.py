"""Raised patches of a building's size in the terrain: roofs that were taken for ground.

Where a ground filter leaves a roof, the terrain ends in a wall nearly all around it: from a place
on it the surface goes on without a step and then falls, in most directions. A ramp that leads up
takes some of these. From a terrace, a bank or a hillside the terrain falls to one side only, from a
mound it falls on beyond the edge. A rock or a spur with walls on three sides looks the same as a
roof.

The nodes of such patches are taken off again, but for those whose walls are too low for a house. On
a real town 1.0 % of the roofs are ground without this, 0.8 % with it
(``docs/evidence/terrain.md``).

Walls are looked for among the lowest ground of squares, where gaps take that of the nearest one: a
terrain model that is interpolated across a gap turns walls into ramps.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from spl_batch.airborne.ground.multiscale.grown_ground import steps_to_wall
from spl_batch.airborne.ground.scales import BESIDE_M, HOUSE_M2, MOST, SIDES, WALL_M, WINDOW_M
from spl_batch.numerics.compiled import njit
from spl_batch.numerics.nearest_cells import nearest_cells

RIM_M: Final = WALL_M / 2
"""So far the terrain falls from a building to most squares around it [m]."""

Grid = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.int64]


def on_houses(xyz: Grid, ground: Mask) -> Mask:
    """Ground nodes that lie on a raised patch with the walls of a house: (n,) bool.

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
    surface = lowest[nearest_cells(np.isfinite(lowest))]
    numbers, count = ndimage.label(walled_in(surface, round(WINDOW_M / BESIDE_M)))
    house = np.zeros(count + 1, np.bool_)
    for number, box in enumerate(ndimage.find_objects(numbers), start=1):
        near = tuple(slice(max(side.start - 2, 0), side.stop + 2) for side in box)
        house[number] = _is_house(numbers[near] == number, surface[near])
    out = np.zeros(len(xyz), np.bool_)
    out[ground] = house[numbers[row, column]]
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


def _is_house(mine: Mask, surface: Grid) -> bool:
    """Whether squares of a building's size fall to most of those around, which lie level again."""
    if mine.sum() * BESIDE_M**2 < HOUSE_M2:
        return False
    around = np.ones((3, 3), np.bool_)
    once, twice = (ndimage.binary_dilation(mine, around, iterations=k) for k in (1, 2))
    rim, beyond = once & ~mine, twice & ~once
    fall = np.median(surface[mine]) - surface[rim]
    if np.mean(fall > RIM_M) < MOST or np.median(fall) < WALL_M:
        return False
    level = not beyond.any() or np.median(surface[rim]) - np.median(surface[beyond]) <= RIM_M
    return bool(level)
