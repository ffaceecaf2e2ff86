"""Ground that goes on at its own height: rims of cliffs and terraces, spurs and mounds.

An opening keeps what its window fits into. A window of 40 m fits into no corner of a plateau and no
spur of a quarry, and the rim of a cliff, of which points a few metres apart show a jagged line, is
cut off all along. What is cut off there has a wall on one side only; on the other it goes on from
the ground without a step. A roof has steps all around.

Here ground grows to the next node where that lies on the plane through the ground on one side of
it, as :mod:`~spl_batch.airborne.ground.steep_ground` has it for slopes, within as many spacings of
the nodes as a plane takes. Three things look alike and are kept out:

- a deck continues the road, but between two walls: no ground grows to nodes from which the surface
  falls on two opposite sides that are no farther apart than a deck's, unless it falls in front as
  well and widens behind: the corner of a plateau. Narrow spurs are lost with decks.
- where no wall is within the window, the opening has cut off plants and cars: nothing grows there.
- what an opening leaves of a roof would grow over all of it: nothing grows from ground that is an
  island, a few nodes that hang together without a step.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.ground.multiscale_surface import WINDOW_M
from spl_batch.airborne.ground.point_spacing import in_squares, spacing_at_m
from spl_batch.airborne.ground.steep_ground import (
    AROUND,
    BARRED,
    EDGE_M,
    FEWEST,
    GROUND,
    GROWN,
    OTHER,
    STEEP,
    beside,
    ground_around,
    plane_beside,
)
from spl_batch.numerics.compiled import njit

REACH: Final = 3.0
REACH_M: Final = (4.0, 9.0)
"""Ground up to this far tells the plane: spacings of the nodes, within these bounds [m]."""

NEAR_M: Final = 0.3
"""A node farther above the plane is something else's [m]."""

ROUGH_M: Final = 0.3
"""Ground that scatters by more about its plane goes on nowhere [m]."""

DOWN: Final = 0.5
"""Below the plane a node may lie by this slope, as a rim is rounded [rise/run]."""

GAP: Final = 0.7
"""Ground that begins farther off than this share of the reach goes on nowhere."""

NEXT: Final = 1.6
"""A neighbour is no farther off than this [spacings of the nodes]."""

STEP_M: Final = 0.3
STEP_SLOPE: Final = 0.5
"""Neighbours whose heights differ by more than this, and this slope, do not hang together [m,
rise/run]."""

WALL_M: Final = 1.5
"""Fall at the edge of a terrace or a deck [m]."""

DECK_M: Final = 20.0
"""Width of the widest deck that is kept out [m]."""

ISLAND: Final = 50
"""Fewer nodes that hang together are an island [count]."""

_NONE: Final = 0
_UNKNOWN: Final = 1
_QUEUED: Final = 2
_LARGE: Final = 3
_SMALL: Final = 4
"""What is known of a cell: no ground, ground, some that is looked at, of land, of an island."""

ROUNDS: Final = 20
"""Nodes that ground grows by at the most [count]."""

Float = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.int64]


def levelled(xyz: Float, grid: Index, nearest: Index, ground: Mask, cell_m: float) -> Mask:
    """Ground nodes, and those of a grid that go on from them at their height: (n,) bool.

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
    cell_m : float
        Edge of a cell [m].
    """
    held, spacing = grid >= 0, _spacing(xyz, grid)
    state = np.full(grid.shape, BARRED, dtype=np.uint8)
    state[held] = np.where(ground[grid[held]], GROUND, OTHER)
    near = np.maximum(NEXT * spacing, EDGE_M)
    other = state == OTHER
    state[other & ~edges(xyz[nearest, 2], other, cell_m)] = BARRED
    on_ground = state == GROUND
    state[islands(xyz, grid, on_ground, on_ground, near, cell_m)] = BARRED
    _grow(xyz, grid, np.clip(REACH * spacing, *REACH_M), cell_m, state)
    out = ground.copy()
    out[grid[state == GROWN]] = True
    return out


def _spacing(xyz: Float, grid: Index) -> Float:
    """Mean spacing of a grid's nodes around each; 0 without one (rows, columns) [m]."""
    held = grid >= 0
    x, y = xyz[grid[held], :2].T.copy()
    spacing = np.zeros(grid.shape)
    spacing[held] = spacing_at_m(in_squares(x, y), x, y)
    return spacing


