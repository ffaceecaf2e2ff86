"""Nearest points in the plane, beside all distances in order."""

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from spl_batch.numerics.neighbours.point_grid import PointGrid

COORDINATES = st.integers(-40, 40).map(lambda whole: whole * 0.25) | st.floats(-1e3, 1e3)
POINTS = arrays.arrays(np.float64, st.tuples(st.integers(1, 40), st.just(2)), elements=COORDINATES)


def by_distance(points: np.ndarray, asked: np.ndarray, count: int, reach: float) -> np.ndarray:
    """The same by all distances; of equal ones the lower number."""
    away2 = ((points - asked[:, None]) ** 2).sum(axis=2)
    order = np.argsort(away2, axis=1, kind="stable")[:, :count]
    found = np.where(np.take_along_axis(away2, order, axis=1) < reach * reach, order, -1)
    return np.pad(found, ((0, 0), (0, count - found.shape[1])), constant_values=-1)


@given(
    POINTS,
    POINTS,
    st.integers(1, 45),
    st.sampled_from([0.0, 0.5, 1.25, 30.0, math.inf]),
    st.sampled_from([0.0, 4.3e6]),
)
def test_they_are_the_nearest_of_all_and_ties_go_by_number(
    points: np.ndarray, asked: np.ndarray, count: int, reach: float, off: float
) -> None:
    points, asked = points + off, asked + off
    found = PointGrid.of(points).nearest(asked, count, reach)
    assert np.array_equal(found, by_distance(points, asked, count, reach))


def test_clusters_and_gaps_change_nothing() -> None:
    rng = np.random.default_rng(7)
    middles = rng.uniform(-500.0, 500.0, (5, 2))
    points = rng.choice(middles, 400) + rng.exponential(3.0, (400, 2))
    asked = rng.uniform(-2000.0, 2000.0, (300, 2))
    found = PointGrid.of(points).nearest(asked, 21)
    assert np.array_equal(found, by_distance(points, asked, 21, math.inf))


def test_a_dense_heap_and_a_stray_far_away_change_nothing() -> None:
    rng = np.random.default_rng(8)
    heap = np.vstack([rng.uniform(100.0, 160.0, (500, 2)), np.full((200, 2), 130.0), [[5e3, 5e3]]])
    for points in (heap, heap[500:700]):
        grid = PointGrid.of(points)
        assert np.array_equal(grid.nearest(heap, 9), by_distance(points, heap, 9, math.inf))
    assert np.diff(PointGrid.of(heap).start).max() < 600, "not all of the heap in one cell"
