"""Ground that goes on where an opening has cut it off: crests, edges and tops of steep slopes.

An opening takes a crest that is narrower than its window for an object: both stand out. An object
stands behind walls, though, and steep ground goes on from what was left of it. Here ground grows
from cell to cell where the plane through the ground nodes around is steep and the next node lies on
it, or below it and no lower than those nodes, as over a crest. What has grown goes on over level
ground as well: tops of banks. Ground that is level all around grows nowhere, so neither decks nor
the roofs of a town are reached.

The plane is that of one side, so that the two flanks of a crest do not level each other out. No
source has this: [Axelsson 2000] mirrors points at the nearest one of the ground there.

A roof on a hillside is steep as well, and the opening leaves its uphill eave. But a roof ends: on
the contour line through it the surface falls by a step on both sides, as it does not from a crest,
a cliff or a terrace, which follow the contour. From nodes that stand so no ground grows, and none
grows there (:func:`standing`). The corner of a plateau stands so as well, but falls farther than a
house does.
"""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.ground.ground_trend import STEP_M as TREND_M
from spl_batch.airborne.ground.ground_trend import Trend, fit_trend, trend_at
from spl_batch.numerics.compiled import njit

REACH_M: Final = 4.0
"""Ground nodes up to this far tell the plane [m]."""

FEWEST: Final = 6
"""Fewer nodes tell none [count]."""

STEEP: Final = 0.5
"""Rise of the plane from which on ground grows [rise/run]."""

NEAR_M: Final = 0.2
"""A node farther above the plane is something else's [m]."""

ROUGH_M: Final = 0.3
"""Nodes that scatter by more around their plane are on both sides of a step: a wall or an edge goes
on nowhere [m]."""

FLAT: Final = 0.02
"""Places of nodes that lie nearer to one line than this tell no plane: product of their variances
along and across over the square of their sum."""

ROUNDS: Final = 40
"""Cells that ground grows by at the most: the largest window of the opening [count]."""

TILT: Final = 0.2
"""Rise of the trend from which on it tells the contour line [rise/run]."""

ASIDE_M: Final = 20.0
"""How far along the contour the ends of an object are looked for: half of the largest window
[m]."""

EAVE_M: Final = 1.0
"""Fall at the end of an object; above the trend it stands half as far [m]."""

EDGE_M: Final = 2.0
"""Longest way over which the surface falls there, from one node to the next [m]."""

CLIFF_M: Final = 8.0
"""What falls by more on both sides is no house [m]."""

BARRED: Final = 0
OTHER: Final = 1
GROUND: Final = 2
GROWN: Final = 3
"""States of a cell: nothing that could grow, a node that may, ground, ground that has grown."""

Float = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.int64]


def continued(xyz: Float, grid: Index, ground: Mask, cell_m: float) -> Mask:
    """Ground nodes, and those of a grid that go on from them: (n,) bool.

    Parameters
    ----------
    xyz : (n, 3) float64
        Nodes [m].
    grid : (rows, columns) int64
        A node for each cell, or -1, as :func:`~spl_batch.airborne.ground.node_grids.lowest_nodes`
        finds them.
    ground : (n,) bool
        Nodes of the ground.
    cell_m : float
        Edge of a cell [m].
    """
    stands = standing(xyz, grid, ground, cell_m)
    state = np.full(grid.shape, BARRED, dtype=np.uint8)
    held = (grid >= 0) & ~stands
    state[held] = np.where(ground[grid[held]], GROUND, OTHER)
    _grow(xyz, grid, round(REACH_M / cell_m), state)
    out = ground.copy()
    out[grid[state == GROWN]] = True
    return out


def standing(xyz: Float, grid: Index, ground: Mask, cell_m: float) -> Mask:
    """Cells whose node stands above a step on both sides along the contour: (rows, columns) bool.

    Parameters
    ----------
    xyz, grid, ground, cell_m
        As :func:`continued` has them.
    """
    stands = np.zeros(grid.shape, dtype=np.bool_)
    if not ground.any():
        return stands
    nodes = grid[grid >= 0]
    x, y = (xyz[nodes, axis] for axis in (0, 1))
    trend = fit_trend(xyz[ground], x, y)
    above, aside = np.full(len(xyz), np.nan), np.zeros((len(xyz), 2))
    above[nodes] = xyz[nodes, 2] - trend_at(trend, x, y)
    some = above[nodes] > EAVE_M / 2
    nodes, x, y = nodes[some], x[some], y[some]
    north, east = (
        trend_at(Trend(np.gradient(trend.height, TREND_M, axis=axis), *trend[1:]), x, y)
        for axis in (0, 1)
    )
    steep = np.hypot(north, east)
    tilted = steep > TILT
    aside[nodes[tilted]] = np.column_stack([-east, north])[tilted] / steep[tilted, None]
    _stand(xyz, grid, ground, above, aside, cell_m, stands)
    return stands


