"""Ground that goes on where an opening has cut it off: crests, rims, spurs, tops of banks.

An opening takes a crest that is narrower than its window for an object, and a window fits into no
corner of a plateau: both stand out. Here ground grows to the next node where a plane through the
ground nodes of one side goes on to it, or above it, as over a rim: the two flanks of a crest do not
level each other out. Where there is ground on the opposite side, its plane has to go on to it as
well, or lie lower by a wall: a shrub on a slope is above both. No source has this: [Axelsson 2000]
mirrors points at the nearest one of the ground.

Where no wall is within the window, the opening has cut off plants and cars: nothing level grows.
Decks and roofs that it grows to are taken off again
(:mod:`~spl_batch.airborne.ground.multiscale.objects`).
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.ground.multiscale.node_planes import nearest_nodes, on_one_side
from spl_batch.airborne.ground.scales import (
    BESIDE_M,
    CELL_M,
    EDGE_M,
    LAYER_M,
    NEAREST,
    ROUGH_M,
    SIDES,
    STEEP,
    TILT,
    WINDOW_M,
)
from spl_batch.numerics.compiled import njit

ROUNDS: Final = round(WINDOW_M / CELL_M)
"""Nodes that ground grows by at the most: the largest window of the opening [count]."""

Float = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.int64]


def grown(xyz: Float, grid: Index, nearest: Index, ground: Mask, point_m: Float) -> Mask:
    """Ground nodes, and those of a grid that go on from them: (n,) bool.

    Parameters
    ----------
    xyz : (n, 3) float64
        Nodes [m].
    grid : (rows, columns) int64
        A node for each cell, or -1, as :func:`~spl_batch.airborne.ground.node_grids.lowest_nodes`
        finds them.
    nearest : (rows, columns) int64
        That of the nearest cell with one.
    ground : (n,) bool
        Nodes of the ground.
    point_m : (n,) float64
        Spacing of the points that they are the lowest of [m].
    """
    full = grid >= 0
    index = grid[full]
    if len(index) <= NEAREST:
        return ground
    nodes, known = xyz[index], ground[index]
    around = nearest_nodes(nodes)
    other = full.copy()
    other[full] = ~known
    beside_wall = edges(xyz[nearest, 2], other)[full]
    wide = np.maximum(point_m[index] / CELL_M, 1.0)
    _grow(nodes, around, wide, beside_wall, known)
    out = ground.copy()
    out[index[known]] = True
    return out


@njit()
def _any_beside(fresh: Mask, around: Index) -> bool:
    """Whether any of the nodes beside one is fresh."""
    found = False
    for k in range(1, SIDES + 1):
        found |= fresh[around[k]]
    return bool(found)


@njit()
def _grow(nodes: Float, around: Index, wide: Float, beside_wall: Mask, ground: Mask) -> None:
    """Let ground grow round by round: steep from all of it, level beside walls from what is level.

    Level ground is known to what it undulates by between nodes: in proportion to their distance,
    ``wide``, in cells.
    """
    fresh = ground.copy()
    steep, level = ground.astype(np.float64), ground.astype(np.float64)
    there, here = np.empty(len(nodes), np.bool_), np.empty(len(nodes), np.bool_)
    for _ in range(ROUNDS):
        for i in range(len(nodes)):
            there[i] = here[i] = False
            if ground[i] or not _any_beside(fresh, around[i]):
                continue
            near = around[i]
            off, rough, slopes = (LAYER_M, TILT), (ROUGH_M, TILT), (STEEP, np.inf)
            there[i] = on_one_side(nodes, near, steep, i, off, rough, slopes, EDGE_M)
            if beside_wall[i]:
                off, rough = (wide[i] * LAYER_M, 0.0), (wide[i] * ROUGH_M, 0.0)
                slopes = 0.0, STEEP
                here[i] = on_one_side(nodes, near, level, i, off, rough, slopes, EDGE_M)
        grown = False
        for i in range(len(nodes)):
            fresh[i] = there[i] or here[i]
            grown |= fresh[i]
            if fresh[i]:
                ground[i] = True
                steep[i] = 1.0
            if here[i]:
                level[i] = 1.0
        if not grown:
            break


def edges(height: Float, asked: Mask) -> Mask:
    """Cells whose surface ends in a wall within reach of a window: (rows, columns) bool.

    Parameters
    ----------
    height : (rows, columns) float64
        Heights without gaps [m].
    asked : (rows, columns) bool
        Cells to look at.
    """
    out = np.zeros(height.shape, dtype=np.bool_)
    edge, far = (round(along / CELL_M) for along in (BESIDE_M, WINDOW_M))
    _edges(height, asked, edge, far, out)
    return out


@njit()
def _edges(height: Float, asked: Mask, edge: int, far: int, out: Mask) -> None:
    """Fill with cells that have a wall in one of eight directions."""
    slant = np.sqrt(0.5)
    ways = ((0.0, 1.0), (1.0, 0.0), (slant, slant), (slant, -slant))
    for r in range(height.shape[0]):
        for c in range(height.shape[1]):
            if not asked[r, c]:
                continue
            for north, east in ways:
                for turn in (1.0, -1.0):
                    way = turn * north, turn * east
                    out[r, c] |= _ends(height, r, c, *way, edge, far)


@njit()
def _ends(
    height: Float, row: int, column: int, north: float, east: float, edge: int, far: int
) -> bool:
    """Whether on a way from a cell its surface ends in a wall.

    What rises above the cell by a wall's height is in the way: the eave of a house is none.
    """
    rows, columns = height.shape
    top = height[row, column]
    for step in range(1, far + 1):
        r, c = int(np.rint(row + step * north)), int(np.rint(column + step * east))
        if r < 0 or c < 0 or r >= rows or c >= columns or height[r, c] > top + EDGE_M:
            return False
        back = max(step - edge, 0)
        before = height[int(np.rint(row + back * north)), int(np.rint(column + back * east))]
        if height[r, c] <= min(top, before) - EDGE_M:
            return True
    return False
