"""Exact neighbours on the integer lattice: a balanced kd-tree without pointers.

A node is a number: the root is 1, the children of ``i`` are ``2 i`` and ``2 i + 1``, and
node ``i`` on level ``l`` holds the slots ``[(j n) >> l, ((j + 1) n) >> l)`` with
``j = i - 2**l``. So leaves hold 16 to 32 points, none is empty, and the only
thing stored besides the points is each node's bounding box.

Squared distances are sums of squared integer differences in float64: exact below
2**53 quanta2, that is up to 50 km. Ties are broken by row, so a query's result depends
on the neighbours alone and neither on the tree nor on what else the table holds.
"""

import math
from typing import Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

LEAF: Final = 32
"""Most points in a leaf [count]; a power of two."""

MANY: Final = 1000
"""Points from which the middle is found by a sample [count]."""

SAMPLE: Final = 64
"""Points in it [count]."""

CAP_MAX: Final = 46_340
"""Farthest neighbour that a sort key can hold [quanta]: its square stays below 2**31."""

ROW_MASK: Final = 0xFFFF_FFFF
"""Low bits of a sort key: the row. The high ones are the squared distance."""

U0, U1, U2, U3, U4, U5 = (np.uint64(i) for i in range(6))


class KdTree(NamedTuple):
    """Points in tree order.

    Parameters
    ----------
    points : (4, n) int32
        x, y, z [quanta] and row of each slot, each contiguous.
    boxes : (2**(depth + 1), 6) int32
        Smallest x, y, z and largest x, y, z of each node; node 0 is unused.
    depth : int
        Level of the leaves.
    """

    points: NDArray[np.int32]
    boxes: NDArray[np.int32]
    depth: int


def build(xyz: NDArray[np.int32]) -> KdTree:
    """Put points into tree order.

    Parameters
    ----------
    xyz : (n, 3) int32
        Coordinates relative to any anchor [quanta]; n < 2**31.

    Returns
    -------
    KdTree
    """
    n = len(xyz)
    depth = 0
    while (LEAF << depth) < n:
        depth += 1
    points = np.empty((n, 4), dtype=np.int32)
    points[:, :3] = xyz
    points[:, 3] = np.arange(n, dtype=np.int32)
    boxes = np.zeros((2 << depth, 6), dtype=np.int32)
    if n:
        _arrange(points, boxes, depth)
    # Searches read whole vectors: a few values beyond the last are there, and not used.
    spare = np.zeros(4 * n + 8, np.int32)
    by_column = spare[: 4 * n].reshape(4, n)
    by_column[:] = points.T
    return KdTree(by_column, boxes, depth)


def check_cap(cap: int) -> None:
    """Refuse a farthest neighbour that is none, or too far.

    Raises
    ------
    ValueError
        If ``cap`` [quanta] is not within 1..:data:`CAP_MAX`.
    """
    if not 0 < cap <= CAP_MAX:
        raise ValueError(f"cap {cap} quanta: must lie in 1..{CAP_MAX}")


@njit(nogil=True, cache=True)
def _pivot(points, low, high, middle, axis, sample):  # type: ignore[no-untyped-def]
    """A value to divide slots ``low`` to ``high`` at, so that ``middle`` is in the smaller part.

    Where there are many it is taken from a sample, a bit farther than the rank of the middle
    [Floyd and Rivest, Communications of the ACM 18, 1975].
    """
    size = high - low + 1
    if size < MANY:
        a, b, c = points[low, axis], points[(low + high) >> 1, axis], points[high, axis]
        return max(min(a, b), min(max(a, b), c))
    for i in range(SAMPLE):
        value, at = points[low + (2 * i + 1) * size // (2 * SAMPLE), axis], i
        while at > 0 and sample[at - 1] > value:
            sample[at] = sample[at - 1]
            at -= 1
        sample[at] = value
    share = (middle - low) / size
    aside = 2.0 * math.sqrt(share * (1.0 - share) / SAMPLE)
    if share < 0.3:
        share += aside
    elif share > 0.7:
        share -= aside
    return sample[min(int(share * SAMPLE), SAMPLE - 1)]


@njit(nogil=True, cache=True)
def _select(points, low, high, middle, axis, sample):  # type: ignore[no-untyped-def]
    """Quickselect: slot ``middle`` gets its value in order along ``axis``, smaller ones before."""
    high -= 1
    while low < high:
        pivot = _pivot(points, low, high, middle, axis, sample)
        i, j = low, high
        while i <= j:
            while points[i, axis] < pivot:
                i += 1
            while points[j, axis] > pivot:
                j -= 1
            if i <= j:
                for field in range(4):
                    keep = points[i, field]
                    points[i, field] = points[j, field]
                    points[j, field] = keep
                i += 1
                j -= 1
        if middle <= j:
            high = j
        elif middle >= i:
            low = i
        else:
            return


@njit(nogil=True, cache=True)
def _arrange(points, boxes, depth):  # type: ignore[no-untyped-def]
    """Split every node at its middle slot along its widest axis, depth first."""
    n = len(points)
    stack, sample = np.empty(64, dtype=np.int64), np.empty(SAMPLE, dtype=np.int32)
    stack[0] = 1
    top = 1
    while top > 0:
        top -= 1
        node = stack[top]
        level = 0
        while (node >> level) > 1:
            level += 1
        j = node - (1 << level)
        low, high = (j * n) >> level, ((j + 1) * n) >> level
        x0, y0, z0 = x1, y1, z1 = points[low, 0], points[low, 1], points[low, 2]
        for i in range(low + 1, high):
            x, y, z = points[i, 0], points[i, 1], points[i, 2]
            x0, y0, z0 = min(x0, x), min(y0, y), min(z0, z)
            x1, y1, z1 = max(x1, x), max(y1, y), max(z1, z)
        boxes[node, 0], boxes[node, 1], boxes[node, 2] = x0, y0, z0
        boxes[node, 3], boxes[node, 4], boxes[node, 5] = x1, y1, z1
        if level == depth:
            continue
        axis, width = 0, np.int64(-1)
        for a in range(3):
            spread = np.int64(boxes[node, a + 3]) - np.int64(boxes[node, a])
            if spread > width:
                axis, width = a, spread
        if width > 0:
            _select(points, low, high, ((2 * j + 1) * n) >> (level + 1), axis, sample)
        stack[top] = 2 * node + 1
        stack[top + 1] = 2 * node
        top += 2


@njit(nogil=True, cache=True, inline="always")
def box_distance(boxes, node, x, y, z):  # type: ignore[no-untyped-def]
    """Squared distance from a point to a node's box, float64 [quanta2]."""
    dx = max(boxes[node, U0] - x, x - boxes[node, U3], 0.0)
    dy = max(boxes[node, U1] - y, y - boxes[node, U4], 0.0)
    dz = max(boxes[node, U2] - z, z - boxes[node, U5], 0.0)
    return dx * dx + dy * dy + dz * dz


@njit(nogil=True, cache=True, inline="always")
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


@njit(nogil=True, cache=True, inline="always")
def leaf_slots(leaf, depth, n):  # type: ignore[no-untyped-def]
    """First slot of a leaf and of the next one, as unsigned numbers."""
    j = leaf - (U1 << depth)
    return (j * n) >> depth, ((j + U1) * n) >> depth


@njit(nogil=True, cache=True, inline="always")
def leaf_of(slot, depth, n):  # type: ignore[no-untyped-def]
    """Node number of the leaf that holds a slot, all as unsigned numbers."""
    return (U1 << depth) + (((slot + U1) << depth) - U1) // n


@njit(nogil=True, cache=True)
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
    keys[:] = empty
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