def edges(height: Float, asked: Mask, cell_m: float) -> Mask:
    """Cells that have a wall within reach of a window, but stand on no deck: (rows, columns) bool.

    Parameters
    ----------
    height : (rows, columns) float64
        Heights without gaps [m].
    asked : (rows, columns) bool
        Cells to look at.
    cell_m : float
        Edge of a cell [m].
    """
    out = np.zeros(height.shape, dtype=np.bool_)
    edge, far, deck = (round(along / cell_m) for along in (EDGE_M, WINDOW_M, DECK_M))
    _edges(height, asked, edge, far, deck + 1, out)
    return out


@njit()
def _edges(height: Float, asked: Mask, edge: int, far: int, deck: int, out: Mask) -> None:
    """Fill with cells that have a wall in one of eight directions, and no two across a deck."""
    slant = np.sqrt(0.5)
    rows, columns = height.shape
    for r in range(rows):
        for c in range(columns):
            if not asked[r, c]:
                continue
            for north, east in ((0.0, 1.0), (1.0, 0.0), (slant, slant), (slant, -slant)):
                one = _drops(height, r, c, north, east, edge, far)
                other = _drops(height, r, c, -north, -east, edge, far)
                out[r, c] |= one > 0 or other > 0
                if one > 0 and other > 0 and one + other <= deck:
                    between = 0.5 * (one - other)
                    middle = int(np.rint(r + between * north)), int(np.rint(c + between * east))
                    if _is_corner(height, *middle, north, east, one + other, edge, far):
                        continue
                    out[r, c] = False
                    break


@njit()
def _is_corner(
    height: Float, row: int, column: int, north: float, east: float, span: int, edge: int, far: int
) -> bool:
    """Whether what is so wide at a cell ends as near in front and widens behind, as no deck does.

    ``row``, ``column``: half-way between the walls, so that the way along an oblique deck does not
    end at its side. ``north``, ``east``: on the way across. ``span``: from wall to wall [cells].
    """
    ends = 0.0
    for turn in (1.0, -1.0):
        end = _drops(height, row, column, turn * east, -turn * north, edge, far)
        if 0 < end <= span:
            ends += turn
    if ends == 0.0:
        return False
    r = int(np.rint(row - ends * span * east))
    c = int(np.rint(column + ends * span * north))
    if r < 0 or c < 0 or r >= height.shape[0] or c >= height.shape[1]:
        return False
    if abs(height[r, c] - height[row, column]) > WALL_M:
        return False
    one = _drops(height, r, c, north, east, edge, far)
    other = _drops(height, r, c, -north, -east, edge, far)
    return one == 0 or other == 0 or one + other >= 2 * span


@njit()
def _drops(
    height: Float, row: int, column: int, north: float, east: float, edge: int, far: int
) -> int:
    """After how many cells on the way from one its surface ends in a wall; 0 where it does not.

    What rises above the cell by a wall's height stands in the way: the eave of a house is none.
    """
    rows, columns = height.shape
    top = height[row, column]
    for step in range(1, far + 1):
        r, c = int(np.rint(row + step * north)), int(np.rint(column + step * east))
        if r < 0 or c < 0 or r >= rows or c >= columns or height[r, c] > top + WALL_M:
            return 0
        back = max(step - edge, 0)
        before = height[int(np.rint(row + back * north)), int(np.rint(column + back * east))]
        if height[r, c] <= min(top, before) - WALL_M:
            return step
    return 0


def islands(
    xyz: Float, grid: Index, ground: Mask, asked: Mask, near: Float, cell_m: float
) -> Mask:  # fmt: skip
    """Cells whose ground hangs together with too little: (rows, columns) bool.

    Parameters
    ----------
    xyz, grid, cell_m
        As :func:`levelled` has them.
    ground, asked : (rows, columns) bool
        Cells with ground; those of them to be told.
    near : (rows, columns) float64
        How far off a node may hang together with that of each cell [m]; the less of both counts.
    """
    kind = np.where(ground, _UNKNOWN, _NONE).astype(np.uint8)
    _tell_islands(xyz, grid, near, np.ceil(near / cell_m).astype(np.int64), asked, kind)
    found: Mask = asked & (kind == _SMALL)
    return found


