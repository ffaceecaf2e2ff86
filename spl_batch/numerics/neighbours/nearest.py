"""Nearest neighbours on the integer lattice, exact and in no particular order.

1. The points of a leaf of the tree are taken one after the other. Within which distance one has
   enough follows from one beside it: its neighbours, and how far it is. Nearly always less is
   enough, and is tried first. The first of a table look among the points of an ancestor of their
   leaf, which lie side by side.
2. The leaves within that distance of the whole leaf are listed once, and each point looks at
   those of the list that it reaches. One that is far from the others, such as noise above a
   surface, whose list would be long, walks the tree from its leaf upwards instead.
3. When many are found, the nearest are kept and the distance shrinks
   (:mod:`~spl_batch.numerics.neighbours.nearest_selection`).

:func:`~spl_batch.numerics.neighbours.kdtree.nth_distance` sorts each distance in as it is met, for
one point. Here nothing is sorted: distances and counts are loops without a branch, which the
compiler turns into vector instructions.

Squared distances are sums of squared integer differences in float64: exact below
2**53 quanta2, that is up to 50 km. Ties are broken by row, so a query's neighbours depend
on the points alone and neither on the tree nor on what else the table holds.
"""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

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
    leaf_slots,
)
from spl_batch.numerics.neighbours.nearest_selection import distance_to, keep_nearest, largest
from spl_batch.numerics.neighbours.search_bounds import BESIDE, first_limits
from spl_batch.numerics.simd import LANES, UL, ascending, greater, load, number, pack, spread

CROWD: Final = 96
"""Points within the distance, beside k, beyond which it is made to shrink [count]."""

LISTED: Final = 128
"""Most leaves in a list; where there are more, points walk the tree [count]."""

MARGIN: Final = 1.25
"""Squared distance of a list over that of the point for which it is made: for those after it."""

FAR: Final = 1e18
"""Farther than anything [quanta]."""


def edges_of_leaves(tree: KdTree) -> NDArray[np.int32]:
    """Boxes of the leaves, each of their six numbers side by side: (6, m) int32, m > leaves."""
    leaves = 1 << tree.depth
    edges = np.zeros((6, leaves + LANES), np.int32)
    edges[:, :leaves] = tree.boxes[leaves:].T
    return edges


@njit()
def _list_eight(edges, begin, end, box, reach2, listed, numbers, sides):  # type: ignore[no-untyped-def]
    """List those of up to eight leaves within a squared distance of a box; how many are listed."""
    none = spread(0.0)
    x0, y0, z0 = load(edges, (U0, begin)), load(edges, (U1, begin)), load(edges, (U2, begin))
    x1, y1, z1 = load(edges, (U3, begin)), load(edges, (U4, begin)), load(edges, (U5, begin))
    dx = greater(greater(x0 - spread(box[U3]), spread(box[U0]) - x1), none)
    dy = greater(greater(y0 - spread(box[U4]), spread(box[U1]) - y1), none)
    dz = greater(greater(z0 - spread(box[U5]), spread(box[U2]) - z1), none)
    leaves = ascending(begin)
    taken = (dx * dx + dy * dy + dz * dz <= spread(reach2)) & (leaves < spread(end))
    pack(numbers, listed, leaves, taken)
    pack(sides, (U0, listed), x0, taken)
    pack(sides, (U1, listed), y0, taken)
    pack(sides, (U2, listed), z0, taken)
    pack(sides, (U3, listed), x1, taken)
    pack(sides, (U4, listed), y1, taken)
    pack(sides, (U5, listed), z1, taken)
    return listed + number(taken)


