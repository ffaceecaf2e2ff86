"""The ground stage on inputs at the edge of what makes sense."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from spl_batch.airborne.ground.ground_methods import ground_mask, sparse_at
from spl_batch.airborne.ground.point_spacing import spacings_m
from spl_batch.airborne.settings import GroundSettings
from tests.airborne.ground.clouds import ground_of, places, table

METHODS = ("multiscale", "ptd", "smrf")


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("n", [0, 1, 2, 3])
def test_few_points_are_ground(method: str, n: int) -> None:
    points = table(np.arange(n) * 3.0, np.arange(n) ** 2 * 1.0, np.full(n, 7.0))
    assert ground_of(points, method).tolist() == [True] * n


ALONG = np.linspace(0, 50, 200)
PLANES = {
    "coincident": (np.full(50, 5.0), np.full(50, 9.0), np.full(50, 1.0)),
    "collinear": (ALONG, 2 * ALONG, 0.1 * ALONG),
    "flat water": (*places(4000, 40), np.zeros(4000)),
    # All cells cocircular: the worst case of a triangulation.
    "lattice": (np.arange(900) % 30, np.arange(900) // 30, 0.1 * (np.arange(900) % 30)),
}


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("plane", PLANES)
def test_planes_of_any_places_are_ground(plane: str, method: str) -> None:
    assert ground_of(table(*PLANES[plane]), method).all()


@pytest.mark.parametrize("method", METHODS)
def test_building_over_most_of_a_cell(method: str) -> None:
    x, y = places(60_000, 100)
    roof = (np.abs(x - 50) < 27) & (np.abs(y - 50) < 27)
    points = table(x, y, np.where(roof, 8.0, 0.0))
    high = points["z"] > 4000
    found = ground_of(points, method)
    assert not found[high].any()
    assert found[~high].all()


def test_low_wide_hall_is_no_ground() -> None:
    """5 m high and 56 m wide: slope times radius alone would let it pass."""
    x, y = places(150_000, 100)
    roof = (np.abs(x - 50) < 28) & (np.abs(y - 50) < 28)
    points = table(x, y, np.where(roof, 5.0, 0.0))
    assert not ground_of(points)[points["z"] > 2500].any()


@pytest.mark.parametrize("method", METHODS)
def test_unusable_points_neither_count_nor_change_anything(method: str) -> None:
    x, y = places(5000, 40)
    z = np.where(np.arange(5000) % 50 == 0, -3.0, 0.0)
    points = table(x, y, z)
    usable = points["z"] > -1000
    found = ground_mask(points, usable, GroundSettings(method=method))
    assert not found[~usable].any()
    alone = ground_mask(
        points.take(usable), np.ones(int(usable.sum()), dtype=bool), GroundSettings(method=method)
    )
    assert np.array_equal(found[usable], alone)


def lattice(step_m: float, edge_m: float) -> tuple[NDArray[np.float64], ...]:
    """Terraces under plants, on a lattice: places lie on edges of triangles and on vertices."""
    x, y = (v.ravel() for v in np.meshgrid(*[np.arange(0.0, edge_m, step_m)] * 2))
    plants = np.random.default_rng(1).integers(0, 60, len(x)) * 0.02
    z = 2.0 * np.floor(x / 8.0)
    return np.tile(x, 2), np.tile(y, 2), np.append(z, z + plants)


@pytest.mark.parametrize("method", METHODS)
@settings(max_examples=5, deadline=None)
@given(seed=st.integers(0, 1000))
@example(seed=1)
def test_the_order_of_the_points_changes_nothing(method: str, seed: int) -> None:
    points = table(*lattice(0.5, 24.0))
    turned = np.random.default_rng(seed).permutation(len(points))
    assert np.array_equal(ground_of(points.take(turned), method), ground_of(points, method)[turned])


@pytest.mark.parametrize("method", METHODS)
def test_moving_the_survey_by_whole_cells_changes_nothing(method: str) -> None:
    x, y = places(8000, 60)
    z = 2 * np.sin(x / 9) + np.where(np.hypot(x - 30, y - 30) < 6, 5.0, 0.0)
    here = ground_of(table(x, y, z), method)
    there = ground_of(table(x + 640_000, y - 1_280_000, z), method)
    assert np.array_equal(here, there)


@settings(max_examples=30, deadline=None)
@given(st.data())
def test_any_cloud_gets_an_answer(data: st.DataObject) -> None:
    n = data.draw(st.integers(0, 60))
    whole = st.lists(st.integers(0, 30), min_size=n, max_size=n)
    points = table(*(data.draw(whole) for _ in range(3)))
    for method in METHODS:
        found = ground_of(points, method)
        assert found.dtype == bool
        assert len(found) == n
        assert found.any() == (n > 0)


def test_sparse_data_get_wider_cells() -> None:
    x, y = places(96 * 96 * 3, 96)
    wide = sparse_at(spacings_m(x, y), x, y, 1.0)
    assert not wide.any()
    thin = (x < 48) | (np.arange(len(x)) % 3 == 0)
    wide = sparse_at(spacings_m(x[thin], y[thin]), x, y, 1.0)
    assert wide[x > 64].all()
    assert not wide[x < 32].any()


@pytest.mark.parametrize("method", METHODS)
def test_points_that_are_asked_for_are_told_what_they_are(method: str) -> None:
    rng = np.random.default_rng(8)
    x, y = rng.uniform(0, 40, (6000, 2)).T
    z = 0.1 * x + np.where(rng.random(6000) < 0.3, rng.uniform(1, 9, 6000), 0.0)
    points = table(x, y, z)
    usable, asked = rng.random((2, 6000)) < 0.7
    settings = GroundSettings(method=method)
    whole = ground_mask(points, usable, settings)
    assert 0 < np.count_nonzero(whole & asked) < np.count_nonzero(usable & asked)
    assert np.array_equal(ground_mask(points, usable, settings, asked), whole & asked)


def test_cliff_keeps_both_levels() -> None:
    x, y = places(40_000, 100)
    points = table(x, y, np.where(x < 50, 0.0, 20.0))
    assert ground_of(points).mean() > 0.98
