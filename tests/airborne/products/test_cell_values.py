"""Raster kernels against plain loops and scipy."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import LinearNDInterpolator
from scipy.spatial import cKDTree
from scipy.stats import median_abs_deviation

from spl_batch.airborne.products.cell_values import (
    _spread2,
    cell_number,
    fill_voids,
    robust_cell_means,
    sort_into_cells,
)
from spl_batch.airborne.products.top_surface import Support, confirmed_tops
from spl_batch.lattice.tables import PointTable
from spl_batch.lattice.tiles import Bounds
from spl_batch.numerics.triangulation.delaunay import triangles
from spl_batch.numerics.triangulation.tin_raster import tin_raster

SIZE = 1000


def test_sort_into_cells_puts_the_highest_of_each_cell_first():
    rng = np.random.default_rng(1)
    cell = rng.integers(0, 7, 200)
    z = rng.integers(-(2**31), 2**31 - 1, 200).astype(np.int32)
    order, start = sort_into_cells(cell, z, 8)
    assert sorted(order) == list(range(200))
    for k in range(8):
        run = order[start[k] : start[k + 1]]
        assert set(cell[run]) <= {k}
        assert list(z[run]) == sorted(z[cell == k], reverse=True)


def slow_mean(xyz, floor):
    z = xyz[:, 2].astype(float)
    middle = np.median(z)
    deviations = np.sort(np.abs(z - middle))
    lower_median = deviations[(len(z) - 1) // 2]
    kept = np.abs(z - middle) <= max(3 * 1.4826 * lower_median, floor)
    return xyz[kept].mean(axis=0)


@given(st.integers(0, 2**32), st.integers(1, 25))
@settings(max_examples=60, deadline=None)
def test_robust_cell_means_equal_the_plain_ones(seed, n):
    rng = np.random.default_rng(seed)
    xyz = np.stack(
        [
            rng.integers(0, 3 * SIZE, n),
            rng.integers(0, 2 * SIZE, n),
            (rng.standard_cauchy(n) * 60).clip(-1e6, 1e6),
        ],
        axis=1,
    ).astype(np.int64)
    points, _, start = cells_of(xyz, 2, 3)
    means = np.empty((6, 3))
    robust_cell_means(tuple(np.ascontiguousarray(points.T)), start, 150.0, means)
    cell = xyz[:, 1] // SIZE * 3 + xyz[:, 0] // SIZE
    for k in range(6):
        mine = xyz[cell == k]
        expected = slow_mean(mine, 150.0) if len(mine) else np.full(3, np.nan)
        np.testing.assert_allclose(means[k], expected, rtol=1e-14, atol=1e-9)


@given(st.lists(st.integers(-(2**31), 2**31 - 1), min_size=1, max_size=30))
def test_the_spread_is_the_lower_median_absolute_deviation(heights):
    z = np.array(sorted(heights, reverse=True), dtype=np.int32)
    n = len(z)
    middle2 = int(z[(n - 1) // 2]) + int(z[n // 2])
    deviations = sorted(abs(2 * int(h) - middle2) for h in heights)
    assert _spread2(z, 0, n, np.int64(middle2)) == deviations[(n - 1) // 2]
    if n % 2:
        assert deviations[n // 2] / 2 == median_abs_deviation(z.astype(float))


def slow_tops(xyz, ground, start, by):
    """Tops by counting every pair."""
    n = len(xyz)
    d = np.linalg.norm(xyz[:, None].astype(float) - xyz[None], axis=2)
    spacing = np.minimum(np.sort(d, axis=1)[:, by.neighbours], by.radius.max())
    peer = (spacing[None] * by.peer_ratio >= spacing[:, None]) & ~np.eye(n, dtype=bool)
    peer &= ~ground[None]
    accepted = ground.copy()
    cells = np.repeat(np.arange(len(start) - 1), np.diff(start))
    for scale, radius in enumerate(by.radius):
        accepted |= ((d <= radius) & peer).sum(axis=1) >= by.needed[by.noise[cells], scale]
    tops = np.full(len(start) - 1, np.nan)
    for cell in range(len(tops)):
        mine = np.arange(start[cell], start[cell + 1])
        tops[cell] = max(xyz[mine[accepted[mine]], 2], default=np.nan)
    return tops


def cells_of(xyz, rows, cols):
    cell = xyz[:, 1] // SIZE * cols + xyz[:, 0] // SIZE
    order, start = sort_into_cells(cell.astype(np.int64), xyz[:, 2].astype(np.int32), rows * cols)
    return xyz[order].astype(np.int32), order, start


@pytest.mark.parametrize(
    ("counts", "ratio"), [((0, 0, 0), 1.0), ((2, 3, 4), 1.5), ((99, 4, 7), 1.0), ((1, 99, 9), 1.5)]
)
def test_confirmed_tops_equal_the_count_of_every_pair(counts, ratio):
    rng = np.random.default_rng(sum(counts))
    rows, cols, n = 7, 6, 260
    xyz = np.stack(
        [
            rng.integers(0, cols * SIZE, n),
            rng.integers(0, rows * SIZE, n),
            np.where(rng.random(n) < 0.5, rng.normal(0, 50, n), rng.uniform(0, 6000, n)),
        ],
        axis=1,
    ).astype(np.int64)
    xyz, _, start = cells_of(xyz, rows, cols)
    ground = (rng.random(n) < 0.3) & (xyz[:, 2] < 100)
    needed, noise = np.array([counts, (5, 1, 2)]), rng.integers(0, 2, rows * cols)
    by = Support(np.array([600, 1100, 2300]), needed, noise, 3, ratio)
    tops = np.empty(rows * cols)
    confirmed_tops(xyz, ground, start, (cols, SIZE), by, tops)
    np.testing.assert_array_equal(tops, slow_tops(xyz, ground, start, by))


def test_fill_voids_takes_the_nearest_and_of_several_the_lowest():
    rng = np.random.default_rng(5)
    values = rng.integers(0, 50, (23, 31)).astype(float)
    values[rng.random(values.shape) < 0.93] = np.nan
    out = fill_voids(values, 3.5)
    filled = np.argwhere(~np.isnan(values))
    for place in np.argwhere(np.isnan(values)):
        d2 = ((filled - place) ** 2).sum(axis=1)
        near = filled[d2 == d2.min()]
        expected = values[tuple(near.T)].min() if d2.min() <= 3.5**2 else np.nan
        np.testing.assert_equal(out[tuple(place)], expected)
    kept = ~np.isnan(values)
    np.testing.assert_array_equal(out[kept], values[kept])


def test_tin_raster_equals_scipys_interpolator():
    rng = np.random.default_rng(7)
    vertices = np.stack(
        [rng.uniform(-20, 60, 300), rng.uniform(-20, 50, 300), rng.normal(0, 5, 300)], axis=1
    )
    out = tin_raster(vertices, 1.0, (30, 40), 1e9)
    x, y = np.meshgrid(np.arange(40) + 0.5, np.arange(30) + 0.5)
    expected = LinearNDInterpolator(vertices[:, :2], vertices[:, 2])(x, y)
    assert not np.isnan(expected).any()
    np.testing.assert_allclose(out, expected, atol=1e-8)


def test_tin_raster_leaves_what_is_too_far_from_every_vertex():
    rng = np.random.default_rng(8)
    vertices = np.stack([rng.uniform(0, 40, 60), rng.uniform(0, 40, 60), np.ones(60)], axis=1)
    out = tin_raster(vertices, 1.0, (40, 40), 3.0)
    x, y = np.meshgrid(np.arange(40) + 0.5, np.arange(40) + 0.5)
    distance = cKDTree(vertices[:, :2]).query(np.stack([x, y], axis=-1))[0]
    assert np.isnan(out[distance > 3.0]).all()
    assert np.isnan(out).any()
    assert not np.isnan(out[distance <= 1.5]).any()


@pytest.mark.parametrize(
    "vertices",
    [
        [[5.5, 5.5, 7.0]],
        [[5.5, 5.5, 7.0], [8.5, 5.5, 7.0]],
        [[2.5, 2.5, 7.0], [4.5, 4.5, 7.0], [6.5, 6.5, 7.0]],
    ],
)
def test_vertices_without_area_lend_their_height_to_their_surroundings(vertices):
    vertices = np.array(vertices)
    assert len(triangles(vertices[:, :2])[0]) == 0
    out = tin_raster(vertices, 1.0, (10, 10), 3.0)
    for x, y, z in vertices:
        assert out[int(y), int(x)] == z
    assert np.isnan(out[9, 0])


def test_centres_on_shared_edges_of_a_regular_net_are_all_filled():
    x, y = np.meshgrid(np.arange(-2, 13), np.arange(-2, 13))
    vertices = np.stack([x.ravel(), y.ravel(), (2 * x - y).ravel()], axis=1).astype(float)
    out = tin_raster(vertices, 1.0, (10, 10), 5.0)
    inner = np.arange(10) + 0.5
    np.testing.assert_allclose(out, 2 * inner[None, :] - inner[:, None], atol=1e-9)


@given(st.integers(0, 2**32 - 1), st.sampled_from([1, 7, 1000]))
def test_cells_are_numbered_by_floor_division(seed: int, size: int) -> None:
    rng = np.random.default_rng(seed)
    x, y = rng.integers(0, 5, (2, 200)) * size + rng.choice([0, 1, size - 1], (2, 200))
    west, south = rng.integers(-(10**12), 10**12, 2).tolist()
    table = PointTable({"x": x + west, "y": y + south})
    bounds = Bounds(west, south, west + 12 * size, south + 5 * size)
    assert np.array_equal(cell_number(table, bounds, size), y // size * 12 + x // size)
