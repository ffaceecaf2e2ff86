"""Coincidence processing: what points are judged by."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from benchmarks.geiger.coincidence import accuracy
from spl_batch.geiger.coincidence.simulate.scene import (
    BAR_WIDTHS_M,
    PLACES_M,
    SceneSettings,
    bars,
    build,
)


def dense(step_m: float) -> np.ndarray:
    """Places close to each other on every surface near a spoke target, a bar and a cube."""
    rng = np.random.default_rng(0)
    n = round(1 / step_m**2)
    parts = []
    x, y = rng.uniform(-6, 6, (2, 144 * n))
    parts.append(np.stack([x, y, 0 * x], axis=-1))
    r, angle = np.hypot(x, y), np.arctan2(y, x)
    spoke = (r <= 5) & (angle / (2 * np.pi) * 32 % 1 < 0.5)
    parts.append(np.stack([x, y, 0 * x + 2], axis=-1)[spoke])
    x, y = rng.uniform(24, 26, 4 * n), rng.uniform(-1, 1, 4 * n)
    parts.append(np.stack([x, y, 0 * x + 2], axis=-1))
    for axis, side in ((0, 24.0), (0, 26.0), (1, -1.0), (1, 1.0)):
        wall = np.stack([rng.uniform(24, 26, 4 * n), rng.uniform(-1, 1, 4 * n)], axis=-1)
        wall[:, axis] = side
        parts.append(np.column_stack([wall, rng.uniform(0, 2, 4 * n)]))
    return np.concatenate(parts)


def test_distances_against_dense_surfaces() -> None:
    scene = build(SceneSettings(targets=("spokes", "cube")))
    rng = np.random.default_rng(1)
    spokes = rng.uniform([-5.5, -5.5, 0.2], [5.5, 5.5, 3], (300, 3))
    cube = rng.uniform([23.5, -1.5, 0.5], [26.5, 1.5, 3], (300, 3))
    xyz = np.concatenate([spokes, cube])
    slow = cKDTree(dense(0.03)).query(xyz)[0]
    # Ground lies beneath the cube as well, where the dense places have none.
    slow = np.minimum(slow, xyz[:, 2])
    assert accuracy.distance_m(xyz, scene) == pytest.approx(slow, abs=0.05)
    assert np.abs(accuracy.distance_m(xyz, scene) - slow).mean() < 0.01


def test_a_leaf_is_a_surface_too() -> None:
    scene = build(SceneSettings(targets=("foliage",)))
    leaves = scene.leaves[:50, :3]
    assert accuracy.distance_m(leaves, scene).max() == 0
    above = np.array([[*PLACES_M["foliage"], 7.0]])
    assert accuracy.distance_m(above, scene)[0] > 1.3


def test_tri_bars_by_known_points() -> None:
    rng = np.random.default_rng(2)
    xyz = []
    for k, (_, _, plates) in enumerate(bars(PLACES_M["bars"])):
        for plate in plates:
            n = 300
            x, y = (rng.uniform(plate[a], plate[a + 2], n) for a in (0, 1))
            xyz.append(np.stack([x, y, np.full(n, 2.0)], axis=-1))
        if k % 2:
            # One gap as full as the bars.
            gap = xyz[-3].copy()
            gap[:, 0 if k < len(BAR_WIDTHS_M) else 1] += (
                plates[0, 2 if k < 36 else 3] - plates[0, 0 if k < 36 else 1]
            )
            xyz.append(gap)
    found = accuracy.tri_bars(np.concatenate(xyz))
    assert [f.width_m for f in found] == [*BAR_WIDTHS_M, *BAR_WIDTHS_M]
    for k, one in enumerate(found):
        assert one.contrast == pytest.approx(0.0 if k % 2 else 1.0, abs=0.05)
        assert one.bars == pytest.approx(300 / (5 * one.width_m**2), rel=0.01)


def test_the_widths_that_the_source_tells_are_there() -> None:
    assert len(BAR_WIDTHS_M) == 36
    assert (np.diff(BAR_WIDTHS_M) < 0).all()
    # The third of the four last rows of four, and what is "the next largest".
    assert BAR_WIDTHS_M[-12:-8] == (0.15, 0.125, 0.10, 0.09)
    assert BAR_WIDTHS_M[-13] == 0.175
    smallest = np.concatenate([p for w, _, p in bars((0.0, 0.0)) if w <= 0.25])
    assert len(set(smallest[:, 3].round(6))) > 1
    assert np.ptp(smallest[:, 3]) < 1.25


def test_targets_do_not_touch() -> None:
    plates = np.concatenate([p for _, _, p in bars(PLACES_M["bars"])])
    for k, a in enumerate(plates):
        others = np.delete(plates, k, axis=0)
        apart = (others[:, 0] >= a[2]) | (others[:, 2] <= a[0])
        apart |= (others[:, 1] >= a[3]) | (others[:, 3] <= a[1])
        assert apart.all()
    assert np.abs(plates[:, :4] - np.tile(PLACES_M["bars"], 2)).max() < 26


def test_completeness() -> None:
    truth = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0]])
    assert accuracy.completeness(truth, truth[:3] + 0.01, 0.1) == 0.75
    assert accuracy.completeness(truth, np.empty((0, 3)), 0.1) == 0
    assert accuracy.completeness(np.empty((0, 3)), truth, 0.1) == 1


def test_what_is_seen_from_above() -> None:
    scene = build(SceneSettings(targets=("cube", "covered_spokes")))
    seen = accuracy.seen_from_above(scene, np.array([23.5, -1.5]), np.array([26.5, 1.5]), 0.1)
    assert len(seen) == 900
    on_top = (np.abs(seen[:, 0] - 25) < 1) & (np.abs(seen[:, 1]) < 1)
    assert seen[on_top, 2] == pytest.approx(2.0)
    assert seen[~on_top, 2] == pytest.approx(0.0)
    centre = np.array(PLACES_M["covered_spokes"])
    assert len(accuracy.seen_from_above(scene, centre - 3, centre + 3, 0.1)) < 0.05 * 3600
