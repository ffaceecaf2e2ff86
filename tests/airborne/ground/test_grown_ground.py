"""Ground that goes on where an opening has cut it off: rims, decks and roofs; slow twins."""

from collections import Counter
from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from spl_batch.airborne.ground.ground_trend import fit_trend, trend_at
from spl_batch.airborne.ground.multiscale.grown_ground import (
    ISLAND,
    ROUNDS,
    barred,
    edges,
    grown,
)
from spl_batch.airborne.ground.multiscale.node_planes import LEAST, nearest_nodes, on_one_side
from spl_batch.airborne.ground.node_grids import lowest_nodes, nearest_node
from spl_batch.airborne.ground.scales import (
    APART_M,
    BESIDE_M,
    EDGE_M,
    LAYER_M,
    NARROW_M,
    ROUGH_M,
    STEEP,
    TILT,
    WIDE_M,
)
from tests.airborne.ground.clouds import ground_of, table
from tests.airborne.ground.test_node_planes import slow_plane

Float = NDArray[np.float64]
Mask = NDArray[np.bool_]


def hillside(seed: int, edge: int = 20) -> tuple[Float, NDArray[np.int64], Mask]:
    """Nodes of a ridge on a slope with blocks on it, their grid, and what is left of its ground."""
    rng = np.random.default_rng(seed)
    n = edge * edge
    x, y = (v.ravel() + rng.uniform(0, 1, n) for v in np.meshgrid(*[np.arange(edge)] * 2))
    height = np.maximum(12 - 1.4 * np.abs(x - 10), 0) + 0.1 * y
    block = (np.abs(y - 10) < 2) & (np.abs(x - 15) < 3)
    height += rng.choice([0, 0, 0, 1.5], n) + 3.0 * block + rng.normal(0, 0.1, n)
    xyz = np.column_stack([x, y, height])
    grid = lowest_nodes(xyz, rng.random(n) < 0.9, 1.0)
    return xyz, grid, (np.abs(x - 10) > 5) & (rng.random(n) < 0.8)


def terraces(seed: int) -> tuple[Float, NDArray[np.int64], Mask]:
    """Nodes of two levels with a jagged step between, and what is left of their ground."""
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(0, 30, (2, 500))
    upper = x > 15 + 3 * np.sin(y)
    xyz = np.column_stack([x, y, 6.0 * upper + 0.02 * y + rng.normal(0, 0.04, len(x))])
    grid = lowest_nodes(xyz, np.ones(len(x), dtype=np.bool_), 1.0)
    return xyz, grid, (np.abs(x - 15) > 5) & (rng.random(len(x)) < 0.9)


@pytest.mark.parametrize(("scene", "more"), [(terraces, 25), (hillside, 5)])
@pytest.mark.parametrize(("seed", "point_m"), [(0, 0.4), (1, 0.4), (1, 1.8)])
def test_nodes_that_ground_goes_on_to_are_those_of_a_slow_twin(
    scene: Callable[[int], tuple[Float, NDArray[np.int64], Mask]],
    more: int,
    seed: int,
    point_m: float,
) -> None:
    xyz, grid, ground = scene(seed)
    found = grown(xyz, grid, nearest_node(grid), ground, np.full(len(xyz), point_m))
    assert np.array_equal(found, _grown(xyz, grid, ground, max(point_m, 1.0)))
    assert found.sum() > ground.sum() + more


def test_nothing_grows_from_a_few_nodes_on_a_roof() -> None:
    xyz, grid, _ = terraces(3)
    upper = xyz[:, 2] > 3
    few = np.flatnonzero(upper & (np.abs(xyz[:, 1] - 10) < 2))
    assert 6 < len(few) < ISLAND
    ground = ~upper
    ground[few] = True
    assert not grown(xyz, grid, nearest_node(grid), ground, np.ones(len(xyz)))[upper].sum() > len(
        few
    )


@pytest.mark.parametrize(("gap_m", "grows"), [(0.0, True), (2.0, False)])
def test_the_side_of_a_dam_on_even_ground_is_climbed_from_its_foot_but_no_roof(
    gap_m: float, *, grows: bool
) -> None:
    x, y = (along.ravel() for along in np.meshgrid(np.arange(70.0), np.arange(12.0)))
    z = np.where(np.abs(x - 35) < 5, gap_m + 0.9 * (5 - np.abs(x - 35)), 0.0)
    xyz = np.column_stack([x, y, z])
    grid = lowest_nodes(xyz, np.ones(len(x), dtype=np.bool_), 1.0)
    ground = (np.abs(x - 35) > 3) & ((z == 0) | (y > 4) & (x < 35))
    top = (np.abs(x - 35) < 3) & (x <= 35)
    assert barred(xyz, grid, ground)[1].all()
    assert grown(xyz, grid, nearest_node(grid), ground, np.ones(len(xyz)))[top].mean() == grows


