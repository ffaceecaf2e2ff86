"""Distances within which a search for neighbours need not look farther: two ways to a first one."""

import math
from typing import Final

import numpy as np
from numba import njit

from spl_batch.kernels.kdtree import U0, U1, U2, U3, leaf_slots
from spl_batch.kernels.selection import largest, within_which

SPARE: Final = 6
"""Neighbours more than needed with which a first bound is good enough [count]."""

BESIDE: Final = 16
"""Latest points from whose neighbours a distance for the next follows [count]."""


@njit(nogil=True, cache=True)
def bound_above(points, depth, leaf, slot, k, cap, distance):  # type: ignore[no-untyped-def]
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
    enough, _ = within_which(distance, size, k + 1, SPARE, largest(distance, size))
    return min(limit, enough)


@njit(nogil=True, cache=True, fastmath={"nnan", "nsz"})
def bound_beside(beside, apart, x, y, z):  # type: ignore[no-untyped-def]
    """Distance within which a place has as many as those beside it have within theirs.

    ``beside`` (4, m) holds their places and distances; ``apart`` (m,) is scratch.
    """
    for i in range(BESIDE):
        dx, dy, dz = beside[U0, i] - x, beside[U1, i] - y, beside[U2, i] - z
        apart[i] = math.sqrt(dx * dx + dy * dy + dz * dz) + beside[U3, i]
    least = apart[U0]
    for i in range(BESIDE):
        least = min(least, apart[i])
    return least
