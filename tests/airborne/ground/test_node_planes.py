"""Planes through nodes of the ground: plants go, rough soil stays and shows how rough it is."""

import numpy as np
import pytest
from scipy.spatial import Delaunay

from spl_batch.airborne.ground.multiscale.node_planes import (
    REACH_M,
    RINGS,
    off_planes,
    without_plants,
)

POINT_M = 0.4


def nodes(seed: int = 1, slope: float = 0.0, rough_m: float = 0.0, side_m: float = 30.0):
    """One node to the square metre, somewhere in it."""
    rng = np.random.default_rng(seed)
    x, y = (along.ravel() for along in np.meshgrid(*[np.arange(side_m)] * 2))
    x, y = x + rng.uniform(0.1, 0.9, x.size), y + rng.uniform(0.1, 0.9, x.size)
    return np.column_stack([x, y, slope * x + rng.normal(0, rough_m, x.size)])


def slowly(xyz, weight):
    """Heights above the plane of each node, whose neighbours count as often as paths lead there."""
    beside = np.eye(len(xyz))
    for a, b, c in Delaunay(xyz[:, :2]).simplices:
        for i, j in ((a, b), (b, c), (c, a)):
            near = np.exp(-((np.linalg.norm((xyz[i] - xyz[j])[:2]) / REACH_M) ** 2))
            beside[i, j] = beside[j, i] = near
    paths = np.linalg.matrix_power(beside, RINGS) * weight
    off = np.empty(len(xyz))
    for i, w in enumerate(paths):
        mean = w @ xyz / w.sum()
        d = xyz - mean
        normal = (w * d[:, :2].T) @ d[:, :2] / w.sum()
        normal += np.eye(2) * (0.02 * np.trace(normal) + 1e-6)
        rise = np.linalg.solve(normal, (w * d[:, :2].T) @ d[:, 2] / w.sum())
        off[i] = xyz[i, 2] - mean[2] - rise @ (xyz[i, :2] - mean[:2])
    return off


def test_planes_are_those_of_the_slow_way():
    rng = np.random.default_rng(3)
    xyz = rng.uniform(0, (12, 9, 4), (80, 3))
    tin = Delaunay(xyz[:, :2]).simplices
    edges = np.unique(
        np.sort(np.concatenate([tin[:, k] for k in ([0, 1], [1, 2], [2, 0])])), axis=0
    )
    found, slope = off_planes(xyz, edges.astype(np.int32), weight := rng.uniform(0.1, 1.0, 80))
    assert found == pytest.approx(slowly(xyz, weight), abs=1e-9)
    assert slope.min() > 0.0


@pytest.mark.parametrize("slope", [0.0, 0.8])
def test_plants_go_and_the_ground_beside_them_stays(slope):
    xyz = nodes(slope=slope)
    planted = np.hypot(xyz[:, 0] - 14, xyz[:, 1] - 15) < 1.6
    assert planted.sum() >= 6
    high = xyz + planted[:, None] * [0.0, 0.0, 1.5 + slope]
    kept, off = without_plants(high, np.full(len(high), POINT_M))
    assert {*map(tuple, high[~planted])} == {*map(tuple, kept)}
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
