"""Returns just above the ground: fog fills all places, plants and houses do not."""

import numpy as np
import pytest

from spl_batch.airborne.products.air import near_ground
from spl_batch.lattice.tables import PointTable
from spl_batch.lattice.tiles import Bounds

CORE = Bounds(0, 0, 60_000, 50_000)
GROUND_M = 100.0


def table(*parts, kind=0):
    xyz = np.concatenate(parts)
    mm = np.rint(xyz * 1000).astype(np.int64)
    kinds = np.full(len(xyz), kind, np.uint8)
    return PointTable(
        {"x": mm[:, 0], "y": mm[:, 1], "z": mm[:, 2].astype(np.int32), "noise_class": kinds}
    )


def dtm(slope=0.1):
    x = np.arange(60) + 0.5
    return np.broadcast_to(GROUND_M + slope * x, (50, 60)).astype(np.float32)


def scatter(rng, per_m2, height, slope=0.1):
    n = rng.poisson(per_m2 * 3000)
    x, y = rng.uniform(0, 60, n), rng.uniform(0, 50, n)
    return np.column_stack([x, y, GROUND_M + slope * x + height(n)])


def ground(rng):
    return scatter(rng, 10, lambda n: rng.normal(0, 0.05, n))


def shares(points, noise=0.05, slope=0.1):
    placed = near_ground.placed(points, CORE, near_ground.highest_ground(dtm(slope)))
    places, *filled = near_ground.filled_places(placed, noise)
    assert places == 30
    return np.array(filled) / places


@pytest.mark.parametrize("per_m2", [4.0, 8.0])
def test_fog_fills_the_places_up_to_its_height(per_m2):
    rng = np.random.default_rng(1)
    fog = scatter(rng, per_m2, lambda n: rng.exponential(1.5, n))
    share = shares(table(ground(rng), fog))
    assert (share[:2] > 0.9).all()
    assert (share[5:] < 0.2).all()


def test_noise_bare_ground_and_plants_with_gaps_fill_none():
    rng = np.random.default_rng(2)
    noise = scatter(rng, 0.5, lambda n: rng.uniform(0, 10, n))
    assert not shares(table(ground(rng), noise)).any()
    bushes = scatter(rng, 12, lambda n: rng.uniform(0, 3, n))
    cell = (bushes[:, 0] // 2 + bushes[:, 1] // 2) % 3 == 0
    assert not shares(table(ground(rng), bushes[cell])).any()


def test_what_lies_above_a_gap_is_not_counted_with_fog():
    rng = np.random.default_rng(9)
    fog = scatter(rng, 10, lambda n: rng.uniform(0, 1.7, n))
    crown = scatter(rng, 40, lambda n: rng.uniform(4, 8, n))
    share = shares(table(ground(rng), fog, crown))
    assert share[0] > 0.9
    assert not share[1:].any()


@pytest.mark.parametrize("slope", [1.2, 1.75, 3.0])
def test_steep_bare_ground_fills_none_and_fog_on_it_is_seen(slope):
    rng = np.random.default_rng(5)
    bare = scatter(rng, 10, lambda n: rng.normal(0, 0.05, n), slope)
    assert not shares(table(bare), slope=slope).any()
    fog = scatter(rng, 12.0, lambda n: rng.exponential(3.0, n), slope)
    assert (shares(table(bare, fog), slope=slope)[:1] > 0.9).all()


def test_parts_of_a_steep_cell_give_what_the_cell_gives():
    rng = np.random.default_rng(6)
    fog = scatter(rng, 5.0, lambda n: rng.exponential(1.5, n), 1.5)
    points, highest = table(fog), near_ground.highest_ground(dtm(1.5))
    whole = near_ground.filled_places(near_ground.placed(points, CORE, highest), 0.05)
    west, east = CORE._replace(xmax=30_000), CORE._replace(xmin=30_000)
    halves = [(west, highest[:, :30]), (east, highest[:, 30:])]
    parts = [
        near_ground.filled_places(near_ground.placed(points, core, part), 0.05)
        for core, part in halves
    ]
    assert np.sum(parts, axis=0).tolist() == whole


def test_afterpulses_are_not_counted():
    rng = np.random.default_rng(3)
    fog = scatter(rng, 8.0, lambda n: rng.exponential(1.5, n))
    points = table(ground(rng), fog)
    kinds = points["noise_class"].copy()
    kinds[-len(fog) :] = 2
    assert not shares(points.with_columns(noise_class=kinds)).any()


def test_places_without_ground_and_cells_too_small_tell_nothing():
    rng = np.random.default_rng(4)
    fog = scatter(rng, 8.0, lambda n: 1.0 + rng.exponential(1.5, n))
    void = np.full((50, 60), -9999, np.float32)
    placed = near_ground.placed(table(fog), CORE, near_ground.highest_ground(void))
    assert near_ground.filled_places(placed, 0.05) == [0] * 9
    small = Bounds(1000, 1000, 8000, 8000)
    assert near_ground.placed(table(fog), small, void[:7, :7]) is None
    assert near_ground.filled_places(None, 0.05) == [0] * 9
