"""Exact neighbours on the integer lattice: a balanced kd-tree without pointers.

A node is a number: the root is 1, the children of ``i`` are ``2 i`` and ``2 i + 1``, and
node ``i`` on level ``l`` holds the slots ``[(j n) >> l, ((j + 1) n) >> l)`` with
``j = i - 2**l``. So leaves hold 16 to 32 points, none is empty, and the only
thing stored besides the points is each node's bounding box.

Squared distances are sums of squared integer differences in float64: exact below
2**53 quanta2, that is up to 50 km. Ties are broken by row, so a query's result depends
on the neighbours alone and neither on the tree nor on what else the table holds.
"""

from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.numerics.compiled import njit
from spl_batch.numerics.neighbours.kdtree_build import arrange

LEAF: Final = 32
"""Most points in a leaf [count]; a power of two."""

CAP_MAX: Final = 46_340
"""Farthest neighbour that a sort key can hold [quanta]: its square stays below 2**31."""

ROW_MASK: Final = 0xFFFF_FFFF
"""Low bits of a sort key: the row. The high ones are the squared distance."""

U0, U1, U2, U3, U4, U5 = (np.uint64(i) for i in range(6))


class KdTree(NamedTuple):
    """Points in tree order."""

    points: NDArray[np.int32]  #: (4, n): x, y, z [quanta] and row of each slot, each contiguous.
    #: (2**(depth + 1), 6): smallest x, y, z and largest x, y, z of each node; node 0 is unused.
    boxes: NDArray[np.int32]
    depth: int

    def by_slot(self, values: NDArray[Any]) -> NDArray[Any]:
        """What (n,) rows have, in tree order."""
        slots: NDArray[Any] = values[self.points[3]]
        return slots

    def by_row(self, values: NDArray[Any]) -> NDArray[Any]:
        """What (n,) slots have, in the order of rows."""
        rows = np.empty_like(values)
        rows[self.points[3]] = values
        return rows


def build(xyz: NDArray[np.int32]) -> KdTree:
    """Put points into tree order.

    ``xyz``: (n, 3) int32, coordinates relative to any anchor [quanta]; n < 2**31.
    """
    n = len(xyz)
    depth = 0
    while (LEAF << depth) < n:
        depth += 1
    boxes = np.zeros((2 << depth, 6), dtype=np.int32)
    points = arrange(xyz, boxes, depth) if n else np.empty((4, 0), np.int32)
    return KdTree(points, boxes, depth)


def check_cap(cap: int) -> None:
    """Refuse a farthest neighbour that is none, or too far.

    Raises
    ------
    ValueError
        If ``cap`` [quanta] is not within 1..:data:`CAP_MAX`.
    """
    if not 0 < cap <= CAP_MAX:
        raise ValueError(f"cap {cap} quanta: must lie in 1..{CAP_MAX}")


@njit(inline="always")
def box_distance(boxes, node, x, y, z):  # type: ignore[no-untyped-def]
    """Squared distance from a point to a node's box, float64 [quanta2]."""
    dx = max(boxes[node, U0] - x, x - boxes[node, U3], 0.0)
    dy = max(boxes[node, U1] - y, y - boxes[node, U4], 0.0)
    dz = max(boxes[node, U2] - z, z - boxes[node, U5], 0.0)
    return dx * dx + dy * dy + dz * dz


@njit(inline="always")
def _scan(points, low, high, x, y, z, row, keys, distance, fresh):  # type: ignore[no-untyped-def]
    """Merge one leaf into the sorted keys, the query's own row left out.

    Distances, then those that may matter, then the sorting-in: two loops without a
    branch before the one that has them.
    """
    size = high - low
    xs, ys, zs, rows = points[0], points[1], points[2], points[3]
    for i in range(size):
        dx = np.float64(xs[low + i]) - x
        dy = np.float64(ys[low + i]) - y
        dz = np.float64(zs[low + i]) - z
        distance[i] = dx * dx + dy * dy + dz * dz
    last = np.uint64(len(keys)) - U1
    limit = np.float64(keys[last] >> 32)
    count = U0
    for i in range(size):
        fresh[count] = (np.int64(distance[i]) << 32) | np.int64(rows[low + i])
        count += np.uint64(distance[i] <= limit)
    for i in range(count):
        key = fresh[i]
        if key >= keys[last] or (key & ROW_MASK) == row:
            continue
        j = last
        while j > U0 and keys[j - U1] > key:
            keys[j] = keys[j - U1]
            j -= U1
        keys[j] = key


@njit(inline="always")
def leaf_slots(leaf, depth, n):  # type: ignore[no-untyped-def]
    """First slot of a leaf and of the next one, as unsigned numbers."""
    j = leaf - (U1 << depth)
    return (j * n) >> depth, ((j + U1) * n) >> depth


@njit(inline="always")
def leaf_of(slot, depth, n):  # type: ignore[no-untyped-def]
    """Node number of the leaf that holds a slot, all as unsigned numbers."""
    return (U1 << depth) + (((slot + U1) << depth) - U1) // n


@njit()
def nearest_keys(points, boxes, depth, leaf, slot, cap, keys, distance, fresh, stack, bound):  # type: ignore[no-untyped-def]
    """Nearest neighbours of one slot, from its own leaf upwards, nearer branches first.

    Indices are unsigned throughout: a signed one costs numba a test for wrapping, and
    the compiler its vector instructions.

    Parameters
    ----------
    points, boxes, depth
        The tree; the depth as uint64.
    leaf, slot : uint64
        Node number of the slot's leaf, and the slot.
    cap : int
        Farthest neighbour, inclusive [quanta].
    keys : (k,) int64
        Receives squared distance << 32 | row, ascending.
    distance, fresh : (LEAF,) float64, (LEAF,) int64
        Scratch: a leaf's squared distances, and the keys that may be sorted in.
    stack, bound : (64,) uint64, (64,) float64
        Scratch: branches put off, and their squared distances.

    Returns
    -------
    int
        Neighbours found, at most k.
    """
    n = np.uint64(points.shape[1])
    first = U1 << depth
    x = np.float64(points[U0, slot])
    y = np.float64(points[U1, slot])
    z = np.float64(points[U2, slot])
    row = points[U3, slot]
    last = np.uint64(len(keys)) - U1
    empty = (np.int64(cap) * np.int64(cap) + 1) << 32
    for i in range(len(keys)):
        keys[i] = empty
    low, high = leaf_slots(leaf, depth, n)
    _scan(points, low, high, x, y, z, row, keys, distance, fresh)
    climb = leaf
    while climb > U1:
        stack[0] = climb ^ U1
        bound[0] = box_distance(boxes, climb ^ U1, x, y, z)
        climb >>= U1
        top = U1
        while top > U0:
            top -= U1
            node, least = stack[top], bound[top]
            while least <= np.float64(keys[last] >> 32):
                if node >= first:
                    low, high = leaf_slots(node, depth, n)
                    _scan(points, low, high, x, y, z, row, keys, distance, fresh)
                    break
                left, right = node + node, node + node + U1
                to_left = box_distance(boxes, left, x, y, z)
                to_right = box_distance(boxes, right, x, y, z)
                if to_right < to_left:
                    stack[top], bound[top] = left, to_left
                    node, least = right, to_right
                else:
                    stack[top], bound[top] = right, to_right
                    node, least = left, to_left
                top += U1
    found = len(keys)
    while found > 0 and keys[found - 1] >= empty:
        found -= 1
    return found
