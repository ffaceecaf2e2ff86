"""Planes through nodes of the ground: plants go, rough soil stays and shows how rough it is."""

import numpy as np
import pytest

from spl_batch.airborne.ground.multiscale.node_planes import (
    RIDGE,
    above_planes,
    goes_on,
    under_planes,
    without_plants,
)
from spl_batch.airborne.ground.multiscale_surface import depths_below, ends_within, no_depths
from spl_batch.airborne.ground.scales import PLANE_M, SIGMA_M, TILT

POINT_M = 0.4


def nodes(seed: int = 1, slope: float = 0.0, rough_m: float = 0.0, side_m: float = 30.0):
    """One node to the square metre, somewhere in it."""
    rng = np.random.default_rng(seed)
    x, y = (along.ravel() for along in np.meshgrid(*[np.arange(side_m)] * 2))
    x, y = x + rng.uniform(0.1, 0.9, x.size), y + rng.uniform(0.1, 0.9, x.size)
    return np.column_stack([x, y, slope * x + rng.normal(0, rough_m, x.size)])


def nearest(xyz):
    """The 21 nodes nearest to each, itself among them."""
    apart = np.linalg.norm(xyz[:, np.newaxis, :2] - xyz[:, :2], axis=-1)
    return np.ascontiguousarray(np.argsort(apart, axis=1)[:, :21])


def slow_plane(xyz, weight, i, members):
    """Weight, height above the weighted plane, slope and scatter, by normal equations."""
    d = xyz[members] - xyz[i]
    w = weight[members] * np.exp(-(d[:, 0] ** 2 + d[:, 1] ** 2) / PLANE_M**2)
    mean = w @ d / w.sum()
    around = d - mean
    normal = (w * around[:, :2].T) @ around[:, :2] / w.sum()
    normal += np.eye(2) * (RIDGE * np.trace(normal) + 1e-6)
    cross = (w * around[:, :2].T) @ around[:, 2] / w.sum()
    rise = np.linalg.solve(normal, cross)
    scatter = np.sqrt(w @ (around[:, 2] - around[:, :2] @ rise) ** 2 / w.sum())
    return w.sum(), rise @ mean[:2] - mean[2], np.hypot(*rise), scatter


def test_planes_are_those_of_the_slow_way():
    rng = np.random.default_rng(3)
    xyz, weight = rng.uniform(0, (12, 9, 4), (80, 3)), rng.uniform(0.1, 1.0, 80)
    around = nearest(xyz)
    drift_m = rng.uniform(0.0, 1.0, 80)
    expected = np.empty(80)
    for i, near in enumerate(around):
        _, above, slope, _ = slow_plane(xyz, weight, i, near)
        expected[i] = np.sign(above) * max(abs(above) - drift_m[i] * slope, 0.0)
    found = above_planes(xyz, around, weight, drift_m)
    assert found == pytest.approx(expected, abs=1e-9)
    assert np.count_nonzero(found) > 40


def test_planes_of_one_side_are_those_of_the_slow_way():
    rng = np.random.default_rng(5)
    xyz = rng.uniform(0, (14, 11, 0.6), (120, 3))
    xyz[:, 2] += np.where(xyz[:, 0] > 7, 2.0, 0.0)
    weight, drift_m, spread_m = rng.uniform(0.2, 1.0, (3, 120)) * [[1.0], [0.3], [0.8]]
    expected = []
    for i, near in enumerate(nearest(xyz)):
        at = near[near != i]
        d = xyz[at] - xyz[i]
        goes = False
        for turn in np.arange(0, 2 * np.pi, np.pi / 4):
            side = at[d[:, :2] @ [np.cos(turn), np.sin(turn)] >= 0]
            if len(side):
                counted, above, slope, scatter = slow_plane(xyz, weight, i, side)
                flat = scatter <= SIGMA_M + TILT * drift_m[i] * slope
                goes |= counted >= 2.5 and flat and above <= 3.0 * spread_m[i]
        expected.append(goes)
    found = goes_on(xyz, nearest(xyz), weight, drift_m, spread_m, np.arange(120))
    assert found.tolist() == expected
    assert 10 < found.sum() < 110