@njit()
def _list_leaves(points, boxes, edges, depth, leaf, reach2, stack, box, numbers, slots, sides):  # type: ignore[no-untyped-def]
    """List the leaves within a squared distance of a leaf's box, those beside it first.

    ``slots`` (2, m) receives their first slots and those of the next ones, ``sides`` (6, m) their
    boxes, m being eight more than are listed at most. Returns how many there are, 0 where they are
    too many. The last three levels of the tree are looked at at once.
    """
    n, first = np.uint64(points.shape[1]), U1 << depth
    below = min(depth, U3)
    eights = first >> below
    for i in range(6):
        box[i] = boxes[leaf, i]
    listed, climb = U0, leaf >> below
    stack[0] = climb
    while True:
        top = U1
        while top > U0:
            top -= U1
            node = stack[top]
            if node >= eights:
                begin = (node << below) - first
                end = begin + (U1 << below)
                listed = _list_eight(edges, begin, end, box, reach2, listed, numbers, sides)
                if listed > np.uint64(LISTED):
                    return U0
                continue
            dx = max(boxes[node, U0] - box[U3], box[U0] - boxes[node, U3], 0.0)
            dy = max(boxes[node, U1] - box[U4], box[U1] - boxes[node, U4], 0.0)
            dz = max(boxes[node, U2] - box[U5], box[U2] - boxes[node, U5], 0.0)
            if dx * dx + dy * dy + dz * dz > reach2:
                continue
            stack[top] = node + node
            stack[top + U1] = node + node + U1
            top += U1 + U1
        if climb <= U1:
            break
        stack[0] = climb ^ U1
        climb >>= U1
    for i in range(listed):
        slots[U0, i], slots[U1, i] = leaf_slots(first + numbers[i], depth, n)
    return listed


@njit(inline="always")
def _add(points, low, high, slot, x, y, z, limit, near, kept, size):  # type: ignore[no-untyped-def]
    """Add a leaf's points within a squared distance of a slot, itself left out: their number."""
    for first in range(low, high, UL):
        dx = load(points, (U0, first)) - spread(x)
        dy = load(points, (U1, first)) - spread(y)
        dz = load(points, (U2, first)) - spread(z)
        distance, slots = dx * dx + dy * dy + dz * dz, ascending(first)
        taken = (distance <= spread(limit)) & (slots < spread(high)) & (slots != spread(slot))
        pack(near, size, distance, taken)
        pack(kept, size, slots, taken)
        size += number(taken)
    return size


@njit(inline="always")
def _from_list(  # type: ignore[no-untyped-def]
    points, slot, k, limit, x, y, z, slots, sides, listed, reached, near, kept,
):  # fmt: skip
    """Neighbours of a slot among the leaves of a list: number, squared distance of the last."""
    reach, none = U0, spread(0.0)
    for i in range(U0, listed, UL):
        dx = load(sides, (U0, i)) - spread(x)
        dx = greater(greater(dx, spread(x) - load(sides, (U3, i))), none)
        dy = load(sides, (U1, i)) - spread(y)
        dy = greater(greater(dy, spread(y) - load(sides, (U4, i))), none)
        dz = load(sides, (U2, i)) - spread(z)
        dz = greater(greater(dz, spread(z) - load(sides, (U5, i))), none)
        leaves = ascending(i)
        taken = (dx * dx + dy * dy + dz * dz <= spread(limit)) & (leaves < spread(listed))
        pack(reached, reach, leaves, taken)
        reach += number(taken)
    size, full = U0, np.uint64(k + CROWD)
    for j in range(reach):
        i = reached[j]
        size = _add(points, slots[U0, i], slots[U1, i], slot, x, y, z, limit, near, kept, size)
        if size > full:
            size = keep_nearest(points, near, kept, size, k, limit)
            limit = largest(near, size)
    if size > np.uint64(k):
        size = keep_nearest(points, near, kept, size, k, limit)
    return np.int64(size), largest(near, size)


@njit(inline="always")
def _from_tree(  # type: ignore[no-untyped-def]
    points, boxes, depth, leaf, slot, k, limit, x, y, z, stack, near, kept
):
    """Neighbours of a slot, from its leaf upwards: number, squared distance of the last."""
    n, first = np.uint64(points.shape[1]), U1 << depth
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
            size = _add(points, low, high, slot, x, y, z, limit, near, kept, size)
            if size > full:
                size = keep_nearest(points, near, kept, size, k, limit)
                limit = largest(near, size)
        if climb <= U1:
            break
        stack[0] = climb ^ U1
        climb >>= U1
    if size > np.uint64(k):
        size = keep_nearest(points, near, kept, size, k, limit)
    return np.int64(size), largest(near, size)


