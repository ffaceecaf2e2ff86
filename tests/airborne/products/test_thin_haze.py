"""Thin layers of haze: told by how evenly they fill places beside each other."""

import numpy as np
import pytest

from spl_batch.airborne.products.air import near_ground, thin_haze
from spl_batch.lattice.tables import PointTable
from spl_batch.lattice.tiles import Bounds

CORE = Bounds(0, 0, 60_000, 50_000)
FLAT = np.zeros((50, 60), np.float32)


def table(xyz, kind=0):
    mm = np.rint(xyz * 1000).astype(np.int64)
    kinds = np.full(len(xyz), kind, np.uint8)
    return PointTable(
        {"x": mm[:, 0], "y": mm[:, 1], "z": mm[:, 2].astype(np.int32), "noise_class": kinds}
    )


def scatter(rng, per_m3, low, high):
    n = rng.poisson(per_m3 * 3000 * (high - low))
    return rng.uniform((0, 0, low), (60, 50, high), (n, 3))


def ground(rng):
    return rng.uniform((0, 0, -0.1), (60, 50, 0.1), (9000, 3))


def found(*parts, kind=0, noise=0.05):
    placed = near_ground.placed(
        table(np.concatenate(parts), kind), CORE, near_ground.highest_ground(FLAT)
    )
    return thin_haze.layers(thin_haze.filled_blocks(placed, noise), CORE)


@pytest.mark.parametrize(
    ("low", "high", "per_m3"), [(8.0, 16.0, 0.5), (20.0, 27.0, 2.0), (8.0, 14.0, 0.3)]
)
def test_a_layer_is_told_with_its_place_and_heights(low, high, per_m3):
    rng = np.random.default_rng(1)
    (layer,) = found(ground(rng), scatter(rng, 0.05, -5, 60), scatter(rng, per_m3, low, high))
    places, lower, upper, x, y, down = layer
    assert places >= 20
    assert (lower, upper) == (pytest.approx(low, abs=1.5), pytest.approx(high, abs=1.5))
    assert (x, y) == (pytest.approx(30_000, abs=5000), pytest.approx(25_000, abs=5000))
    assert down == 0.0


