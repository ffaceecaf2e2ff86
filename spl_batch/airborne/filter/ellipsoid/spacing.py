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

from spl_batch.airborne.filter.ellipsoid.ellipsoid_shape import flag
from spl_batch.numerics.compiled import njit
from spl_batch.numerics.neighbours.kdtree import (
    U0,
    U1,
    U2,
    U3,
    U4,
    U5,
    KdTree,
    leaf_of,
    leaf_slots,
    nth_distance,
    search_room,
)


class Spacing(NamedTuple):
    """Which distance is a point's spacing."""

    neighbours: int  #: The one to this neighbour [count], >= 1.
    cap: int  #: Spacing of a point with fewer within it [quanta]; at most ``CAP_MAX``.


@njit()
def measure(points, boxes, depth, slot, space, rule, scratch):  # type: ignore[no-untyped-def]
    """Find out a slot's squared spacing [quanta2]."""
    leaf = leaf_of(slot, depth, np.uint64(points.shape[1]))
    x = np.float64(points[U0, slot])
    y = np.float64(points[U1, slot])
    z = np.float64(points[U2, slot])
    wide = np.float64(rule.cap) * np.float64(rule.cap)
    found = nth_distance(
        points, boxes, depth, leaf, x, y, z, wide, space, -np.inf, scratch
    )  # fmt: skip
    space[slot] = min(found, wide)


@njit()
def _misses(boxes, node, x, y, z, vectors, axes, half):  # type: ignore[no-untyped-def]
    """Whether a node's box lies beyond the ellipsoid's box, or its slab along an own axis."""
    cx = 0.5 * (np.float64(boxes[node, U0]) + np.float64(boxes[node, U3])) - x
    cy = 0.5 * (np.float64(boxes[node, U1]) + np.float64(boxes[node, U4])) - y
    cz = 0.5 * (np.float64(boxes[node, U2]) + np.float64(boxes[node, U5])) - z
    hx = 0.5 * (np.float64(boxes[node, U3]) - np.float64(boxes[node, U0]))
    hy = 0.5 * (np.float64(boxes[node, U4]) - np.float64(boxes[node, U1]))
    hz = 0.5 * (np.float64(boxes[node, U5]) - np.float64(boxes[node, U2]))
    if abs(cx) > half[0] + hx or abs(cy) > half[1] + hy or abs(cz) > half[2] + hz:
        return True
    for i in range(3):
        vx, vy, vz = vectors[i, 0], vectors[i, 1], vectors[i, 2]
        reach = axes[i] + abs(vx) * hx + abs(vy) * hy + abs(vz) * hz + 1.0
        if abs(vx * cx + vy * cy + vz * cz) > reach:
            return True
    return False


@njit()
def walk(  # type: ignore[no-untyped-def]  # noqa: C901
    points, boxes, depth, leaf, slot, quadric, vectors, axes, half, stop, stack,
    space, rule, ratio2, scratch, outer,
):  # fmt: skip
    """Peers inside the ellipsoid around a slot, up to ``stop``, from its leaf upwards."""
    n = np.uint64(points.shape[1])
    first = U1 << depth
    x = np.float64(points[U0, slot])
    y = np.float64(points[U1, slot])
    z = np.float64(points[U2, slot])
    least = space[slot]
    count = -1
    outer[0] = 0.0
    climb = leaf
    stack[0] = leaf
    while True:
        top = U1
        while top > U0:
            top -= U1
            node = stack[top]
            if _misses(boxes, node, x, y, z, vectors, axes, half):
                continue
            if node < first:
                stack[top] = node + node
                stack[top + U1] = node + node + U1
                top += U1 + U1
                continue
            low, high = leaf_slots(node, depth, n)
            for i in range(low, high):
                dx = np.float64(points[U0, i]) - x
                dy = np.float64(points[U1, i]) - y
                dz = np.float64(points[U2, i]) - z
                outside = flag(quadric, dx, dy, dz)
                if outside >= 1.0:
                    continue
                if space[i] < 0.0:
                    measure(points, boxes, depth, i, space, rule, scratch)
                if space[i] * ratio2 >= least:
                    count += 1
                    outer[0] = max(outer[0], outside)
            if count >= stop:
                return stop
        if climb <= U1:
            return count
        stack[0] = climb ^ U1
        climb >>= U1


def peer_distances(
    tree: KdTree,
    spacing: NDArray[np.float64],
    places: NDArray[np.int32],
    own: NDArray[np.float64],
    radius: float | NDArray[np.float64],
    wanted: int,
    peer_ratio: float,
) -> NDArray[np.float64]:
    """Distance from places to their n-th nearest peer, infinite if there are fewer: (m,) [quanta].

    ``spacing``: of the points, squared, by slot; negative for those that do not count. ``own``: of
    the places (m, 3), squared. ``radius``: of each or all, inclusive. A point at a place counts.
    """
    squared = np.full(len(places), np.inf)
    if tree.points.size:
        wide = spacing * (peer_ratio * peer_ratio)
        limit = np.ascontiguousarray(np.broadcast_to(np.square(np.float64(radius)), len(places)))
        room = search_room(wanted)
        _distances(tree.points, tree.boxes, tree.depth, wide, places, own, limit, room, squared)
    distance: NDArray[np.float64] = np.sqrt(squared)
    return distance


@njit()
def _distances(points, boxes, depth, wide, places, own, limit, room, out):  # type: ignore[no-untyped-def]
    """Squared distance to the n-th peer."""
    depth = np.uint64(depth)
    for i in range(len(places)):
        x, y, z = np.float64(places[i, 0]), np.float64(places[i, 1]), np.float64(places[i, 2])
        out[i] = nth_distance(
            points, boxes, depth, U1, x, y, z, limit[i], wide, own[i], room
        )  # fmt: skip
