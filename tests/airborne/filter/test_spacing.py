"""Spacings and peers against all pairs."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from spl_batch.airborne.filter.ellipsoid.ellipsoid_counts import count_inside
from spl_batch.airborne.filter.ellipsoid.ellipsoid_shape import Shape
from spl_batch.airborne.filter.ellipsoid.spacing import Spacing, peer_distances
from spl_batch.numerics.neighbours.kdtree import build
from tests.airborne.filter.test_ellipsoid import mixed_cloud
from tests.numerics.searches import spacings


@given(st.integers(0, 2**32 - 1), st.integers(0, 200), st.integers(1, 8))
@settings(max_examples=30, deadline=None)
def test_spacings_are_those_of_all_pairs(seed: int, n: int, neighbours: int) -> None:
    xyz = np.random.default_rng(seed).integers(0, 40, (n, 3)).astype(np.int32)
    d2 = ((xyz[:, None].astype(np.int64) - xyz[None]) ** 2).sum(axis=2)
    expected = np.full(n, 12**2)
    if n > neighbours:
        expected = np.minimum(np.sort(d2, axis=1)[:, neighbours], 12**2)
    np.testing.assert_array_equal(spacings(build(xyz), neighbours, 12), expected)
    asked = xyz[:, 2] % 2 == 0
    some = spacings(build(xyz), neighbours, 12, asked)
    np.testing.assert_array_equal(some, np.where(asked, expected, np.nan))


@given(st.integers(0, 2**32 - 1), st.integers(0, 200), st.integers(1, 9))
@settings(max_examples=30, deadline=None)
def test_distances_to_the_last_peer_are_those_of_all_pairs(seed: int, n: int, wanted: int) -> None:
    rng = np.random.default_rng(seed)
    xyz = rng.integers(0, 30, (n, 3)).astype(np.int32)
    places = rng.integers(-5, 35, (40, 3)).astype(np.int32)
    spacing = rng.integers(1, 20, n).astype(np.float64) ** 2
    own = rng.integers(1, 20, 40).astype(np.float64) ** 2
    d2 = ((places[:, None].astype(np.int64) - xyz[None]) ** 2).sum(axis=2).astype(np.float64)
    d2[spacing[None] * 4.0 < own[:, None]] = np.inf
    tree = build(xyz)
    for radius in (12.0, rng.integers(1, 16, 40).astype(np.float64)):
        found = peer_distances(tree, tree.by_slot(spacing), places, own, radius, wanted, 2.0)
        expected = np.full(40, np.inf)
        if n >= wanted:
            expected = np.sqrt(np.sort(d2, axis=1)[:, wanted - 1])
        expected[expected > radius] = np.inf
        np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize(("neighbours", "cap"), [(20, 3000), (6, 20_000)])
def test_spacings_that_are_not_known_are_found_on_the_way(neighbours: int, cap: int) -> None:
    xyz = mixed_cloud(9, 3000)
    shape = Shape(15, 1500.0, 30.0, 12_000.0, 12_000, 1.0)
    tree, density = build(xyz), np.full(len(xyz), 1e-10)
    known = spacings(tree, neighbours, cap)
    query = np.random.default_rng(2).random(len(xyz)) < 0.5
    found = np.full(len(xyz), -1.0)
    given, on_the_way = (
        count_inside(
            xyz, tree, query, density, shape, alpha=1e-9, spacing=spacing,
            rule=Spacing(neighbours, cap), peer_ratio=2.0, tie=True,
        )
        for spacing in (tree.by_slot(known), found)
    )  # fmt: skip
    for one, other in zip(given, on_the_way, strict=True):
        np.testing.assert_array_equal(one, other)
    found = tree.by_row(found)
    some = found >= 0
    assert some[query].all()
    np.testing.assert_array_equal(found[some], known[some])


@pytest.mark.parametrize("cap", [0, 46_341])
def test_a_cap_outside_the_key_is_refused(cap: int) -> None:
    with pytest.raises(ValueError, match="must lie in"):
        spacings(build(np.zeros((2, 3), np.int32)), 1, cap)
