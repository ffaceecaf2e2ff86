r"""Spacing of the returns around a point, and neighbours that belong to as thin a structure.

An ellipsoid fitted to noise just above a surface reaches down and counts the surface. But the
surface's returns lie close together, the noise far from all of them. A neighbour is a *peer*, and
speaks for a point, when its spacing is not much smaller than the point's,

.. math:: s_q \ge s_p / c.

In pure noise nearly all neighbours are peers, so the Poisson law of the counts [W18 Eq. 6-8] stays
an upper bound.

====== ==================================================================
symbol name
====== ==================================================================
s      ``spacing``: distance to the n-th neighbour, capped [quanta, squared]
c      ``peer_ratio``
====== ==================================================================

Deviation: the sources count every neighbour.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.numerics.compiled import njit
from spl_batch.numerics.neighbours.kdtree import (
    LEAF,
    U0,
    U1,
    KdTree,
    box_distance,
    leaf_slots,
    nearest_keys,
)


class Spacing(NamedTuple):
    """Which distance is a point's spacing."""

    neighbours: int  #: The one to this neighbour [count], >= 1.
    cap: int  #: Spacing of a point with fewer within it [quanta]; at most ``CAP_MAX``.


@njit()
def spacing_at(points, boxes, depth, leaf, slot, rule, keys, distance, fresh, stack, bound):  # type: ignore[no-untyped-def]
    """Squared spacing of one slot; arguments as for :func:`nearest_keys` [quanta2]."""
    found = nearest_keys(
        points, boxes, depth, leaf, slot, rule.cap, keys, distance, fresh, stack, bound
    )
    if found == rule.neighbours:
        return np.float64(keys[found - 1] >> 32)
    return np.float64(rule.cap) * np.float64(rule.cap)


@njit()
def spacing_scratch(rule):  # type: ignore[no-untyped-def]
    """Arrays for :func:`spacing_at`: ``keys, distance, fresh, stack, bound``."""
    return (
        np.empty(rule.neighbours, np.int64), np.empty(LEAF), np.empty(LEAF, np.int64),
        np.empty(64, np.uint64), np.empty(64),
    )  # fmt: skip


def enough_peers(
    tree: KdTree,
    spacing: NDArray[np.float64],
    places: NDArray[np.int32],
    own: NDArray[np.float64],
    radius: float | NDArray[np.float64],
    wanted: int,
    peer_ratio: float,
) -> NDArray[np.bool_]:
    """Which places have enough peers around them: (m,) bool.

    Parameters
    ----------
    spacing : (n,) float64
        Squared spacings of the points, by slot [quanta2]; negative for those that do not count.
    places : (m, 3) int32
        Coordinates relative to the tree's anchor [quanta].
    own : (m,) float64
        Squared spacings of the places, >= 0 [quanta2].
    radius : float or (m,) float64
        Farthest point that counts, inclusive [quanta].
    wanted : int
        Points needed [count], >= 1.
    peer_ratio : float
        A peer's spacing is at least the place's divided by this.
    """
    out = np.zeros(len(places), dtype=np.bool_)
    if tree.points.size:
        wide = spacing * (peer_ratio * peer_ratio)
        limit = np.ascontiguousarray(np.broadcast_to(np.square(np.float64(radius)), (len(places),)))
        _enough_all(tree.points, tree.boxes, tree.depth, wide, places, own, limit, wanted, out)
    return out


def peer_distances(
    tree: KdTree,
    spacing: NDArray[np.float64],
    places: NDArray[np.int32],
    own: NDArray[np.float64],
    radius: float,
    wanted: int,
    peer_ratio: float,
) -> NDArray[np.float64]:
    """Distance from places to their n-th nearest peer.

    Parameters
    ----------
    tree, spacing, places, own, wanted, peer_ratio
        As for :func:`enough_peers`.
    radius : float
        Farthest point looked at, inclusive [quanta].

    Returns
    -------
    (m,) float64
        Distance to peer number ``wanted`` [quanta]; infinite where there are fewer.
    """
    squared = np.full(len(places), np.inf)
    if tree.points.size:
        wide = spacing * (peer_ratio * peer_ratio)
        limit = float(radius) ** 2
        _distances(tree.points, tree.boxes, tree.depth, wide, places, own, limit, wanted, squared)
    distance: NDArray[np.float64] = np.sqrt(squared)
    return distance


