"""Neighbours in simple volumes around each point: spheres [W17 5.2.1], cylinders [W17 Eq. 3.2].

Both are open: a point on the boundary is outside, as in the sources' inequalities. All
differences are whole numbers below 2**26 or so, their squares exact in float64.
"""

import numpy as np
from numpy.typing import NDArray

from spl_batch.numerics.compiled import njit
from spl_batch.numerics.neighbours.kdtree import (
    U0,
    U1,
    U2,
    U3,
    U4,
    U5,
    KdTree,
    box_distance,
    leaf_slots,
)


def sphere_counts(tree: KdTree, query: NDArray[np.bool_], radius: int) -> NDArray[np.int64]:
    """Other points nearer than a radius: (n,) int64, counts by row; 0 for others.

    ``query``: (n,) bool, points to count for, by row. ``radius``: radius of the sphere [quanta].
    """
    count = np.zeros(tree.points.shape[1], dtype=np.int64)
    if len(count):
        _spheres(tree.points, tree.boxes, tree.depth, query, float(radius), count)
    return count


def cylinder_counts(
    tree: KdTree, query: NDArray[np.bool_], radius: int, height: int, stop: int
) -> NDArray[np.int64]:
    """Other points in an upright cylinder around each point, up to ``stop``.

    Parameters
    ----------
    query : (n,) bool
        Points to count for, by row.
    radius, height : int
        Of the cylinder, whose centre is the point [quanta].

    Returns
    -------
    (n,) int64
        min(count, stop) by row; 0 for others.
    """
    count = np.zeros(tree.points.shape[1], dtype=np.int64)
    if len(count):
        _cylinders(
            tree.points, tree.boxes, tree.depth, query, float(radius), 0.5 * height, stop, count
        )
    return count


@njit(inline="always")
def _farthest(boxes, node, x, y, z):  # type: ignore[no-untyped-def]
    """Squared distance from a point to the farthest corner of a node's box."""
    dx = max(x - boxes[node, U0], boxes[node, U3] - x)
    dy = max(y - boxes[node, U1], boxes[node, U4] - y)
    dz = max(z - boxes[node, U2], boxes[node, U5] - z)
    return dx * dx + dy * dy + dz * dz


@njit()
def within(points, boxes, depth, x, y, z, limit, stack, levels):  # type: ignore[no-untyped-def]
    """Points nearer to a place than the root of ``limit``; whole nodes are counted at once.

    Parameters
    ----------
    points, boxes, depth
        The tree; the depth as uint64.
    x, y, z : float
        The place [quanta].
    limit : float
        Squared distance, exclusive [quanta2].
    stack, levels : (64,) uint64
        Scratch: nodes to visit, and their levels.
    """
    n = np.uint64(points.shape[1])
    first = U1 << depth
    count = 0
    stack[0], levels[0] = U1, U0
    top = U1
    while top > U0:
        top -= U1
        node, level = stack[top], levels[top]
        if box_distance(boxes, node, x, y, z) >= limit:
            continue
        if _farthest(boxes, node, x, y, z) < limit:
            low, high = leaf_slots(node, level, n)
            count += int(high) - int(low)
        elif node < first:
            stack[top], levels[top] = node + node, level + U1
            stack[top + U1], levels[top + U1] = node + node + U1, level + U1
            top += U1 + U1
        else:
            low, high = leaf_slots(node, depth, n)
            for slot in range(low, high):
                dx, dy, dz = points[U0, slot] - x, points[U1, slot] - y, points[U2, slot] - z
                count += dx * dx + dy * dy + dz * dz < limit
    return count


@njit()
def _spheres(points, boxes, depth, query, radius, count):  # type: ignore[no-untyped-def]
    limit, depth = radius * radius, np.uint64(depth)
    stack, levels = np.empty(64, dtype=np.uint64), np.empty(64, dtype=np.uint64)
    for slot in range(points.shape[1]):
        row = points[3, slot]
        if query[row]:
            x = np.float64(points[0, slot])
            y = np.float64(points[1, slot])
            z = np.float64(points[2, slot])
            count[row] = within(points, boxes, depth, x, y, z, limit, stack, levels) - 1


@njit()
def _outside(boxes, node, x, y, z, limit, half):  # type: ignore[no-untyped-def]
    """Whether a node's box has no point in the cylinder."""
    dx = max(boxes[node, U0] - x, x - boxes[node, U3], 0.0)
    dy = max(boxes[node, U1] - y, y - boxes[node, U4], 0.0)
    dz = max(boxes[node, U2] - z, z - boxes[node, U5])
    return dz >= half or dx * dx + dy * dy >= limit


@njit()
def _in_cylinder(points, boxes, depth, leaf, slot, limit, half, stop, stack):  # type: ignore[no-untyped-def]
    """Points in the cylinder around a slot, from its leaf upwards, up to ``stop``."""
    n = np.uint64(points.shape[1])
    first = U1 << depth
    x = np.float64(points[U0, slot])
    y = np.float64(points[U1, slot])
    z = np.float64(points[U2, slot])
    count = -1
    climb = leaf
    stack[0] = leaf
    while True:
        top = U1
        while top > U0:
            top -= U1
            node = stack[top]
            if _outside(boxes, node, x, y, z, limit, half):
                continue
            if node < first:
                stack[top] = node + node
                stack[top + U1] = node + node + U1
                top += U1 + U1
                continue
            low, high = leaf_slots(node, depth, n)
            for i in range(low, high):
                dx, dy, dz = points[U0, i] - x, points[U1, i] - y, points[U2, i] - z
                count += (dx * dx + dy * dy < limit) & (abs(dz) < half)
            if count >= stop:
                return stop
        if climb <= U1:
            return count
        stack[0] = climb ^ U1
        climb >>= U1


@njit()
def _cylinders(points, boxes, depth, query, radius, half, stop, count):  # type: ignore[no-untyped-def]
    """Every query point in tree order, so that the cache stays warm."""
    n, depth = np.uint64(points.shape[1]), np.uint64(depth)
    stack = np.empty(64, dtype=np.uint64)
    for leaf in range(U1 << depth, U1 << (depth + U1)):
        low, high = leaf_slots(leaf, depth, n)
        for slot in range(low, high):
            row = points[U3, slot]
            if query[row]:
                count[row] = _in_cylinder(
                    points, boxes, depth, leaf, slot, radius * radius, half, stop, stack
                )
