"""Ground that goes on where an opening has cut it off: crests, rims, spurs, tops of banks.

An opening takes a crest that is narrower than its window for an object, and a window fits into no
corner of a plateau: both stand out. An object stands behind walls, though, and ground goes on from
what was left of it. Here ground grows to the next node where a plane through the ground nodes of
one side goes on to it, or above it, as over a rim: the two flanks of a crest do not level each
other out. Where there is ground on the opposite side, its plane has to go on to it as well, or lie
lower by a wall: a shrub on a slope is above both. No source has this: [Axelsson 2000] mirrors
points at the nearest one of the ground.

Five things look alike and are kept out:

- a deck continues the road, but between two walls (:func:`edges`): no level ground grows there.
- where no wall is within the window, the opening has cut off plants and cars: nothing level grows.
- a town on even ground has steep roofs and walls: where the trend is level nothing steep grows from
  an island, a few nodes that hang together without a step. The side of a dam starts from land.
- a roof on a hillside is steep as well, and the opening leaves its uphill eave. But a roof ends: on
  the contour line through it the surface falls by a step on both sides, as it does not from a
  crest, a cliff or a terrace, which follow the contour (:func:`barred`).
- what an opening leaves of a roof would grow over all of it: nothing level grows from an island.
"""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from spl_batch.airborne.ground.ground_trend import Trend, fit_trend, trend_at
from spl_batch.airborne.ground.multiscale.node_planes import NEAREST, nearest_nodes, on_one_side
from spl_batch.airborne.ground.scales import (
    APART_M,
    BESIDE_M,
    CELL_M,
    EDGE_M,
    HOUSE_M2,
    LAYER_M,
    NARROW_M,
    ROUGH_M,
    SIDES,
    STEEP,
    TILT,
    WIDE_M,
    WINDOW_M,
)
from spl_batch.numerics.compiled import njit

ISLAND: Final = round(HOUSE_M2 / CELL_M**2)
"""Fewer nodes that hang together are an island [count]."""

ROUNDS: Final = round(WINDOW_M / CELL_M)
"""Nodes that ground grows by at the most: the largest window of the opening [count]."""

Float = NDArray[np.float64]
Mask = NDArray[np.bool_]
Index = NDArray[np.int64]


class Sources(NamedTuple):
    """Nodes that ground grows from, steep and level: (n,) bool each."""

    steep: Mask
    level: Mask


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
    roof, even = (cells[full] for cells in barred(xyz, grid, ground))
    land = on_land(nodes, around, known)
    other = full.copy()
    other[full] = ~known
    beside_wall = edges(xyz[nearest, 2], other)[full]
    found = known.copy()
    sources = Sources(~roof & known & (land | ~even), land)
    wide = np.maximum(point_m[index] / CELL_M, 1.0)
    _grow(nodes, around, wide, beside_wall, ~roof, sources, found)
    out = ground.copy()
    out[index[found]] = True
    return out


def on_land(nodes: Float, around: Index, ground: Mask) -> Mask:
    """Ground nodes that hang together with many others, without a step: (n,) bool.

    Parameters
    ----------
    nodes : (n, 3) float64
        Nodes [m].
    around : (n, k) int64
        Those nearest to each, itself first.
    ground : (n,) bool
        Those of the ground.
    """
    beside = around[:, 1 : SIDES + 1]
    east, north, up = np.moveaxis(nodes[beside] - nodes[:, np.newaxis], 2, 0)
    together = np.abs(up) <= np.maximum(APART_M, STEEP * np.hypot(east, north))
    together &= ground[beside] & ground[:, np.newaxis]
    ends = np.nonzero(together)[0], beside[together]
    graph = coo_array((np.ones(len(ends[0]), np.bool_), ends), shape=(len(nodes),) * 2)
    label = connected_components(graph, directed=False)[1]
    land: Mask = ground & (np.bincount(label)[label] >= ISLAND)
    return land


@njit()
def _any_beside(fresh: Mask, around: Index) -> bool:
    """Whether any of the nodes beside one is fresh."""
    found = False
    for k in range(1, SIDES + 1):
        found |= fresh[around[k]]
    return bool(found)


@njit()
def _grow(
    nodes: Float, around: Index, wide: Float, beside_wall: Mask, free: Mask, sources: Sources,
    ground: Mask,
) -> None:  # fmt: skip
    """Let ground grow round by round: level beside walls, steep in cells that are free.

    Level ground is known to what it undulates by between nodes: in proportion to their distance,
    ``wide``, in cells.
    """
    fresh = ground.copy()
    steep, level = sources.steep.astype(np.float64), sources.level.astype(np.float64)
    there, here = np.empty(len(nodes), np.bool_), np.empty(len(nodes), np.bool_)
    for _ in range(ROUNDS):
        for i in range(len(nodes)):
            there[i] = here[i] = False
            if ground[i] or not _any_beside(fresh, around[i]):
                continue
            near = around[i]
            if free[i]:
                off, rough, slopes = (LAYER_M, TILT), (ROUGH_M, TILT), (STEEP, np.inf)
                there[i] = on_one_side(nodes, near, steep, i, off, rough, slopes, EDGE_M)
            if beside_wall[i]:
                off, rough = (wide[i] * LAYER_M, 0.0), (wide[i] * ROUGH_M, 0.0)
                slopes = 0.0, STEEP
                here[i] = on_one_side(nodes, near, level, i, off, rough, slopes, EDGE_M)
        grown = False
        for i in range(len(nodes)):
            fresh[i] = there[i] or here[i]
            ground[i] |= fresh[i]
            grown |= fresh[i]
            if fresh[i] and free[i]:
                steep[i] = 1.0
            if here[i]:
                level[i] = 1.0
        if not grown:
            break


