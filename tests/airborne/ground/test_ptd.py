"""Triangulated surfaces, layers and the densification rule against slow twins."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.spatial import Delaunay

from spl_batch.airborne.ground.lowest_layers import continued, lowest_layers
from spl_batch.airborne.ground.ptd import Limits, _frame, densify, facet_fit, heights_above
from spl_batch.numerics.cell_groups import group_by_cell
from spl_batch.numerics.triangulation.tin import (
    OUTSIDE,
    first_of,
    interpolate,
    locate,
    locate_one,
    triangulate,
    vertex_slopes,
)

LIMITS = Limits(
    terrain_slope=28.6,
    sin_angle=np.sin(np.radians(10)),
    distance_m=1.4,
    spread_m=0.0,
    insert_m=0.01,
)


def cloud(n: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(0, 100, (n, 3))


def test_location_agrees_with_scipy() -> None:
    xyz = cloud(300)
    tin = triangulate(xyz)
    assert tin is not None
    places = np.random.default_rng(1).uniform(-5, 105, (2000, 2))
    found = np.empty(2000, dtype=np.int32)
    locate(tin.xyz, tin.facets, tin.neighbours, places[:, 0], places[:, 1], found)
    other = Delaunay(xyz[:, :2] - xyz[0, :2])
    expected = other.find_simplex(places - xyz[0, :2])
    assert np.array_equal(found == OUTSIDE, expected < 0)
    inside = expected >= 0
    corners, same = tin.facets[found[inside]], other.simplices[expected[inside]]
    assert np.array_equal(np.sort(corners, axis=1), np.sort(same, axis=1))
    assert 0 < np.sum(found == OUTSIDE) < 1000


def test_interpolation_far_from_the_origin() -> None:
    xyz = cloud(200) + np.array([5e5, 6e6, 0])
    xyz[:, 2] = 0.3 * (xyz[:, 0] - 5e5) - 0.7 * (xyz[:, 1] - 6e6)
    tin = triangulate(xyz)
    assert tin is not None
    x, y = 5e5 + np.linspace(30, 70, 50), 6e6 + np.linspace(40, 60, 50)
    expected = 0.3 * (x - 5e5) - 0.7 * (y - 6e6)
    np.testing.assert_allclose(interpolate(tin, x, y), expected, atol=1e-6)


def test_slopes_are_means_of_the_triangles_around_by_their_least_heights() -> None:
    xyz = cloud(60, seed=3)
    tin = triangulate(xyz)
    assert tin is not None
    slopes = vertex_slopes(tin)
    for v in range(len(xyz)):
        around = [t for t in tin.facets if v in t]
        normals = np.array([np.cross(xyz[b] - xyz[a], xyz[c] - xyz[a]) for a, b, c in around])
        longest = [
            np.linalg.norm(xyz[t, :2] - xyz[np.roll(t, 1), :2], axis=1).max() for t in around
        ]
        weight = (normals[:, 2] / longest) ** 2
        expected = np.average(-normals[:, :2] / normals[:, 2:], axis=0, weights=weight)
        np.testing.assert_allclose(slopes[v], expected, atol=1e-9)


def test_of_the_triangles_that_hold_a_place_the_first_is_found_from_anywhere() -> None:
    x, y = (v.ravel() for v in np.meshgrid(np.arange(6.0), np.arange(6.0)))
    tin = triangulate(np.column_stack([x, y, x]))
    assert tin is not None
    corners = tin.xyz[tin.facets, :2]
    for px, py in np.stack(np.meshgrid(np.arange(11), np.arange(11)), axis=-1).reshape(-1, 2) / 2:
        ahead = np.roll(corners, -1, axis=1) - corners
        towards = np.array([px, py]) - corners
        left = ahead[..., 0] * towards[..., 1] - ahead[..., 1] * towards[..., 0]
        holds = (left >= 0).all(axis=1)
        for start in range(0, len(corners), 7):
            found, _ = locate_one(tin.xyz, tin.facets, tin.neighbours, px, py, start)
            first = first_of(tin.xyz, tin.facets, tin.neighbours, px, py, found)
            assert first == np.flatnonzero(holds)[0]


@pytest.mark.parametrize(
    "xyz", [np.zeros((0, 3)), cloud(2), np.outer(np.arange(9.0), [1, 2, 3]), np.ones((5, 3))]
)
def test_no_triangulation(xyz: np.ndarray) -> None:
    assert triangulate(xyz) is None


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 10_000))
def test_distance_and_angle_agree_with_vectors(seed: int) -> None:
    rng = np.random.default_rng(seed)
    corners = rng.uniform(-10, 10, (3, 3))
    point = rng.uniform(-10, 10, 3)
    tin = triangulate(corners)
    normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    assume(tin is not None and abs(normal[2]) > 1e-3)
    assert tin is not None
    normal *= np.sign(normal[2]) / np.linalg.norm(normal)
    distance = normal @ (point - corners[0])
    angles = [np.arcsin(abs(distance) / np.linalg.norm(point - c)) for c in corners]
    found = facet_fit(tin.xyz, tin.facets[0], tin.planes[0], *point)
    assert found[0] == pytest.approx(distance, abs=1e-9)
    assert found[1] == pytest.approx(np.sin(max(angles)), abs=1e-9)


def test_densification_keeps_to_its_limits() -> None:
    seeds = np.array([[x, y, 0.0] for x in (0, 20, 40) for y in (0, 20, 40)])
    gentle, steep, far = [10.0, 10.0, 1.2], [30.0, 10.0, 3.0], [10.0, 30.0, -1.5]
    candidates = np.array([gentle, steep, far])
    tin, taken = densify(seeds, candidates, np.full(3, -np.inf), LIMITS, 5.0)
    assert taken.tolist() == [True, False, False]
    assert tin is not None
    height, edge = heights_above(tin, *candidates.T)
    np.testing.assert_allclose(height, [0, 3, -1.5], atol=1e-9)
    assert np.all(edge <= 20)


def test_a_floor_keeps_doubtful_candidates_out() -> None:
    seeds = np.array([[x, y, 0.0] for x in (0, 20) for y in (0, 20)])
    candidates = np.array([[10.0, 9.0, -1.0]])
    assert densify(seeds, candidates, np.array([-0.2]), LIMITS, 5.0)[1].tolist() == [False]
    assert densify(seeds, candidates, np.array([-2.0]), LIMITS, 5.0)[1].tolist() == [True]


def test_a_steep_facet_judges_the_mirror_image() -> None:
    """Beside a wall the candidate itself is far from the wall's plane."""
    wall = Limits(2.0, np.sin(np.radians(10)), 1.4, 0.0, 0.01)
    plain = wall._replace(terrain_slope=1e9)
    seeds = np.array([[x, y, z] for x, z in ((0, 0), (10, 0), (12, 9)) for y in (0.0, 10, 20)])
    candidates = np.array([[10.3, 11.0, 0.0]])
    floor = np.array([-np.inf])
    assert densify(seeds, candidates, floor, plain, 20.0)[1].tolist() == [False]
    assert densify(seeds, candidates, floor, wall, 20.0)[1].tolist() == [True]