@pytest.mark.parametrize("stretched", [1.0, 2.5])
@pytest.mark.parametrize("seed", range(2))
def test_nodes_between_two_steps_are_those_of_a_slow_twin(seed: int, stretched: float) -> None:
    xyz, grid, ground = hillside(seed)
    xyz = xyz * [1.0, 1.0, stretched]
    roof, even = barred(xyz, grid, ground)
    trend = fit_trend(xyz[ground], xyz[:, 0], xyz[:, 1])
    east, north = (
        trend_at(trend._replace(height=np.gradient(trend.height, WIDE_M, axis=a)), *xyz[:, :2].T)
        for a in (1, 0)
    )
    height = np.where(grid >= 0, xyz[grid, 2], np.nan)
    off = height - trend_at(trend, *xyz[:, :2].T)[grid]
    tilt = np.where(grid >= 0, np.hypot(east, north)[grid], 0.0)
    known = np.argwhere((grid >= 0) & ground[grid])
    ends = 0
    for cell in np.argwhere(grid >= 0):
        node = grid[*cell]
        along = np.array([-east[node], north[node]]) / tilt[*cell]
        stands = (
            tilt[*cell] > TILT
            and np.hypot(*(known - cell).T).min() <= WIDE_M
            and off[*cell] > EDGE_M / 2
            and all(_ends(off, cell, way * along) for way in (1, -1))
        )
        low, high = np.maximum(cell - round(NARROW_M), 0), cell + round(NARROW_M) + 1
        level = tilt[low[0] : high[0], low[1] : high[1]].max() <= TILT
        assert (roof[*cell], even[*cell]) == (stands, level)
        ends += stands
    assert ends > 5


def _ends(off: Float, cell: NDArray[np.int64], way: Float) -> bool:
    """Whether the way from the cell has a step down."""
    passed: dict[int, float] = {}
    for step in range(round(NARROW_M) + 1):
        at = np.rint(cell + step * way).astype(int)
        if (at < 0).any() or (at >= off.shape).any():
            break
        if np.isfinite(off[*at]):
            passed[step] = off[*at]
    return any(
        here <= min(off[*cell], passed[back]) - EDGE_M
        for step, here in passed.items()
        for back in range(step - round(BESIDE_M), step)
        if back in passed
    )


def test_a_rim_is_an_edge_and_neither_a_deck_nor_a_plain_is() -> None:
    height = np.zeros((60, 110))
    height[:, 30:] = 8.0
    height[25:35, 5:30] = 8.0
    found = edges(height, height > 4)
    assert not found[25:35, 5:25].any()
    assert found[:15, 30:68].all()
    assert not found[:, 72:].any()
    assert not found[height < 4].any()


def test_what_widens_behind_its_end_is_a_corner_and_a_pier_is_none() -> None:
    row, column = np.mgrid[0:60, 0:80]
    across = np.abs(row - 30)
    height = np.where(across < 40 - column, 5.0, 0.0)
    assert edges(height, height > 0)[26:35, 34].all()
    pier = np.where((column < 20) | ((across < 5) & (column < 60)), 5.0, 0.0)
    assert not edges(pier, pier > 0)[26:35, 24:60].any()


@pytest.mark.parametrize("turned_deg", [3, 12, 30])
def test_a_deck_that_lies_oblique_to_the_grid_is_no_corner(turned_deg: float) -> None:
    row, column = np.mgrid[0:90, 0:120]
    cos, sin = np.cos(np.radians(turned_deg)), np.sin(np.radians(turned_deg))
    along, across = cos * column + sin * (row - 30), cos * (row - 30) - sin * column
    height = np.where((along < 20) | (along > 80) | (np.abs(across) < 4.5), 7.0, 0.0)
    deck = (along > 26) & (along < 74) & (np.abs(across) < 4.5)
    assert deck.sum() > 350
    assert not edges(height, height > 0)[deck].any()


def test_the_rim_of_a_low_cliff_on_a_slope_is_ground() -> None:
    rng = np.random.default_rng(7)
    x, y = rng.uniform(0, 120, (2, 24_000))
    rim = 60 + 0.1 * x + 3 * np.sin(x / 4)
    z = 0.3 * x + 0.3 * y + 6.0 * (y < rim) + rng.normal(0, 0.03, len(x))
    leaf = rng.random(len(x)) < 0.5
    z[leaf] += rng.uniform(1, 14, leaf.sum())
    near = (y < rim) & (y > 48 + 0.1 * x) & ~leaf & (np.abs(x - 60) < 50)
    assert ground_of(table(x, y, z))[near].mean() > 0.7


