"""Count in the adaptive ellipsoid over the count in the sphere of its volume [W17 5.2.2].

With n_s other points nearer than the radius and n_e of them inside the ellipsoid, a point stays if
n_e >= ratio n_s > 0. The count in the ellipsoid stops where that is decided.
"""

import math

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.filter.ellipsoid.ellipsoid_shape import (
    Shape,
    covariance,
    fit,
    flag,
    half_extents,
    lone_body,
    no_bodies,
    offsets,
)
from spl_batch.airborne.filter.ellipsoid.ellipsoid_walk import walk
from spl_batch.airborne.filter.ellipsoid.spacing import Spacing, spacing_scratch
from spl_batch.numerics.compiled import njit
from spl_batch.numerics.neighbours.kdtree import (
    LEAF,
    U0,
    U1,
    U2,
    U3,
    U4,
    U5,
    KdTree,
    box_distance,
    check_cap,
    leaf_slots,
)
from spl_batch.numerics.neighbours.nearest import edges_of_leaves, neighbours_of_leaves

NO_SPACING = Spacing(1, 1)
"""Every neighbour counts, whatever its spacing."""


def passes_ratio(
    xyz: NDArray[np.int32], tree: KdTree, query: NDArray[np.bool_], shape: Shape, ratio: float
) -> NDArray[np.bool_]:
    """Which points have a large enough share of their sphere's count in their ellipsoid.

    Parameters
    ----------
    xyz : (n, 3) int32
        Coordinates relative to any anchor [quanta], rows in canonical order.
    query : (n,) bool
        Points to decide.

    Returns
    -------
    (n,) bool
        False for points that were not asked for.
    """
    check_cap(shape.neighbour_cap)
    keep = np.zeros(len(xyz), dtype=np.bool_)
    if len(xyz):
        _ratios(tree.points, tree.boxes, tree.depth, query, shape, ratio, NO_SPACING, keep)
    return keep


@njit()
def _ratios(points, boxes, depth, query, shape, ratio, rule, keep):  # type: ignore[no-untyped-def]
    """Every query point in tree order, so that the cache stays warm."""
    n, depth = np.uint64(points.shape[1]), np.uint64(depth)
    edges = edges_of_leaves(boxes, depth)
    near, bodies = np.empty((1, 3, shape.neighbours)), no_bodies()
    stack, levels = np.empty(64, dtype=np.uint64), np.empty(64, dtype=np.uint64)
    quadric, axes, half, outer = np.empty(6), np.empty(3), np.empty(3), np.empty(1)
    vectors = np.empty((3, 3))
    asked, others = np.empty(LEAF, np.bool_), np.empty((LEAF, shape.neighbours), np.int32)
    found, last, few = np.empty(LEAF, np.int64), np.empty(LEAF), np.empty(LEAF)
    sphere = np.empty(LEAF, np.int64)
    space, spare = np.zeros(points.shape[1]), spacing_scratch(rule)
    limit = shape.radius * shape.radius
    for leaf in range(U1 << depth, U1 << (depth + U1)):
        low, high = leaf_slots(leaf, depth, n)
        for at in range(high - low):
            asked[at] = query[points[U3, low + at]]
            if asked[at]:
                x = np.float64(points[U0, low + at])
                y = np.float64(points[U1, low + at])
                z = np.float64(points[U2, low + at])
                sphere[at] = _within(points, boxes, depth, x, y, z, limit, stack, levels) - 1
                asked[at] = sphere[at] > 0
        neighbours_of_leaves(
            points, boxes, edges, depth, (leaf, leaf + U1), asked, shape.neighbours,
            shape.neighbour_cap, 0, others, found, last, few,
        )  # fmt: skip
        for slot in range(low, high):
            at = slot - low
            if not asked[at]:
                continue
            stop = np.int64(math.ceil(ratio * sphere[at]))
            offsets(points, slot, others, at, found[at], near, U0)
            covariance(near, U0, found[at], bodies.moments, U0)
            bodies.found[0] = found[at]
            fit(bodies, shape)
            lone_body(bodies, U0, quadric, vectors, axes)
            inside = 0
            for i in range(found[at]):
                inside += flag(quadric, near[0, 0, i], near[0, 1, i], near[0, 2, i]) < 1.0
            if inside < stop:
                half_extents(vectors, axes, half)
                inside = walk(
                    points, boxes, depth, leaf, slot, quadric, vectors, axes, half, stop, stack,
                    space, rule, 1.0, spare, outer,
                )  # fmt: skip
            keep[points[U3, slot]] = inside >= stop


@njit(inline="always")
def _farthest(boxes, node, x, y, z):  # type: ignore[no-untyped-def]
    """Squared distance from a point to the farthest corner of a node's box."""
    dx = max(x - boxes[node, U0], boxes[node, U3] - x)
    dy = max(y - boxes[node, U1], boxes[node, U4] - y)
    dz = max(z - boxes[node, U2], boxes[node, U5] - z)
    return dx * dx + dy * dy + dz * dz


@njit()
def _within(points, boxes, depth, x, y, z, limit, stack, levels):  # type: ignore[no-untyped-def]
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