@njit()
def _tell_islands(
    xyz: Float, grid: Index, near: Float, reach: Index, asked: Mask, kind: NDArray[np.uint8]
) -> None:
    """Tell ground of islands from that of the rest, each as soon as enough of it is known."""
    rows, columns = kind.shape
    queue = np.empty(ISLAND, dtype=np.int64)
    for first in range(rows * columns):
        row, column = first // columns, first % columns
        if not asked[row, column] or kind[row, column] != _UNKNOWN:
            continue
        kind[row, column] = _QUEUED
        queue[0], held, done, land = first, 1, 0, False
        while done < held and not land:
            held, land = _look_around(xyz, grid, near, reach, kind, queue, held, queue[done])
            done += 1
        found = _LARGE if land else _SMALL
        for k in range(held):
            kind[queue[k] // columns, queue[k] % columns] = found


@njit()
def _look_around(
    xyz: Float, grid: Index, near: Float, reach: Index, kind: NDArray[np.uint8], queue: Index,
    held: int, at: int,
) -> tuple[int, bool]:  # fmt: skip
    """Put what hangs together with a cell into the queue, until that is no island.

    Returns how many are in the queue then, and whether it is land.
    """
    rows, columns = kind.shape
    row, column = at // columns, at % columns
    i, far = grid[row, column], reach[row, column]
    # From near to far, as land beside a cell ends the search.
    for k in range(2 * far + 1):
        r = row + (k + 1) // 2 * (1 - 2 * (k % 2))
        if not 0 <= r < rows:
            continue
        for c in range(max(column - far, 0), min(column + far + 1, columns)):
            if kind[r, c] != _UNKNOWN and kind[r, c] != _LARGE:
                continue
            j = grid[r, c]
            east, north = xyz[j, 0] - xyz[i, 0], xyz[j, 1] - xyz[i, 1]
            away = np.sqrt(east * east + north * north)
            step = STEP_M + STEP_SLOPE * away
            if away > min(near[row, column], near[r, c]) or abs(xyz[j, 2] - xyz[i, 2]) > step:
                continue
            if kind[r, c] == _LARGE:
                return held, True
            kind[r, c] = _QUEUED
            queue[held] = r * columns + c
            held += 1
            if held == ISLAND:
                return held, True
    return held, False


@njit()
def _grow(xyz: Float, grid: Index, reach_m: Float, cell_m: float, state: NDArray[np.uint8]) -> None:
    """Let ground grow round by round, each from what the last one left."""
    rows, columns = grid.shape
    fresh = state == GROUND
    room = np.empty(((2 * int(np.ceil(reach_m.max() / cell_m)) + 1) ** 2, AROUND))
    for _ in range(ROUNDS):
        joins = np.zeros(grid.shape, dtype=np.bool_)
        grew = False
        for r in range(rows):
            for c in range(columns):
                if state[r, c] != OTHER:
                    continue
                reach = int(np.ceil(reach_m[r, c] / cell_m))
                if beside(fresh, r, c, reach):
                    held = ground_around(xyz, grid, state, reach, reach_m[r, c], r, c, room)
                    joins[r, c] = _goes_on(room[:held], reach_m[r, c])
                    grew |= joins[r, c]
        if not grew:
            break
        for r in range(rows):
            for c in range(columns):
                if joins[r, c]:
                    state[r, c] = GROWN
        fresh = joins


@njit()
def _goes_on(around: Float, reach_m: float) -> bool:
    """Whether a node lies on the plane of the ground on one side of it."""
    if len(around) < FEWEST:
        return False
    for east, north in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        side = plane_beside(around, east, north)
        if not side.grown >= 0.0 or side.slope > STEEP:
            continue
        if side.rough_m > ROUGH_M or side.away_m > GAP * reach_m:
            continue
        down = DOWN * side.away_m + NEAR_M
        # The plane may be carried on too far, hence the nearest node as well.
        above = -side.up_m <= side.slope * side.away_m + NEAR_M
        if above and -NEAR_M <= side.plane_m <= down:
            return True
    return False
