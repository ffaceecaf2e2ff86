"""Nearest neighbours on the integer lattice, exact and in no particular order.

1. Among the points of an ancestor of the query's leaf, which lie side by side, a distance is
   found within which there are enough.
2. The tree is walked from the leaf upwards for all points within it; when they become many,
   the nearest are kept and the distance shrinks.

:func:`~spl_batch.kernels.kdtree.nearest_keys` sorts each neighbour in as it is met, which is
quicker for a few (``benchmarks/denoise.py``). Here nothing is sorted: the distance of the last
neighbour is found by counting how many are nearer than a guess, and guessing better. Distances
and counts are loops without a branch, which the compiler turns into vector instructions.

Squared distances are sums of squared integer differences in float64: exact below
2**53 quanta2, that is up to 50 km. Ties are broken by row, so a query's neighbours depend
on the points alone and neither on the tree nor on what else the table holds.
"""

from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spl_batch.kernels.kdtree import (
    LEAF,
    U0,
    U1,
    U2,
    U3,
    box_distance,
    leaf_slots,
    search,
)

GUESSES: Final = 6
"""Guesses by interpolation, before bisection, at the distance of the last neighbour [count]."""

SPARE: Final = 6
"""Neighbours more than needed with which a first bound is good enough [count]."""

CROWD: Final = 96
"""Points within the distance, beside k, beyond which it is made to shrink [count]."""


