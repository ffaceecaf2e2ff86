"""Ground that goes on where an opening has cut it off: rims, decks and roofs; slow twins."""

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from spl_batch.airborne.ground.multiscale.grown_ground import (
    ROUNDS,
    edges,
    grown,
)
from spl_batch.airborne.ground.multiscale.node_planes import LEAST, nearest_nodes, on_one_side
from spl_batch.airborne.ground.multiscale.objects import objects
from spl_batch.airborne.ground.node_grids import lowest_nodes, nearest_node
from spl_batch.airborne.ground.scales import (
    EDGE_M,
    LAYER_M,
    ROUGH_M,
    STEEP,
    TILT,
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


@pytest.mark.parametrize(("gap_m", "stays"), [(0.0, True), (2.0, False)])
def test_the_side_of_a_dam_on_even_ground_is_climbed_from_its_foot_but_no_roof(
    gap_m: float, *, stays: bool
) -> None:
    x, y = (along.ravel() for along in np.meshgrid(np.arange(70.0), np.arange(12.0)))
    z = np.where(np.abs(x - 35) < 5, gap_m + 0.9 * (5 - np.abs(x - 35)), 0.0)
    xyz = np.column_stack([x, y, z])
    grid = lowest_nodes(xyz, np.ones(len(x), dtype=np.bool_), 1.0)
    ground = (np.abs(x - 35) > 3) & ((z == 0) | (y > 4) & (x < 35))
    top = (np.abs(x - 35) < 3) & (x <= 35)
    found = grown(xyz, grid, nearest_node(grid), ground, np.ones(len(xyz)))
    assert found[top].all()
    found[found] = ~objects(xyz[found], ground[found])
    assert found[top].mean() == stays


def test_a_rim_is_an_edge_and_a_plain_is_none() -> None:
    height = np.zeros((60, 110))
    height[:, 30:] = 8.0
    found = edges(height, height > 4)
    assert found[:, 30:68].all()
    assert not found[:, 72:].any()
    assert not found[height < 4].any()


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
    wall = dict(zip(grid[held], edges(xyz[nearest, 2], held & ~ground[grid])[held], strict=True))
    nodes = np.array(sorted(wall))
    order = {
        i: nodes[np.argsort(np.hypot(*(xyz[nodes, :2] - xyz[i, :2]).T), kind="stable")[1:21]]
        for i in nodes
    }
    level = {i for i in nodes if ground[i]}
    out, fresh = set(level), set(level)
    for _ in range(ROUNDS):
        asked = [i for i in nodes if i not in out and fresh & set(order[i][:8].tolist())]
        up = {i for i in asked if _goes_on(xyz, order[i], out, i, (STEEP, np.inf))}
        on = {i for i in asked if wall[i] and _goes_on(xyz, order[i], level, i, (0.0, STEEP), wide)}
        fresh = up | on
        if not fresh:
            break
        out, level = out | fresh, level | on
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
