"""Lone returns below level ground that few returns show."""

import numpy as np
import pytest

from spl_batch.airborne.ground.multiscale import lone_returns as rule


def lake(
    seed: int, share_low: float, edge_m: float = 40.0, per_m2: float = 0.3
) -> tuple[np.ndarray, np.ndarray]:
    """Single returns of water, and of sunlight below it."""
    rng = np.random.default_rng(seed)
    n = int(per_m2 * edge_m**2)
    xyz = np.column_stack([*rng.uniform(0, edge_m, (2, n)), rng.normal(210, 0.07, n)])
    low = rng.random(n) < share_low
    xyz[low, 2] -= rng.uniform(0.6, 4.0, int(low.sum()))
    return xyz, low


def plain(xyz: np.ndarray, ground: np.ndarray, lone: np.ndarray) -> np.ndarray:
    """The same with dictionaries and numpy."""
    cell = np.floor(xyz[:, :2]).astype(int)

    def lowest(of: np.ndarray) -> dict[tuple[int, int], int]:
        order = sorted(np.flatnonzero(of), key=lambda i: -xyz[i, 2])
        return {(cell[i, 0], cell[i, 1]): int(i) for i in order}

    def near(nodes: dict[tuple[int, int], int], i: int, reach: int) -> list[int]:
        around = (np.abs(np.subtract(place, cell[i])).max() <= reach for place in nodes)
        return [j for j, is_near in zip(nodes.values(), around, strict=True) if is_near and j != i]

    left, every = ground.copy(), lowest(ground)
    for reach in (4, 4, 4, 4, 8, 8, 8, 8):
        nodes, found = lowest(left), []
        for i in np.flatnonzero(left & lone):
            around = np.array(near(nodes, i, reach))
            if len(around) < 6:
                continue
            median = np.sort(xyz[around, 2])[len(around) // 2]
            level = np.abs(xyz[around, 2] - median) <= 0.2
            of_lone = np.mean(lone[around[level]]) > 0.5
            beside = np.sum(np.abs(xyz[near(every, i, 4), 2] - xyz[i, 2]) <= 0.3)
            if level.mean() >= 0.5 and of_lone and xyz[i, 2] < median - 0.4 and beside < 3:
                found.append(i)
        left[found] = False
    return ground & ~left


@pytest.mark.parametrize("seed", [1, 2])
def test_lone_returns_below_water_are_those_of_a_slow_twin(seed: int) -> None:
    xyz, low = lake(seed, 0.2, 22.0)
    rng = np.random.default_rng(seed + 9)
    ground, lone = rng.random((2, len(xyz))) < np.array([[0.95], [0.8]])
    found = rule.below_level(xyz, ground, lone)
    assert found.tolist() == plain(xyz, ground, lone).tolist()
    assert found[low & ground & lone].mean() > 0.5
    assert not found[~low].any()


def test_pits_and_ditches_that_several_returns_show_stay() -> None:
    xyz, _ = lake(3, 0.0, per_m2=1.0)
    pit = np.hypot(xyz[:, 0] - 12.0, xyz[:, 1] - 12.0) < 1.6
    ditch = np.abs(xyz[:, 0] - 30.0) < 0.8
    xyz[pit | ditch, 2] -= 1.0
    every = np.ones(len(xyz), bool)
    inner = xyz[:, 1] < 37.0
    assert not rule.below_level(xyz, every, every)[inner].any()
    xyz[np.flatnonzero(pit)[0], 2] -= 1.0
    found = rule.below_level(xyz, every, every) & inner
    assert np.flatnonzero(found).tolist() == [np.flatnonzero(pit)[0]]


def test_below_a_slope_nothing_is_told() -> None:
    xyz, _ = lake(4, 0.1)
    xyz[:, 2] += 0.4 * xyz[:, 0]
    every = np.ones(len(xyz), bool)
    assert not rule.below_level(xyz, every, every).any()


def test_a_well_filled_node_is_no_lone_return() -> None:
    xyz, low = lake(5, 0.1)
    assert not rule.below_level(xyz, np.ones(len(xyz), bool), ~low).any()
