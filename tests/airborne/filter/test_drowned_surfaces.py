"""In noise whose clusters hold any number of returns, ground is what fills a place."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import poisson

from spl_batch.airborne.filter.drowned_surfaces import CHANCE, NEAR_M, lonely
from spl_batch.airborne.filter.stray_returns import bare_cells
from spl_batch.airborne.products.surface_points import holds_ground
from spl_batch.lattice.tables import PointTable
from spl_batch.lattice.tiles import quanta

Points = NDArray[np.float64]
WEST, SOUTH = -40.0, 1000.0
SIDE = 60.0
PER_M3 = 0.8


def table(kept: Points, refused: Points) -> PointTable:
    xyz = np.concatenate([kept, refused]) + np.array([WEST, SOUTH, 0.0])
    columns = dict(zip("xyz", np.round(xyz * 1000).astype(np.int64).T, strict=True))
    count = len(kept) + len(refused)
    return PointTable(
        columns
        | {
            "noise_class": (np.arange(count) >= len(kept)).astype(np.uint8),
            "flags": np.zeros(count, np.uint16),
        }
    )


def scene(rng: np.random.Generator, ground_per_m2: float) -> tuple[PointTable, NDArray[np.bool_]]:
    """A slope in dense noise, of which clusters and what is near the slope were kept; the slope."""
    noise = rng.uniform((0, 0, -40), (SIDE, SIDE, 40), (rng.poisson(PER_M3 * SIDE**2 * 80), 3))
    lowest = 0.3 * noise[:, 0] - 9.0
    beside = np.abs(noise[:, 2] - lowest) < 1.5
    places = rng.uniform((4, 4, -35), (SIDE - 4, SIDE - 4, -20), (10, 3))
    in_cluster = (np.abs(noise[:, None] - places) < 1.6).all(axis=2).any(axis=1)
    kept = beside & (rng.random(len(noise)) < 0.5) | in_cluster
    ground = rng.uniform((0, 0, 0), (SIDE, SIDE, 0.1), (rng.poisson(ground_per_m2 * SIDE**2), 3))
    ground[:, 2] += 0.3 * ground[:, 0] - 9.0
    is_ground = np.zeros(len(noise) + len(ground), np.bool_)
    is_ground[: len(ground)] = True
    return table(np.concatenate([ground, noise[kept]]), noise[~kept]), is_ground


def test_ground_in_dense_noise_is_what_fills_a_place_and_lies_close_together() -> None:
    cloud, is_ground = scene(np.random.default_rng(1), 8.0)
    found = holds_ground(cloud)
    assert found[is_ground].mean() > 0.94
    xyz = np.column_stack([cloud[axis] for axis in "xyz"])[found & ~is_ground] / 1000
    below = 0.3 * (xyz[:, 0] - WEST) - 9.0 - xyz[:, 2]
    assert below.max() < 1.2


def test_a_surface_that_does_not_stand_out_is_no_ground() -> None:
    cloud, _ = scene(np.random.default_rng(2), 0.15)
    bare = bare_cells(cloud)
    assert bare is not None
    assert holds_ground(cloud).sum() < 20
    most = bare.dense.max(axis=2)
    assert np.median(most[most > 0]) == pytest.approx(PER_M3, rel=0.1)


def test_lonely_is_what_its_slow_twin_says_in_any_order() -> None:
    rng = np.random.default_rng(3)
    xyz = np.concatenate(
        [rng.uniform(0, 8, (500, 3)), rng.uniform((0, 0, 4), (8, 8, 4.2), (600, 3))]
    )
    cloud = table(xyz, np.empty((0, 3)))
    usable = rng.random(len(xyz)) < 0.9
    noise = np.where(rng.random(len(xyz)) < 0.8, 1.0, 0.0).astype(np.float32)
    at = np.column_stack([cloud[axis] for axis in "xyz"])[usable]
    near = (((at[:, None] - at[None]) ** 2).sum(axis=2) <= quanta(NEAR_M) ** 2).sum(axis=1) - 1
    expected = 4 / 3 * np.pi * NEAR_M**3
    slow = np.zeros(len(xyz), np.bool_)
    slow[usable] = poisson.sf(near - 1, expected) > CHANCE
    slow &= noise > 0
    found = lonely(cloud, usable, noise)
    assert 0 < found.sum() < usable.sum()
    np.testing.assert_array_equal(found, slow)
    order = rng.permutation(len(xyz))
    np.testing.assert_array_equal(
        lonely(cloud.take(order), usable[order], noise[order]), slow[order]
    )