def nearest_sets(
    xyz: NDArray[np.int32], query: NDArray[np.bool_], neighbours: int, cap: int
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Nearest neighbours of points among their own table, the point itself left out.

    Parameters
    ----------
    xyz : (n, 3) int32
        Coordinates relative to any anchor [quanta].
    query : (n,) bool
        Points whose neighbours are wanted.
    neighbours : int
        Neighbours per point [count].
    cap : int
        Farthest neighbour, inclusive [quanta]; at most :data:`~spl_batch.kernels.kdtree.CAP_MAX`.

    Returns
    -------
    rows : (m, neighbours) int32
        Rows in no particular order, for the query points in table order; -1 where there
        are fewer.
    found : (m,) int32
        Neighbours found [count].
    """
    return search(_nearest_all, xyz, query, neighbours, cap)


@njit(nogil=True, cache=True, inline="always")
def _count_to(distance, size, limit):  # type: ignore[no-untyped-def]
    """How many of the first distances are at most ``limit``."""
    count = np.int64(0)
    for i in range(size):
        count += np.int64(distance[i] <= limit)
    return count


@njit(nogil=True, cache=True, inline="always")
def _largest(distance, size):  # type: ignore[no-untyped-def]
    """Largest of the first distances."""
    most = 0.0
    for i in range(size):
        most = max(most, distance[i])
    return most


@njit(nogil=True, cache=True, error_model="numpy")
def _enough(distance, size, wanted, spare):  # type: ignore[no-untyped-def]
    """Whole number not above the largest distance, to which ``wanted`` to that + ``spare`` are.

    With more ties than that it is the distance of number ``wanted``. There must be as many;
    counts are taken for linear between the limits, as in a plane.
    """
    low, high = -1.0, _largest(distance, size)
    below, enough = 0, np.int64(size)
    step = 0
    while enough > wanted + spare and high - low > 1.0:
        step += 1
        if step <= GUESSES:
            share = (wanted + 0.5 * spare - below) / (enough - below)
            guess = np.floor(low + share * (high - low))
            guess = min(max(guess, low + 1.0), high - 1.0)
        else:
            guess = np.floor(0.5 * (low + high))
        count = _count_to(distance, size, guess)
        if count >= wanted:
            high, enough = guess, count
        else:
            low, below = guess, count
    return high


@njit(nogil=True, cache=True)
def first_bound(points, depth, leaf, slot, k, cap, distance):  # type: ignore[no-untyped-def]
    """Squared distance, at most the cap's, within which a slot has k others if it has them.

    It is found among the points of an ancestor of its leaf.
    """
    n = np.uint64(points.shape[1])
    level, above = depth, leaf
    first, stop = leaf_slots(leaf, depth, n)
    while level > U0 and stop - first < np.uint64(3 * k + 8):
        level -= U1
        above >>= U1
        first, stop = leaf_slots(above, level, n)
    size = stop - first
    limit = np.float64(cap) * np.float64(cap)
    if size <= np.uint64(k):
        return limit
    x, y, z = (
        np.float64(points[U0, slot]),
        np.float64(points[U1, slot]),
        np.float64(points[U2, slot]),
    )
    for i in range(size):
        dx = np.float64(points[U0, first + i]) - x
        dy = np.float64(points[U1, first + i]) - y
        dz = np.float64(points[U2, first + i]) - z
        distance[i] = dx * dx + dy * dy + dz * dz
    return min(limit, _enough(distance, size, k + 1, SPARE))


@njit(nogil=True, cache=True)
def nearest_slots(  # type: ignore[no-untyped-def]  # noqa: C901
    points, boxes, depth, leaf, slot, k, cap, distance, near, kept, stack
):
    """Nearest neighbours of one slot.

    Indices are unsigned throughout: a signed one costs numba a test for wrapping, and
    the compiler its vector instructions.

    Parameters
    ----------
    points, boxes, depth
        The tree; the depth as uint64.
    leaf, slot : uint64
        Node number of the slot's leaf, and the slot.
    k : int
        Neighbours [count].
    cap : int
        Farthest neighbour, inclusive [quanta].
    distance, near, kept, stack
        From :func:`workspace`; ``kept`` receives the slots of the neighbours.

    Returns
    -------
    found : int
        Neighbours found, at most k.
    last : float
        Squared distance of the farthest of them [quanta2]; 0 without any.
    """
    n = np.uint64(points.shape[1])
    first = U1 << depth
    limit = first_bound(points, depth, leaf, slot, k, cap, distance)
    x, y, z = (
        np.float64(points[U0, slot]),
        np.float64(points[U1, slot]),
        np.float64(points[U2, slot]),
    )
    size, full = U0, np.uint64(k + CROWD)
    climb = leaf
    stack[0] = leaf
    while True:
        top = U1
        while top > U0:
            top -= U1
            node = stack[top]
            if box_distance(boxes, node, x, y, z) > limit:
                continue
            if node < first:
                stack[top] = node + node
                stack[top + U1] = node + node + U1
                top += U1 + U1
                continue
            low, high = leaf_slots(node, depth, n)
            length = high - low
            for j in range(length):
                dx = np.float64(points[U0, low + j]) - x
                dy = np.float64(points[U1, low + j]) - y
                dz = np.float64(points[U2, low + j]) - z
                distance[j] = dx * dx + dy * dy + dz * dz
            if node == leaf:
                distance[slot - low] = np.inf
            for j in range(length):
                near[size], kept[size] = distance[j], low + j
                size += np.uint64(distance[j] <= limit)
            if size > full:
                size = _keep(points, near, kept, size, k)
                limit = _largest(near, size)
        if climb <= U1:
            break
        stack[0] = climb ^ U1
        climb >>= U1
    if size > np.uint64(k):
        size = _keep(points, near, kept, size, k)
    return np.int64(size), _largest(near, size)


@njit(nogil=True, cache=True)
def _keep(points, near, kept, size, k):  # type: ignore[no-untyped-def]
    """Keep the k nearest, of those as far as the last the ones with the smallest rows."""
    limit = _enough(near, size, k, 0)
    surplus = _count_to(near, size, limit) - k
    while surplus > 0:
        worst, highest = U0, np.int64(-1)
        for i in range(size):
            row = np.int64(points[U3, kept[i]])
            if near[i] == limit and row > highest:
                worst, highest = np.uint64(i), row
        near[worst] = np.inf
        surplus -= 1
    found = U0
    for i in range(size):
        distance, slot = near[i], kept[i]
        near[found], kept[found] = distance, slot
        found += np.uint64(distance <= limit)
    return found


@njit(nogil=True, cache=True)
def distance_to(near, size, wanted):  # type: ignore[no-untyped-def]
    """Squared distance to neighbour number ``wanted`` of those that :func:`nearest_slots` left."""
    limit, last = _enough(near, size, wanted, 0), 0.0
    for i in range(size):
        if near[i] <= limit:
            last = max(last, near[i])
    return last


@njit(nogil=True, cache=True)
def workspace(k):  # type: ignore[no-untyped-def]
    """Arrays for :func:`nearest_slots`: ``distance, near, kept, stack``."""
    room = k + CROWD + LEAF + 1
    return (
        np.empty(8 * k + 16 + 2 * LEAF),
        np.empty(room),
        np.empty(room, np.uint64),
        np.empty(64, np.uint64),
    )


@njit(nogil=True, cache=True)
def _nearest_all(points, boxes, depth, query, cap, rows, found):  # type: ignore[no-untyped-def]
    """Neighbours of every query point, in tree order, so that the cache stays warm."""
    n, depth, k = np.uint64(points.shape[1]), np.uint64(depth), rows.shape[1]
    distance, near, kept, stack = workspace(k)
    for leaf in range(U1 << depth, U1 << (depth + U1)):
        low, high = leaf_slots(leaf, depth, n)
        for slot in range(low, high):
            row = points[U3, slot]
            if query[row]:
                found[row], _ = nearest_slots(
                    points, boxes, depth, leaf, slot, k, cap, distance, near, kept, stack
                )
                for i in range(found[row]):
                    rows[row, i] = points[U3, kept[i]]