@pytest.mark.parametrize(("behind_m", "grows"), [(0.8, True), (0.0, False), (-3.0, True)])
def test_ground_grows_up_no_shrub_but_to_crests_and_rims(behind_m: float, *, grows: bool) -> None:
    x, y = (along.ravel() for along in np.meshgrid(np.arange(-5.0, 6.0), np.arange(-5.0, 6.0)))
    height = np.where(x <= 0, 0.16 * (x + 5), behind_m)  # the flank of a shrub, and ground behind
    xyz = np.column_stack([x, y, 0.9 * x + height])
    node = int(np.flatnonzero((x == 0) & (y == 0))[0])
    near = nearest_nodes(xyz)[node]
    weight = np.ones(len(xyz))
    weight[x == 0] = 0.0

    def grown_to(wall_m: float) -> bool:
        limits = (LAYER_M, TILT), (ROUGH_M, TILT), (STEEP, np.inf)
        return on_one_side(xyz, near, weight, node, *limits, wall_m)

    assert grown_to(0.0)
    assert grown_to(EDGE_M) == grows


def _grown(xyz: Float, grid: NDArray[np.int64], ground: Mask, wide: float) -> Mask:
    """Round by round, every node against planes of one side by least squares."""
    nearest = nearest_node(grid)
    held = grid >= 0
    roof, even = (cells[held] for cells in barred(xyz, grid, ground))
    free = dict(zip(grid[held], ~roof, strict=True))
    sloping = dict(zip(grid[held], ~even, strict=True))
    other = held & ~ground[grid]
    wall = dict(zip(grid[held], edges(xyz[nearest, 2], other)[held], strict=True))
    nodes = np.array(sorted(free))
    order = {
        i: nodes[np.argsort(np.hypot(*(xyz[nodes, :2] - xyz[i, :2]).T), kind="stable")[1:21]]
        for i in nodes
    }
    part, graph = {i: i for i in nodes}, [i for i in nodes if ground[i]]

    def root(i: int) -> int:
        return i if part[i] == i else root(part[i])

    for i in graph:
        for j in order[i][:8]:
            apart = np.hypot(*(xyz[i, :2] - xyz[j, :2]))
            if ground[j] and abs(xyz[i, 2] - xyz[j, 2]) <= max(APART_M, STEEP * apart):
                part[root(i)] = root(j)
    size = Counter(root(i) for i in graph)
    level = {i for i in graph if size[root(i)] >= ISLAND}
    steep = {i for i in graph if free[i] and (i in level or sloping[i])}
    out, fresh = set(graph), set(graph)
    for _ in range(ROUNDS):
        asked = [i for i in nodes if i not in out and fresh & set(order[i][:8].tolist())]
        up = {i for i in asked if free[i] and _goes_on(xyz, order[i], steep, i, (STEEP, np.inf))}
        on = {i for i in asked if wall[i] and _goes_on(xyz, order[i], level, i, (0.0, STEEP), wide)}
        fresh = up | on
        if not fresh:
            break
        out, level = out | fresh, level | on
        steep |= {i for i in fresh if free[i]}
    found = ground.copy()
    found[list(out)] = True
    return found


def _goes_on(
    xyz: Float,
    order: NDArray[np.int64],
    ground: set[int],
    i: int,
    slopes: tuple[float, float],
    wide: float = 1.0,
) -> bool:
    least, most = slopes
    fits, denied = np.zeros(8, bool), np.zeros(8, bool)
    for k, turn in enumerate(np.arange(0, 2 * np.pi, np.pi / 4)):
        ahead = (xyz[order, :2] - xyz[i, :2]) @ [np.cos(turn), np.sin(turn)] >= 0
        side = np.array([j for j in order[ahead] if j in ground], dtype=int)
        if len(side):
            counted, above, slope, scatter = slow_plane(xyz, np.ones(len(xyz)), i, side)
            uneven_m = TILT * slope if least else 0.0
            if counted >= LEAST and scatter <= wide * ROUGH_M + uneven_m:
                denied[(k + 4) % 8] = wide * LAYER_M + uneven_m < above < EDGE_M
                fits[k] = above <= wide * LAYER_M + uneven_m and least <= slope <= most
    return bool((fits & ~denied).any())


def test_the_corner_of_a_plateau_is_ground() -> None:
    rng = np.random.default_rng(7)
    x, y = rng.uniform(0, 140, (2, 30_000))
    plateau = (x < 70 + 0.3 * y) & (y < 90)
    found = ground_of(table(x, y, 14.0 * plateau + rng.normal(0, 0.03, len(x))))
    tip = plateau & (y > 80) & (x > 82)
    assert tip.sum() > 150
    assert found[tip].mean() > 0.8