def test_crowns_noise_and_what_the_filter_refuses_are_none():
    rng = np.random.default_rng(2)
    crowns = scatter(rng, 2.0, 8, 16)
    leaves = (crowns[:, 0] // 3 + crowns[:, 1] // 3 + crowns[:, 2] // 3) % 2 == 0
    assert not found(ground(rng), crowns[leaves])
    place = tuple((crowns // 2).astype(int).T)
    steady = rng.random(len(crowns)) < rng.uniform(0.0, 1.0, (30, 25, 8))[place] ** 2
    assert not found(ground(rng), crowns[steady])
    assert not found(ground(rng), scatter(rng, 0.05, -5, 60))
    assert not found(ground(rng), scatter(rng, 0.5, 8, 16), kind=1)
    assert not found(ground(rng), scatter(rng, 0.5, 8, 16), noise=0.2)


def test_a_dense_place_alone_is_none():
    rng = np.random.default_rng(3)
    cloud = scatter(rng, 2.0, 8, 16)
    alone = (cloud[:, 0] < 20) & (cloud[:, 1] < 20)
    assert not found(ground(rng), cloud[alone])


def clumped(n, cells):
    """Clumping of the counts of some cells, of so many in all."""
    return cells * (n * (n - 1)).sum() / n.sum() ** 2


def test_blocks_are_as_clumped_as_counting_by_hand_says():
    rng = np.random.default_rng(4)
    cloud = scatter(rng, 1.0, 0, 40)
    cloud = cloud[rng.random(len(cloud)) < np.where(cloud[:, 0] < 30, 1.0, 0.25)]
    points = np.concatenate([ground(rng), cloud])
    placed = near_ground.placed(table(points), CORE, near_ground.highest_ground(FLAT))
    found = thin_haze.clumping(placed, 0.05)
    assert found.whole.shape == found.emptier.shape == (5, 6, thin_haze.BLOCKS)
    filled = (found.whole <= thin_haze.EVEN) | (found.emptier <= thin_haze.EVEN_EMPTIER)
    assert np.array_equal(thin_haze.filled_blocks(placed, 0.05), filled)
    mm = np.rint(points * 1000) / 1000
    metre = np.floor(mm[:, 2] - near_ground.FLOOR_M)
    for row, column, low in [(0, 0, 0), (4, 5, 3), (2, 3, 17), (1, 2, 38), (3, 1, 56)]:
        inside = (mm[:, 0] // 10 == column) & (mm[:, 1] // 10 == row)
        inside &= (metre >= low) & (metre < low + thin_haze.BLOCK)
        east, north = ((mm[inside, k] % 10 // 2).astype(int) for k in (0, 1))
        half = np.floor(2 * (mm[inside, 2] - near_ground.FLOOR_M)).astype(int) - 2 * low
        n = np.zeros((25, 8))
        np.add.at(n, (5 * north + east, half), 1)
        enough = n.sum() >= 0.2 * 400
        whole = clumped(n, 200) if enough else np.inf
        assert found.whole[row, column, low] == pytest.approx(whole)
        few = n[np.argsort(n.sum(axis=1), kind="stable")[:13]]
        held = enough and few.sum() >= 0.4 * 4 * 13 * 4
        emptier = clumped(few, 13 * 8) + 2 / np.pi * 13 / few.sum() if held else np.inf
        assert found.emptier[row, column, low] == pytest.approx(emptier)
    assert np.isfinite(found.emptier).any()
    assert (np.isinf(found.emptier) & np.isfinite(found.whole)).any()


@pytest.mark.parametrize("per_m3", [1.0, 6.0])
def test_of_air_both_clumpings_are_one(per_m3):
    rng = np.random.default_rng(8)
    points = np.concatenate([ground(rng), scatter(rng, per_m3, 2, 30)])
    placed = near_ground.placed(table(points), CORE, near_ground.highest_ground(FLAT))
    for values in thin_haze.clumping(placed, 0.05):
        inner = values[:, :, 2:24]
        assert np.isfinite(inner).all()
        assert inner.mean() == pytest.approx(1.0, abs=0.02)


def test_haze_is_told_where_trees_stand_in_it():
    rng = np.random.default_rng(7)
    trees = rng.uniform((0, 0, 4), (60, 50, 9), (12_000, 3))
    trees = trees[(trees[:, 0] % 10 < 4) & (trees[:, 1] % 10 < 6)]
    assert not found(ground(rng), trees)
    (layer,) = found(ground(rng), trees, scatter(rng, 1.5, 3, 9))
    assert layer[0] >= 20
    assert layer[1:3] == [pytest.approx(3, abs=1.5), pytest.approx(9, abs=1.5)]


def test_places_without_ground_tell_nothing():
    rng = np.random.default_rng(5)
    void = np.full((50, 60), -9999, np.float32)
    placed = near_ground.placed(
        table(scatter(rng, 2.0, 8, 16)), CORE, near_ground.highest_ground(void)
    )
    assert not thin_haze.filled_blocks(placed, 0.05).any()


def test_mist_in_patches_is_told_and_crops_and_gaps_are_not():
    rng = np.random.default_rng(6)
    air = scatter(rng, 2.0, 0, 3.5)

    def patches(points):
        placed = near_ground.placed(
            table(np.concatenate([ground(rng), points])), CORE, near_ground.highest_ground(FLAT)
        )
        return thin_haze.mist(near_ground.low_places(placed, 0.05), CORE)

    ((places, x, y),) = patches(air[air[:, 0] < 30])
    assert 8 <= places <= 15
    assert (x, y) == (pytest.approx(15_000, abs=2000), pytest.approx(25_000, abs=5000))
    assert not patches(air[air[:, 2] < 1.6]), "crops"
    bushes = (air[:, 0] // 2 + air[:, 1] // 2) % 3 == 0
    assert not patches(air[bushes])
    assert not patches(air[(air[:, 0] < 20) & (air[:, 1] < 20)]), "small"
