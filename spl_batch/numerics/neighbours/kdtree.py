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
from spl_batch.numerics.simd import LANES, UL, ascending, load, number, pack, spread

LEAF: Final = 32
"""Most points in a leaf [count]; a power of two."""

CAP_MAX: Final = 46_340
"""Farthest neighbour that can be asked for [quanta]: its square stays below 2**31."""

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
def leaf_slots(leaf, depth, n):  # type: ignore[no-untyped-def]
    """First slot of a leaf and of the next one, as unsigned numbers."""
    j = leaf - (U1 << depth)
    return (j * n) >> depth, ((j + U1) * n) >> depth


@njit(inline="always")
def leaf_of(slot, depth, n):  # type: ignore[no-untyped-def]
    """Node number of the leaf that holds a slot, all as unsigned numbers."""
    return (U1 << depth) + (((slot + U1) << depth) - U1) // n


@njit()
def sort_in(nearest, d2):  # type: ignore[no-untyped-def]
    """Insert a squared distance among the nearest in order; the last one goes."""
    j = len(nearest) - 1
    while j > 0 and nearest[j - 1] > d2:
        nearest[j] = nearest[j - 1]
        j -= 1
    nearest[j] = d2


def search_room(count: int) -> tuple[NDArray[Any], ...]:
    """Scratch of :func:`nth_distance`: so many distances, branches put off, part of a leaf."""
    return np.empty(count), np.empty(64, np.uint64), np.empty(LANES), np.empty(LANES, np.uint64)


@njit()
def nth_distance(points, boxes, depth, node, x, y, z, limit, wide, least, room):  # type: ignore[no-untyped-def]
    """Squared distance from a point to the n-th nearest point, infinite if there are fewer.

    Parameters
    ----------
    points, boxes, depth
        The tree; the depth as uint64.
    node : uint64
        Where the search begins, to go on upwards: the point's leaf, or the root.
    x, y, z : float
        The point [quanta].
    limit : float
        Farthest squared distance, inclusive.
    wide, least : (n,) float64, float
        Points whose value, by slot, is below ``least`` do not count.
    room
        :func:`search_room` of n.
    """
    nearest, stack, near_by, slots = room
    n, first = np.uint64(points.shape[1]), U1 << depth
    last = len(nearest) - 1
    for k in range(len(nearest)):
        nearest[k] = np.inf
    stack[0] = climb = node
    while True:
        top = U1
        while top > U0:
            top -= U1
            node = stack[top]
            if box_distance(boxes, node, x, y, z) > min(limit, nearest[last]):
                continue
            if node < first:
                near = node + node
                near += np.uint64(
                    box_distance(boxes, near + U1, x, y, z) < box_distance(boxes, near, x, y, z)
                )
                stack[top], stack[top + U1] = near ^ U1, near  # the nearer one is next
                top += U1 + U1
                continue
            low, high = leaf_slots(node, depth, n)
            for begin in range(low, high, UL):
                dx = load(points, (U0, begin)) - spread(x)
                dy = load(points, (U1, begin)) - spread(y)
                dz = load(points, (U2, begin)) - spread(z)
                away = dx * dx + dy * dy + dz * dz
                some = (away <= spread(limit)) & (away < spread(nearest[last]))
                some = some & (ascending(begin) < spread(high))
                pack(near_by, U0, away, some)
                pack(slots, U0, ascending(begin), some)
                for k in range(number(some)):
                    if near_by[k] >= nearest[last] or wide[slots[k]] < least:
                        continue
                    sort_in(nearest, near_by[k])
        if climb <= U1:
            return nearest[last]
        stack[0] = climb ^ U1
        climb >>= U1