@njit()
def peers_within(points, boxes, depth, wide, x, y, z, own, limit, wanted, stack):  # type: ignore[no-untyped-def]
    """Peers within a distance of a place, nearer branch first; stops at ``wanted``.

    Parameters
    ----------
    points, boxes, depth
        The tree; the depth as uint64.
    wide : (n,) float64
        Squared spacing by slot, times the squared ratio [quanta2].
    x, y, z : float
        The place.
    own : float
        Its squared spacing [quanta2].
    limit : float
        Squared distance, inclusive [quanta2].
    stack : (64,) uint64
        Scratch.

    Returns
    -------
    int
        Peers, a point at the place itself included; at most one leaf more than ``wanted``.
    """
    n = np.uint64(points.shape[1])
    first = U1 << depth
    count = 0
    stack[0] = U1
    top = U1
    while top > U0 and count < wanted:
        top -= U1
        node = stack[top]
        if box_distance(boxes, node, x, y, z) > limit:
            continue
        if node >= first:
            low, high = leaf_slots(node, depth, n)
            for slot in range(low, high):
                dx, dy, dz = points[U0, slot] - x, points[1, slot] - y, points[2, slot] - z
                near = dx * dx + dy * dy + dz * dz <= limit
                count += near & (wide[slot] >= own)
            continue
        near_node, far = node + node, node + node + U1
        if box_distance(boxes, far, x, y, z) < box_distance(boxes, near_node, x, y, z):
            near_node, far = far, near_node
        stack[top] = far
        stack[top + U1] = near_node
        top += U1 + U1
    return count


@njit()
def _enough_all(points, boxes, depth, wide, places, own, limit, wanted, out):  # type: ignore[no-untyped-def]
    stack = np.empty(64, dtype=np.uint64)
    depth = np.uint64(depth)
    for i in range(len(places)):
        x, y, z = np.float64(places[i, 0]), np.float64(places[i, 1]), np.float64(places[i, 2])
        out[i] = wanted <= peers_within(
            points, boxes, depth, wide, x, y, z, own[i], limit[i], wanted, stack
        )


@njit()
def _distances(points, boxes, depth, wide, places, own, limit, wanted, out):  # type: ignore[no-untyped-def]
    """Squared distance to the n-th peer; leaves out branches beyond the n-th so far."""
    depth = np.uint64(depth)
    n, first = np.uint64(points.shape[1]), U1 << depth
    stack, best = np.empty(64, dtype=np.uint64), np.empty(wanted, dtype=np.float64)
    for i in range(len(places)):
        x, y, z = np.float64(places[i, 0]), np.float64(places[i, 1]), np.float64(places[i, 2])
        best[:] = np.inf
        stack[0] = U1
        top = U1
        while top > U0:
            top -= U1
            node = stack[top]
            if box_distance(boxes, node, x, y, z) > min(limit, best[wanted - 1]):
                continue
            if node < first:
                stack[top] = node + node
                stack[top + U1] = node + node + U1
                top += U1 + U1
                continue
            low, high = leaf_slots(node, depth, n)
            for slot in range(low, high):
                dx, dy, dz = points[U0, slot] - x, points[1, slot] - y, points[2, slot] - z
                d2 = dx * dx + dy * dy + dz * dz
                if d2 > limit or d2 >= best[wanted - 1] or wide[slot] < own[i]:
                    continue
                j = wanted - 1
                while j > 0 and best[j - 1] > d2:
                    best[j] = best[j - 1]
                    j -= 1
                best[j] = d2
        out[i] = best[wanted - 1]