def slow_below(xyz, known, asked):
    """Nodes far below the planes of the 20 nearest known ones, but for themselves."""
    found = np.zeros(len(xyz), bool)
    for i in np.flatnonzero(asked):
        apart = np.where(known, np.linalg.norm(xyz[:, :2] - xyz[i, :2], axis=1), np.inf)
        near = [j for j in np.argsort(apart)[:20] if j != i]
        counted, above, _, scatter = slow_plane(xyz, np.ones(len(xyz)), i, near)
        found[i] = counted >= 2.5 and -above > max(0.25, 3.0 * scatter)
    return found


@pytest.mark.parametrize("seed", [1, 2])
def test_noise_below_ground_is_that_of_a_slow_twin(seed):
    rng = np.random.default_rng(seed)
    xyz = nodes(seed, slope=0.3, rough_m=0.05, side_m=20.0)
    low = rng.random(len(xyz)) < 0.05
    xyz[low, 2] -= rng.uniform(0.1, 3.0, int(low.sum()))
    # Well-filled nodes lie in the west, single returns below many others in the east.
    filled = ~low & (rng.random(len(xyz)) < 0.7) & (xyz[:, 0] < 8)
    doubtful = ~filled & (rng.random(len(xyz)) < 0.9)
    once = slow_below(xyz, filled, ~filled)
    twice = slow_below(xyz, ~once, doubtful & ~once)
    found = under_planes(xyz, filled, doubtful)
    assert found.tolist() == (once | twice).tolist()
    assert once.any()
    assert twice.any()
    assert found[low].mean() > 0.6
    assert not found[~low].any()


@pytest.mark.parametrize("slope", [0.0, 1.7])
def test_noise_below_steep_ground_and_beside_more_of_it_is_found(slope):
    xyz = nodes(8, slope, 0.05, 20.0)
    pair = np.argsort(np.hypot(xyz[:, 0] - 10, xyz[:, 1] - 10))[:2]
    xyz[pair, 2] -= 0.8, 1.2
    filled, none = np.ones(len(xyz), bool), np.zeros(len(xyz), bool)
    filled[pair] = False
    assert np.flatnonzero(under_planes(xyz, filled, none)).tolist() == sorted(pair)
    assert not under_planes(xyz, none, none).any()


@pytest.mark.parametrize("slope", [0.0, 0.8])
def test_plants_go_and_the_ground_beside_them_stays(slope):
    xyz = nodes(slope=slope)
    planted = np.hypot(xyz[:, 0] - 14, xyz[:, 1] - 15) < 1.6
    assert planted.sum() >= 6
    high = xyz + planted[:, None] * [0.0, 0.0, 1.5 + slope]
    kept, off = without_plants(high, np.full(len(high), POINT_M))
    left = {*map(tuple, kept)}
    assert {*map(tuple, high[~planted])} <= left
    assert len(left) <= np.count_nonzero(~planted) + 1
    assert np.quantile(np.abs(off), 0.9) < 0.05


@pytest.mark.parametrize("rough_m", [0.03, 0.15])
def test_rough_soil_stays_and_its_scatter_is_that_of_the_soil(rough_m):
    xyz = nodes(rough_m=rough_m, side_m=60.0)
    kept, off = without_plants(xyz, np.full(len(xyz), POINT_M))
    assert len(kept) > 0.99 * 3600
    assert np.median(np.abs(off)) / 0.6745 == pytest.approx(rough_m, rel=0.15)


def test_few_nodes_stay_as_they_are():
    for count in range(3):
        some = nodes()[:count]
        kept, off = without_plants(some, np.full(count, POINT_M))
        assert np.array_equal(kept, some)
        assert not off.any()


def test_edges_of_terraces_and_dams_stay():
    """Steps of 4 m every 8 m: the plane through both sides of an edge is 2 m below it."""
    xyz = nodes(rough_m=0.02)
    steps = xyz + (4.0 * np.floor(xyz[:, :1] / 8.0)) * [0.0, 0.0, 1.0]
    assert len(without_plants(steps, np.full(len(steps), POINT_M))[0]) > 0.94 * len(steps)


def test_the_next_layer_over_grass_is_full_and_over_soil_empty():
    rng = np.random.default_rng(1)
    x, y = rng.uniform(0, 16, (2, 4000))
    reach_m = np.full((1, 1), 0.2)
    soil = depths_below(-np.abs(rng.normal(0, 0.1, 4000)), x, y, no_depths(x, y))
    grass = depths_below(-rng.exponential(0.3, 4000), x, y, no_depths(x, y))
    assert ends_within(soil, reach_m).all()
    assert not ends_within(grass, reach_m).any()
    assert not ends_within(soil, reach_m + 0.06).any()  # twice as much is not counted
