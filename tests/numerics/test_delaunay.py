"""Growing Delaunay triangulations against circles by brute force, and against Qhull."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, Delaunay

from spl_batch.numerics.triangulation.delaunay import (
    along_curve,
    empty_mesh,
    finite,
    insert,
    triangles,
)

Points = NDArray[np.float64]


def as_set(facets: NDArray[np.int32]) -> set[tuple[int, ...]]:
    return {tuple(row) for row in np.sort(facets, axis=1).tolist()}


def area2(a: Points, b: Points, c: Points) -> Fraction:
    (ax, ay), (bx, by), (cx, cy) = ([Fraction(v) for v in p.tolist()] for p in (a, b, c))
    return (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)


def circle(a: Points, b: Points, c: Points, p: Points) -> Fraction:
    """Positive where p lies in the circle through a, b, c, exactly."""
    rows = []
    for corner in (a, b, c):
        x, y = (Fraction(u) - Fraction(v) for u, v in zip(corner.tolist(), p.tolist(), strict=True))
        rows.append((x, y, x * x + y * y))
    (ax, ay, a2), (bx, by, b2), (cx, cy, c2) = rows
    return a2 * (bx * cy - cx * by) + b2 * (cx * ay - ax * cy) + c2 * (ax * by - bx * ay)


def check(xy: Points, facets: NDArray[np.int32], neighbours: NDArray[np.int32]) -> None:
    """Counter-clockwise, of empty circles, covering the hull, and beside each other."""
    total = Fraction(0)
    for facet in facets:
        a, b, c = xy[facet]
        area = area2(a, b, c)
        assert area > 0
        total += area
        for p in xy:
            assert circle(a, b, c, p) <= 0
    assert float(total) / 2 == pytest.approx(ConvexHull(xy).volume, rel=1e-12)
    for t, facet in enumerate(facets):
        for k in range(3):
            edge = {facet[(k + 1) % 3], facet[(k + 2) % 3]}
            beside = [s for s in range(len(facets)) if s != t and edge <= set(facets[s])]
            assert [neighbours[t, k]] == (beside or [-1])


on_lattice = hnp.arrays(np.int64, st.tuples(st.integers(3, 25), st.just(2)),
                        elements=st.integers(-6, 6))  # fmt: skip


@given(on_lattice)
@settings(max_examples=30, deadline=None)
def test_lattice_points_with_all_their_ties(points: NDArray[np.int64]) -> None:
    xy = np.unique(points, axis=0).astype(np.float64)
    facets, neighbours = triangles(xy)
    if len(xy) < 3 or np.linalg.matrix_rank(xy - xy[0]) < 2:
        assert len(facets) == 0
        return
    check(xy, facets, neighbours)


def test_as_qhull() -> None:
    rng = np.random.default_rng(3)
    inside = rng.random((5000, 2)) * [280.0, 200.0] + 3.3e6
    side = np.linspace(0.0, 290.0, 60) + 3.3e6 - 5.0
    frame = np.column_stack([side, np.full(60, 3.3e6 - 5.0)])
    xy = np.concatenate([inside, frame, frame + np.array([0.0, 210.0])])
    assert as_set(triangles(xy)[0]) == as_set(Delaunay(xy - xy[0]).simplices)


@given(st.integers(0, 2**32 - 1), st.integers(1, 8))
@settings(max_examples=20, deadline=None)
def test_batches_make_what_one_makes(seed: int, batches: int) -> None:
    rng = np.random.default_rng(seed)
    xy = rng.random((300, 2)) * 50.0
    mesh = empty_mesh(xy)
    parts = np.array_split(rng.permutation(len(xy)), batches)
    for part in parts:
        insert(mesh, along_curve(mesh, part))
    assert as_set(finite(mesh)[0]) == as_set(triangles(xy)[0])


def test_what_comes_twice_is_put_in_once() -> None:
    rng = np.random.default_rng(5)
    xy = rng.random((40, 2))
    again = np.concatenate([xy, xy[::-1]])
    facets, _ = triangles(again)
    mirrored = np.where(facets < 40, facets, 79 - facets)
    assert as_set(mirrored) == as_set(triangles(xy)[0])


@pytest.mark.parametrize("line", [np.zeros((5, 2)), np.outer(np.arange(6.0), [2.0, -1.0])])
def test_a_line_has_no_triangles_until_something_lies_beside_it(line: Points) -> None:
    assert len(triangles(line)[0]) == 0
    xy = np.concatenate([line, [[0.5, 3.0], [0.25, -2.0]]])
    mesh = empty_mesh(xy)
    insert(mesh, np.arange(len(line)))
    assert len(finite(mesh)[0]) == 0
    insert(mesh, np.arange(len(xy)))
    assert as_set(finite(mesh)[0]) == as_set(triangles(xy)[0])
    assert len(finite(mesh)[0]) > 0