def barred(xyz: Float, grid: Index, ground: Mask) -> tuple[Mask, Mask]:
    """Cells where nothing steep grows, and those where it grows from no island.

    The surface ends in a step on both sides along the contour, and the trend is level.

    Parameters
    ----------
    xyz, grid, ground
        As :func:`grown` has them.

    Returns
    -------
    roof, even : (rows, columns) bool
        The one and the other.
    """
    roof = np.zeros(grid.shape, dtype=np.bool_)
    if not ground.any():
        return roof, roof
    x, y, z = xyz.T
    trend = fit_trend(xyz[ground], x, y)
    north, east = (
        trend_at(Trend(np.gradient(trend.height, WIDE_M, axis=axis), *trend[1:]), x, y)[grid]
        for axis in (0, 1)
    )
    full = grid >= 0
    above = np.where(full, (z - trend_at(trend, x, y))[grid], np.nan)
    # Across a crest that is cut off the trend is that between its rims: no contour.
    away = ndimage.distance_transform_edt(~(full & ground[grid])) * CELL_M
    asked = full & (away <= WIDE_M) & (above > EDGE_M / 2)
    edge, far = (round(along / CELL_M) for along in (BESIDE_M, NARROW_M))
    _end_both_ways(above, north, east, edge, far, asked, roof)
    tilt = np.where(full, np.hypot(north, east), 0.0)
    even: Mask = ndimage.maximum_filter(tilt, 2 * far + 1) <= TILT
    return roof, even


@njit()
def _end_both_ways(
    above: Float, north: Float, east: Float, edge: int, far: int, asked: Mask, out: Mask
) -> None:
    """Fill with cells from which heights above a trend fall both ways across its slope."""
    for r in range(above.shape[0]):
        for c in range(above.shape[1]):
            slope = np.hypot(north[r, c], east[r, c])
            if asked[r, c] and slope > TILT:
                n, e = -east[r, c] / slope, north[r, c] / slope
                one = _ends(above, r, c, n, e, edge, far)
                out[r, c] = one and _ends(above, r, c, -n, -e, edge, far)


@njit()
def _ends(
    above: Float, row: int, column: int, north: float, east: float, edge: int, far: int
) -> bool:
    """Whether a surface falls by a step on the way from a cell; those without a node are passed."""
    rows, columns = above.shape
    top = above[row, column]
    for step in range(1, far + 1):
        r, c = int(np.rint(row + step * north)), int(np.rint(column + step * east))
        if r < 0 or c < 0 or r >= rows or c >= columns:
            break
        if np.isnan(above[r, c]):
            continue
        before = -np.inf
        for back in range(max(step - edge, 0), step):
            i, j = int(np.rint(row + back * north)), int(np.rint(column + back * east))
            before = np.fmax(before, above[i, j])  # of cells with a node
        if above[r, c] <= min(top, before) - EDGE_M:
            return True
    return False


def edges(height: Float, asked: Mask) -> Mask:
    """Cells that have a wall within reach of a window, but stand on no deck: (rows, columns) bool.

    Parameters
    ----------
    height : (rows, columns) float64
        Heights without gaps [m].
    asked : (rows, columns) bool
        Cells to look at.
    """
    out = np.zeros(height.shape, dtype=np.bool_)
    edge, far, deck = (round(along / CELL_M) for along in (BESIDE_M, WINDOW_M, NARROW_M))
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
                one = steps_to_wall(height, r, c, north, east, edge, far, EDGE_M)
                other = steps_to_wall(height, r, c, -north, -east, edge, far, EDGE_M)
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
        end = steps_to_wall(height, row, column, turn * east, -turn * north, edge, far, EDGE_M)
        if 0 < end <= span:
            ends += turn
    if ends == 0.0:
        return False
    r = int(np.rint(row - ends * span * east))
    c = int(np.rint(column + ends * span * north))
    if r < 0 or c < 0 or r >= height.shape[0] or c >= height.shape[1]:
        return False
    if abs(height[r, c] - height[row, column]) > EDGE_M:
        return False
    one = steps_to_wall(height, r, c, north, east, edge, far, EDGE_M)
    other = steps_to_wall(height, r, c, -north, -east, edge, far, EDGE_M)
    return one == 0 or other == 0 or one + other >= 2 * span


@njit()
def steps_to_wall(
    height: Float, row: int, column: int, north: float, east: float, edge: int, far: int,
    wall_m: float,
) -> int:  # fmt: skip
    """After how many cells on the way from one its surface ends in a wall; 0 where it does not.

    What rises above the cell by a wall's height is in the way: the eave of a house is none.

    Parameters
    ----------
    height : (rows, columns) float64
        Heights without gaps [m].
    row, column : int
        The cell.
    north, east : float
        The way, cell by cell [count].
    edge, far : int
        Width of a wall's edge, and how far off one counts [count].
    wall_m : float
        Least height of a wall [m].
    """
    rows, columns = height.shape
    top = height[row, column]
    for step in range(1, far + 1):
        r, c = int(np.rint(row + step * north)), int(np.rint(column + step * east))
        if r < 0 or c < 0 or r >= rows or c >= columns or height[r, c] > top + wall_m:
            return 0
        back = max(step - edge, 0)
        before = height[int(np.rint(row + back * north)), int(np.rint(column + back * east))]
        if height[r, c] <= min(top, before) - wall_m:
            return step
    return 0