def test_no_seeds_no_surface() -> None:
    tin, taken = densify(np.zeros((0, 3)), cloud(4), np.zeros(4), LIMITS, 5.0)
    assert tin is None
    assert not taken.any()


def test_grouping_is_a_stable_partition() -> None:
    xyz = cloud(500) - 50
    cells = group_by_cell(xyz[:, 0], xyz[:, 1], 10.0)
    key = np.floor(xyz[:, 1] / 10) * 1000 + np.floor(xyz[:, 0] / 10)
    assert np.array_equal(cells.order, np.argsort(key, kind="stable"))
    assert np.array_equal(np.diff(cells.start)[np.diff(cells.start) > 0], np.unique_counts(key)[1])


def test_layer_ignores_a_stray_low_point() -> None:
    rng = np.random.default_rng(5)
    x, y = rng.uniform(0, 1, (2, 60))
    z = np.concatenate([[-4.0], rng.normal(2, 0.05, 39), rng.uniform(5, 15, 20)])
    x, y, z = np.round([x, y, z], 3)
    nodes = lowest_layers(x, y, z, group_by_cell(x, y, 1.0), 0.3)
    assert nodes.points.tolist() == [1, 39]
    assert nodes.doubtful.tolist() == [True, False]
    np.testing.assert_allclose(nodes.xyz[1], [x[1:40].mean(), y[1:40].mean(), z[1:40].mean()])


def test_layers_do_not_depend_on_the_order_of_points() -> None:
    xyz = np.round(cloud(4000, 6) * [0.1, 0.1, 0.02] + [5e5, 6e6, 0.0], 3)
    again = xyz[np.random.default_rng(7).permutation(len(xyz))]
    one, other = (
        lowest_layers(*points.T, group_by_cell(points[:, 0], points[:, 1], 1.0), 0.3)
        for points in (xyz, again)
    )
    for values, same in zip(one, other, strict=True):
        assert np.array_equal(values, same)


def test_support_agrees_with_all_pairs() -> None:
    xyz = cloud(200) * [0.2, 0.2, 0.06]
    cells = group_by_cell(xyz[:, 0], xyz[:, 1], 1.0)
    nodes = lowest_layers(*xyz.T, cells, 0.3)
    offset = nodes.xyz[:, None] - nodes.xyz[None]
    d = np.hypot(offset[..., 0], offset[..., 1])
    near = (d <= 2.0) & (np.abs(offset[..., 2]) <= 0.25 + 0.3 * d)
    near &= nodes.cell[:, None] != nodes.cell[None]
    found = continued(nodes, cells, 1.0)
    assert np.array_equal(found, near.sum(axis=1) >= 2)
    assert 0.1 < found.mean() < 0.9


def test_places_of_the_frame_are_two_margins_apart_at_most() -> None:
    frame = _frame(np.array([[0.0, 0.0, 5.0], [100.0, 30.0, 9.0]]), 10.0)
    east, north = (np.unique(frame[:, axis]) for axis in (0, 1))
    np.testing.assert_allclose(east, np.linspace(-10, 110, 7))
    np.testing.assert_allclose(north, np.linspace(-10, 40, 4))
    assert len(np.unique(frame, axis=0)) == len(frame) == 18
    assert len(_frame(np.zeros((1, 3)), 10.0)) == 4, "around one place the corners alone"
