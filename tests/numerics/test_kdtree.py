"""The kd-tree against distances of all pairs, ties and duplicates included."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from spl_batch.numerics.neighbours.kdtree import LEAF, build, leaf_of, leaf_slots
from spl_batch.numerics.neighbours.nearest import CROWD
from tests.numerics.searches import nearest_sets


def brute_nearest(
    xyz: NDArray[np.int32], neighbours: int, cap: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Every pair, sorted by squared distance, then row."""
    wide = xyz.astype(np.int64)
    d2 = ((wide[:, None] - wide[None]) ** 2).sum(axis=2)
    rows = np.full((len(xyz), neighbours), -1)
    found = np.zeros(len(xyz), dtype=np.int64)
    for i in range(len(xyz)):
        order = np.lexsort([np.arange(len(xyz)), d2[i]])
        order = order[(order != i) & (d2[i][order] <= cap * cap)][:neighbours]
        rows[i, : len(order)] = order
        found[i] = len(order)
    return rows, found


@given(
    st.integers(0, 2**32 - 1),
    st.integers(1, 300),
    st.sampled_from([3, 40, 20_000]),
    st.integers(1, 20),
    st.sampled_from([1, 7, 5_000, 46_340]),
)
@settings(max_examples=60, deadline=None)
def test_neighbours_are_those_of_all_pairs(
    seed: int, n: int, side: int, neighbours: int, cap: int
) -> None:
    # a small side makes ties and coincident points the rule
    xyz = np.random.default_rng(seed).integers(0, side, (n, 3)).astype(np.int32)
    expected_rows, expected_found = brute_nearest(xyz, neighbours, cap)
    rows, found = nearest_sets(xyz, np.ones(n, dtype=bool), neighbours, cap)
    np.testing.assert_array_equal(found, expected_found)
    np.testing.assert_array_equal(np.sort(rows, axis=1), np.sort(expected_rows, axis=1))


def test_a_crowd_beside_a_lone_query_is_cut_down() -> None:
    # its leaf is far from it, so the first bound holds far more than fit
    rng = np.random.default_rng(4)
    crowd = rng.integers(0, 60, (8 * CROWD, 3)) + np.array([0, 0, 5000])
    xyz = np.concatenate([rng.integers(0, 20_000, (40, 3)) * np.array([1, 1, 0]), crowd]).astype(
        np.int32
    )
    rows, found = nearest_sets(xyz, np.arange(len(xyz)) < 40, 10, 40_000)
    expected, _ = brute_nearest(xyz, 10, 40_000)
    assert (found == 10).all()
    np.testing.assert_array_equal(np.sort(rows, axis=1), np.sort(expected[:40], axis=1))


@pytest.mark.parametrize("n", [1, 33, 500, 1000])
def test_every_slot_finds_its_leaf(n: int) -> None:
    depth = np.uint64(build(np.zeros((n, 3), np.int32)).depth)
    for slot in range(n):
        leaf = np.uint64(leaf_of(np.uint64(slot), depth, np.uint64(n)))
        low, high = leaf_slots(leaf, depth, np.uint64(n))
        assert low <= slot < high


def test_far_apart_coordinates_stay_exact() -> None:
    # beyond float32's 2**24, and differences beyond 2**31
    xyz = np.array(
        [[-(2**31), 0, 0], [-(2**31) + 3, 4, 0], [2**31 - 1, 0, 0], [2**31 - 2, 0, 0]],
        dtype=np.int32,
    )
    rows, found = nearest_sets(xyz, np.ones(4, dtype=bool), 2, 5)
    np.testing.assert_array_equal(found, [1, 1, 1, 1])
    np.testing.assert_array_equal(rows[:, 0], [1, 0, 3, 2])


@pytest.mark.parametrize("n", [0, 1, LEAF, LEAF + 1, 1000, 5000])
def test_tree_holds_every_point_once_inside_its_boxes(n: int) -> None:
    xyz = np.random.default_rng(2).integers(-500, 500, (n, 3)).astype(np.int32)
    tree = build(xyz)
    np.testing.assert_array_equal(np.sort(tree.points[3]), np.arange(n))
    np.testing.assert_array_equal(tree.points[:3].T, xyz[tree.points[3]])
    if n == 0:
        return
    for level in range(tree.depth + 1):
        for j in range(1 << level):
            low, high = (j * n) >> level, ((j + 1) * n) >> level
            held = tree.points[:3, low:high]
            box = tree.boxes[(1 << level) + j]
            assert high > low
            np.testing.assert_array_equal(box, np.r_[held.min(axis=1), held.max(axis=1)])
    assert (n >> tree.depth) <= LEAF
