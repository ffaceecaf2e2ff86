"""Neighbours and spacings of every point of a table, which filters ask for leaf by leaf.

The kernels that find them are the filters' own; tests compare them with all pairs.
"""

from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spl_batch.airborne.filter.ellipsoid.spacing import Spacing, measure
from spl_batch.numerics.neighbours.kdtree import (
    LEAF,
    U1,
    U3,
    KdTree,
    build,
    check_cap,
    leaf_slots,
    search_room,
)
from spl_batch.numerics.neighbours.nearest import edges_of_leaves, neighbours_of_leaves

CHUNK: Final = 64
"""Leaves that are searched before their neighbours are put away [count]."""


def nearest_sets(
    xyz: NDArray[np.int32], query: NDArray[np.bool_], neighbours: int, cap: int
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Nearest neighbours of points among their own table, the point itself left out."""
    check_cap(cap)
    rows = np.full((len(xyz), neighbours), -1, dtype=np.int32)
    found = np.zeros(len(xyz), dtype=np.int32)
    tree = build(xyz)
    if len(xyz):
        edges = edges_of_leaves(tree)
        _by_leaves(tree.points, tree.boxes, edges, tree.depth, query, cap, rows, found)
    return rows[query], found[query]


def spacings(
    tree: KdTree, neighbours: int, cap: int, asked: NDArray[np.bool_] | None = None
) -> NDArray[np.float64]:
    """Squared distance of points to their n-th neighbour."""
    check_cap(cap)
    out = np.full(tree.points.shape[1], np.nan)
    wanted = np.ones(len(out), np.bool_) if asked is None else asked
    if len(out):
        rule, room = Spacing(neighbours, cap), search_room(neighbours + 1)
        _spacings(tree.points, tree.boxes, tree.depth, rule, wanted, room, out)
    return out


@njit(nogil=True, cache=True)
def _by_leaves(points, boxes, edges, depth, query, cap, rows, found):  # type: ignore[no-untyped-def]
    """Neighbours of every query point, in tree order, so that the cache stays warm."""
    n, depth, k = np.uint64(points.shape[1]), np.uint64(depth), rows.shape[1]
    leaves, chunk = U1 << depth, np.uint64(CHUNK)
    room = CHUNK * LEAF
    asked, others = np.empty(room, np.bool_), np.empty((room, k), np.int32)
    count, last, few = np.empty(room, np.int64), np.empty(room), np.empty(room)
    for begin in range(leaves, leaves + leaves, chunk):
        end = min(begin + chunk, leaves + leaves)
        low, _ = leaf_slots(begin, depth, n)
        _, high = leaf_slots(end - U1, depth, n)
        for at in range(high - low):
            asked[at] = query[points[U3, low + at]]
        neighbours_of_leaves(
            points, boxes, edges, depth, (begin, end), asked, k, cap, 0, others, count, last, few
        )
        for at in range(high - low):
            if asked[at]:
                row = points[U3, low + at]
                found[row] = count[at]
                for i in range(count[at]):
                    rows[row, i] = points[U3, others[at, i]]


@njit(nogil=True, cache=True)
def _spacings(points, boxes, depth, rule, asked, scratch, out):  # type: ignore[no-untyped-def]
    """Points in tree order, so that the cache stays warm."""
    depth = np.uint64(depth)
    space = np.empty(points.shape[1])
    for slot in range(np.uint64(points.shape[1])):
        if asked[points[U3, slot]]:
            measure(points, boxes, depth, slot, space, rule, scratch)
            out[points[U3, slot]] = space[slot]