@njit()
def neighbours_of_leaves(  # type: ignore[no-untyped-def]  # noqa: C901
    points, boxes, edges, depth, leaves, asked, k, cap, wanted, others, found, last, few
):
    """Nearest neighbours of the points asked for of some leaves.

    Indices are unsigned throughout: a signed one costs numba a test for wrapping, and
    the compiler its vector instructions.

    Parameters
    ----------
    points, boxes, edges, depth
        The tree, with what :func:`edges_of_leaves` makes of it; the depth as uint64.
    leaves : (2,) uint64
        Node numbers of the first leaf, and of the one after the last.
    asked : (m,) bool
        By slot, from the first leaf's first on, as are all that follow.
    k : int
        Neighbours [count].
    cap : int
        Farthest neighbour, inclusive [quanta].
    wanted : int
        A neighbour whose distance is of interest, at most k; 0 for none.
    others : (m, k) int32
        Receives the slots of the neighbours.
    found : (m,) int64
        Receives the neighbours found, at most k.
    last, few : (m,) float64
        Receive the squared distances of the farthest of them, 0 without any, and of neighbour
        ``wanted``, negative where there are fewer [quanta2].
    """
    n = np.uint64(points.shape[1])
    room = np.uint64(k + CROWD + LEAF + LANES)
    distance, near, kept = (
        np.empty(8 * k + 16 + 2 * LEAF),
        np.empty(room),
        np.empty(room, np.uint64),
    )
    slots, sides = np.empty((2, LISTED), np.uint64), np.zeros((6, LISTED + LANES))
    box, numbers = np.empty(6), np.empty(LISTED + LANES, np.uint64)
    stack, beside = np.empty(64, np.uint64), np.zeros((4, BESIDE))
    reached = np.empty(LISTED + LANES, np.uint64)
    for other in range(BESIDE):
        beside[3, other] = FAR
    start, _ = leaf_slots(leaves[0], depth, n)
    turn = U0
    for leaf in range(leaves[0], leaves[1]):
        low, high = leaf_slots(leaf, depth, n)
        listed, reach2, too_far = U0, -1.0, np.inf
        for slot in range(low, high):
            at = slot - start
            if not asked[at]:
                continue
            x, y, z = (
                np.float64(points[U0, slot]),
                np.float64(points[U1, slot]),
                np.float64(points[U2, slot]),
            )
            limit, most = first_limits(points, depth, leaf, slot, k, cap, beside, distance)
            while True:
                if reach2 < limit < too_far:
                    reach2 = MARGIN * limit
                    listed = _list_leaves(
                        points, boxes, edges, depth, leaf, reach2, stack, box, numbers, slots,
                        sides,
                    )  # fmt: skip
                    if listed == U0:
                        reach2, too_far = -1.0, limit
                if limit <= reach2:
                    found[at], last[at] = _from_list(
                        points, slot, k, limit, x, y, z, slots, sides, listed, reached, near,
                        kept,
                    )  # fmt: skip
                else:
                    found[at], last[at] = _from_tree(
                        points, boxes, depth, leaf, slot, k, limit, x, y, z, stack, near, kept,
                    )  # fmt: skip
                if found[at] == k or limit == most:
                    break
                limit = most
            for i in range(found[at]):
                others[at, i] = kept[i]
            few[at] = -1.0
            if 0 < wanted <= found[at]:
                few[at] = distance_to(near, np.uint64(found[at]), wanted)
            beside[U0, turn], beside[U1, turn], beside[U2, turn] = x, y, z
            beside[U3, turn] = math.sqrt(last[at]) if found[at] == k else FAR
            turn = (turn + U1) % np.uint64(BESIDE)