@njit()
def _stand(
    xyz: Float, grid: Index, ground: Mask, above: Float, aside: Float, cell_m: float, out: Mask
) -> None:
    """Cells between two steps; ``aside`` is along the contour to north and east, or zero."""
    rows, columns = grid.shape
    for r in range(rows):
        for c in range(columns):
            i = grid[r, c]
            if i < 0:
                continue
            north, east = aside[i]
            if north == 0.0 and east == 0.0:
                continue
            # Across a crest that is cut off the trend is that between its rims: no contour.
            if _is_near(grid, ground, r, c, cell_m):
                one = _fall_m(xyz, grid, above, r, c, north, east, cell_m)
                other = _fall_m(xyz, grid, above, r, c, -north, -east, cell_m)
                out[r, c] = min(one, other) > 0.0 and min(one, other) < CLIFF_M


@njit()
def _is_near(grid: Index, ground: Mask, row: int, column: int, cell_m: float) -> bool:
    """Whether a cell with ground is within reach."""
    rows, columns = grid.shape
    reach = int(REACH_M / cell_m)
    for r in range(max(row - reach, 0), min(row + reach + 1, rows)):
        for c in range(max(column - reach, 0), min(column + reach + 1, columns)):
            away = np.sqrt((r - row) ** 2 + (c - column) ** 2) * cell_m
            if grid[r, c] >= 0 and ground[grid[r, c]] and away <= REACH_M:
                return True
    return False


@njit()
def _fall_m(
    xyz: Float, grid: Index, above: Float, row: int, column: int, north: float, east: float,
    cell_m: float,
) -> float:  # fmt: skip
    """How far below a cell the surface lies where it falls by a step on the way; 0 if nowhere."""
    rows, columns = grid.shape
    top, at, fall_m = above[grid[row, column]], 0, 0.0
    height = xyz[grid[row, column], 2]
    edge, last = round(EDGE_M / cell_m), top
    end = round(ASIDE_M / cell_m)
    for step in range(1, round((ASIDE_M + EDGE_M) / cell_m) + 1):
        r, c = int(np.rint(row + step * north)), int(np.rint(column + step * east))
        if step > end or r < 0 or c < 0 or r >= rows or c >= columns:
            break
        i = grid[r, c]
        if i < 0:
            continue
        if above[i] <= min(top, last) - EAVE_M and step - at <= edge and fall_m == 0.0:
            end = step + edge  # a node half-way down is not the foot yet
            fall_m = max(height - xyz[i, 2], EAVE_M)
        elif fall_m > 0.0:
            fall_m = max(fall_m, height - xyz[i, 2])
        last, at = above[i], step
    return fall_m


@njit()
def _grow(xyz: Float, grid: Index, reach: int, state: NDArray[np.uint8]) -> None:
    """Let ground grow round by round, each from what the last one left."""
    rows, columns = grid.shape
    fresh = state == GROUND
    room = np.empty(((2 * reach + 1) ** 2, AROUND))
    for _ in range(ROUNDS):
        joins = np.zeros(grid.shape, dtype=np.bool_)
        for r in range(rows):
            for c in range(columns):
                if state[r, c] == OTHER and beside(fresh, r, c, 2):
                    held = ground_around(xyz, grid, state, reach, REACH_M, r, c, room)
                    joins[r, c] = _goes_on(room[:held])
        if not joins.any():
            break
        for r in range(rows):
            for c in range(columns):
                if joins[r, c]:
                    state[r, c] = GROWN
        fresh = joins


@njit()
def beside(fresh: Mask, row: int, column: int, far: int) -> bool:
    """Whether a cell that has just become ground is near."""
    rows, columns = fresh.shape
    for r in range(max(row - far, 0), min(row + far + 1, rows)):
        for c in range(max(column - far, 0), min(column + far + 1, columns)):
            if fresh[r, c]:
                return True
    return False


