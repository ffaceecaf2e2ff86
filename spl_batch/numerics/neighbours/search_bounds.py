"""Distances within which a search for neighbours need not look farther: two ways to a first one."""

import math
from typing import Final

import numpy as np

from spl_batch.numerics.compiled import njit
from spl_batch.numerics.neighbours.kdtree import U0, U1, U2, U3, leaf_slots
from spl_batch.numerics.neighbours.nearest_selection import largest, within_which
from spl_batch.numerics.simd import UL, least, lesser, load, root, spread

SPARE: Final = 6
"""Neighbours more than needed with which a first bound is good enough [count]."""

BESIDE: Final = 16
"""Latest points from whose neighbours a distance for the next follows [count]; whole lanes."""

LIKELY: Final = 0.5
"""Part of the way from one of them that is added to its distance: nearly always that is enough."""


@njit()
def _bound_above(points, depth, leaf, slot, k, cap, distance):  # type: ignore[no-untyped-def]
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


@njit()
def first_limits(points, depth, leaf, slot, k, cap, beside, distance):  # type: ignore[no-untyped-def]
    """Squared distances within which a slot likely, and surely, has k others if the cap's has them.

    Parameters
    ----------
    points, depth, leaf, slot, k, cap
        The tree's points, the depth of its leaves, the slot's leaf, the slot, neighbours wanted
        and the farthest that counts [quanta].
    beside : (4, BESIDE) float64
        Positions of slots that were searched, and the distances of their last neighbours.
    distance : (8 k + 16 + 2 LEAF,) float64
        Scratch.
    """
    x, y, z = (
        np.float64(points[U0, slot]),
        np.float64(points[U1, slot]),
        np.float64(points[U2, slot]),
    )
    # Within them a point likely, and surely, has as many as those beside it.
    likely = sure = spread(np.inf)
    for i in range(U0, np.uint64(BESIDE), UL):
        dx = load(beside, (U0, i)) - spread(x)
        dy = load(beside, (U1, i)) - spread(y)
        dz = load(beside, (U2, i)) - spread(z)
        apart, has = root(dx * dx + dy * dy + dz * dz), load(beside, (U3, i))
        sure = lesser(sure, apart + has)
        likely = lesser(likely, spread(LIKELY) * apart + has)
    if least(sure) < cap:
        return math.floor(least(likely) ** 2) + 1.0, math.floor(least(sure) ** 2) + 1.0
    found = _bound_above(points, depth, leaf, slot, k, cap, distance)
    return found, found
