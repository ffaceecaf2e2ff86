"""Walk of the tree for the peers inside one ellipsoid, from its centre's leaf upwards."""

import numpy as np

from spl_batch.airborne.filter.ellipsoid.ellipsoid_shape import flag
from spl_batch.airborne.filter.ellipsoid.spacing import spacing_at
from spl_batch.numerics.compiled import njit
from spl_batch.numerics.neighbours.kdtree import U0, U1, U2, U3, U4, U5, leaf_of, leaf_slots


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


@njit()
def measure(points, boxes, depth, slot, space, rule, scratch):  # type: ignore[no-untyped-def]
    """Find out a slot's spacing."""
    keys, distance, fresh, stack, bound = scratch
    leaf = leaf_of(slot, depth, np.uint64(points.shape[1]))
    space[slot] = spacing_at(
        points, boxes, depth, leaf, slot, rule, keys, distance, fresh, stack, bound
    )