@njit()
def _goes_on(around: Float) -> bool:
    """Whether a node lies where the ground on one side of it goes on."""
    if len(around) < FEWEST:
        return False
    for east, north in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        side = plane_beside(around, east, north)
        if not side.grown >= 0.0 or side.rough_m > ROUGH_M:
            continue
        if side.slope < STEEP and side.grown < 0.5:
            continue
        if -NEAR_M <= side.plane_m <= side.slope * side.away_m + NEAR_M:
            return True
    return False


AROUND: Final = 7
"""What is known of ground around a node: how far it is to east and north and higher [m], the square
of its distance [m2], columns and rows to it, and whether it has grown."""


@njit()
def ground_around(
    xyz: Float,
    grid: Index,
    state: NDArray[np.uint8],
    reach: int,
    reach_m: float,
    row: int,
    column: int,
    out: Float,
) -> int:
    """Ground around a node, row by row; how much of it.

    Parameters
    ----------
    xyz : (n, 3) float64
        Nodes [m].
    grid : (rows, columns) int64
        A node for each cell, or -1.
    state : (rows, columns) uint8
        What each cell is: ground from 2 on, 3 where it has grown.
    reach : int
        Cells to look at on each side [count].
    reach_m : float
        Farthest ground that counts [m].
    row, column : int
        Cell of the node.
    out : (m, AROUND) float64
        Filled, as far as there is ground.
    """
    rows, columns = grid.shape
    i, held = grid[row, column], 0
    for r in range(max(row - reach, 0), min(row + reach + 1, rows)):
        for c in range(max(column - reach, 0), min(column + reach + 1, columns)):
            if state[r, c] < GROUND:
                continue
            j = grid[r, c]
            dx, dy, dz = xyz[j, 0] - xyz[i, 0], xyz[j, 1] - xyz[i, 1], xyz[j, 2] - xyz[i, 2]
            away = dx * dx + dy * dy
            if away <= reach_m**2:
                found = out[held]
                found[0], found[1], found[2], found[3] = dx, dy, dz, away
                found[4], found[5], found[6] = c - column, r - row, state[r, c] == GROWN
                held += 1
    return held


class Side(NamedTuple):
    """Plane through the ground on one side of a node.

    Parameters
    ----------
    plane_m : float
        How far it lies above the node [m].
    slope : float
        Its rise [rise/run].
    rough_m : float
        Standard deviation of that ground about it [m].
    away_m, up_m : float
        How far off the nearest node of that ground is, and how much higher than the node [m].
    grown : float
        Share of that ground that has grown; NaN where there is no plane.
    """

    plane_m: float
    slope: float
    rough_m: float
    away_m: float
    up_m: float
    grown: float


@njit()
def plane_beside(around: Float, to_east: int, to_north: int) -> Side:
    """Plane through the ground on the side of a node towards east or north.

    Parameters
    ----------
    around : (m, AROUND) float64
        Ground around it, by :func:`ground_around`.
    to_east, to_north : int
        The side.
    """
    n, grown, nearest, up = 0, 0, np.inf, 0.0
    x, y, z, xx, xy, yy, xz, yz, zz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(len(around)):
        here = around[k]
        if here[4] * to_east + here[5] * to_north < 0.0:
            continue
        dx, dy, dz, away = here[0], here[1], here[2], here[3]
        n += 1
        grown += int(here[6])
        if away < nearest:
            nearest, up = away, dz
        x, y, z = x + dx, y + dy, z + dz
        xx, xy, yy = xx + dx * dx, xy + dx * dy, yy + dy * dy
        xz, yz, zz = xz + dx * dz, yz + dy * dz, zz + dz * dz
    if n < FEWEST:
        return Side(0.0, 0.0, 0.0, 0.0, 0.0, np.nan)
    x, y, z = x / n, y / n, z / n
    xx, yy, xy = xx / n - x * x, yy / n - y * y, xy / n - x * y
    xz, yz, zz = xz / n - x * z, yz / n - y * z, zz / n - z * z
    scale = xx * yy - xy * xy
    if scale < FLAT * (xx + yy) ** 2:
        return Side(0.0, 0.0, 0.0, 0.0, 0.0, np.nan)
    east, north = (yy * xz - xy * yz) / scale, (xx * yz - xy * xz) / scale
    rough = np.sqrt(max(zz - east * xz - north * yz, 0.0))
    # The node is the origin.
    plane = z - east * x - north * y
    return Side(plane, np.hypot(east, north), rough, np.sqrt(nearest), up, grown / n)
