r"""Neighbours inside each point's adaptive ellipsoid [W18 Eq. 3-8; W17 Eq. 5.4-5.6, 6.3-6.5].

============ ================================================================
symbol       name
============ ================================================================
e_1..e_3     ``values``: eigenvalues of the neighbours' covariance [m2]
a, b, c      ``axes``: semi-axes r e_i / cbrt(e_1 e_2 e_3) [m]
r            ``radius``: radius of the sphere of equal volume [m]
P            ``vectors``: eigenvectors, as rows
flag         ``_flag``: below 1 inside
k            ``count``: peers inside, the query point excluded
rho v        ``expected``: noise density times volume
============ ================================================================

Deviations: eigenvalues are floored (coincident and collinear neighbours have none);
the long axis is capped, and the volume that is tested is that of the capped ellipsoid,
the one that is counted in; with fewer than four neighbours within reach there is no
shape to speak of, and the sphere is used; where spacings are given, only peers count
(:mod:`spl_batch.kernels.spacing`).

A count is discrete. With ``tie`` the score puts a point between the tails of its count and of
the next by where the outermost of the k inside lies: for k points strewn evenly in an ellipsoid

.. math:: s = P(K > k) + u\,P(K = k), \quad u = (\max_i f_i)^{3 k / 2}

is uniform, with f the flags of Eq. 5; a signal's are nearer the middle.

Counting stops at the critical count. Most points never walk the tree: the critical
count is reached among the neighbours that shaped the ellipsoid, or the ellipsoid
reaches no farther than they do.
"""

import math
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spl_batch.kernels.ellipsoid_shape import Shape, fit, flag, half_extents, quadric_of
from spl_batch.kernels.kdtree import (
    LEAF,
    U0,
    U1,
    U2,
    U3,
    U4,
    U5,
    KdTree,
    check_cap,
    leaf_of,
    leaf_slots,
)
from spl_batch.kernels.neighbours import distance_to, nearest_slots, workspace
from spl_batch.kernels.poisson import poisson_critical, poisson_tail
from spl_batch.kernels.spacing import Spacing, spacing_at, spacing_scratch

CHUNK: Final = 2048
"""Leaves whose neighbours are kept at a time, so that their spacings come with them [count]."""


def count_inside(
    xyz: NDArray[np.int32],
    tree: KdTree,
    query: NDArray[np.bool_],
    density: NDArray[np.float64],
    shape: Shape,
    *,
    alpha: float | NDArray[np.float64],
    spacing: NDArray[np.float64] | None = None,
    rule: Spacing = Spacing(1, 1),  # noqa: B008 - a tuple
    peer_ratio: float = 1.0,
    tie: bool = False,
) -> tuple[NDArray[np.int32], NDArray[np.float64], NDArray[np.float64]]:
    """Count neighbours inside adaptive ellipsoids, up to the critical count.

    Parameters
    ----------
    xyz : (n, 3) int32
        Coordinates relative to any anchor [quanta], rows in canonical order.
    tree : KdTree
        The same points.
    query : (n,) bool
        Points to count for.
    density : (n,) float64
        Expected noise at each point [1/quanta3].
    shape : Shape
        How neighbours become an ellipsoid.
    alpha : float or (n,) float64
        Counting stops at the smallest k with P(K >= k | lambda) <= alpha of the point.
    spacing : (n,) float64, optional
        Squared spacing at each point [quanta2]; without it every neighbour is a peer.
        What is negative is not known yet: it is found out and filled in where needed, at
        query points at least.
    rule : Spacing
        What a spacing is that is not known yet.
    peer_ratio : float
        Only peers are counted: neighbours whose spacing is at least that of the point
        divided by this; >= 1.
    tie : bool
        Break the ties of counts.

    Returns
    -------
    count : (n,) int32
        min(k, critical count) of query points, 0 for others [count].
    expected : (n,) float64
        Noise points expected inside [count].
    tail : (n,) float64
        P(K >= count | expected) of query points, 1 for others; with ``tie`` the score s
        where the count is below the critical one.
    """
    check_cap(shape.neighbour_cap)
    check_cap(rule.cap)
    count = np.zeros(len(xyz), dtype=np.int32)
    expected = np.zeros(len(xyz), dtype=np.float64)
    tail = np.ones(len(xyz), dtype=np.float64)
    if spacing is None:
        spacing = np.zeros(len(xyz), dtype=np.float64)
    if len(xyz):
        ratio2 = peer_ratio * peer_ratio
        limit = np.broadcast_to(np.asarray(alpha, dtype=np.float64), (len(xyz),))
        space = spacing[tree.points[3]]
        _count_all(
            *tree, query, density, shape, np.ascontiguousarray(limit), space, rule, ratio2, tie,
            count, expected, tail,
        )  # fmt: skip
        spacing[tree.points[3]] = space
    return count, expected, tail


@njit(nogil=True, cache=True)
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


@njit(nogil=True, cache=True)
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
                    _measure(points, boxes, depth, i, space, rule, scratch)
                if space[i] * ratio2 >= least:
                    count += 1
                    outer[0] = max(outer[0], outside)
            if count >= stop:
                return stop
        if climb <= U1:
            return count
        stack[0] = climb ^ U1
        climb >>= U1


@njit(nogil=True, cache=True)
def _measure(points, boxes, depth, slot, space, rule, scratch):  # type: ignore[no-untyped-def]
    """Find out a slot's spacing."""
    keys, distance, fresh, stack, bound = scratch
    leaf = leaf_of(slot, depth, np.uint64(points.shape[1]))
    space[slot] = spacing_at(
        points, boxes, depth, leaf, slot, rule, keys, distance, fresh, stack, bound
    )


@njit(nogil=True, cache=True)
def _among(  # type: ignore[no-untyped-def]
    points, boxes, depth, near, others, at, found, quadric, least, space, rule, ratio2, scratch,
    outer,
):  # fmt: skip
    """Peers inside among the neighbours that shaped the ellipsoid."""
    count = 0
    outer[0] = 0.0
    for i in range(found):
        near[3, i] = flag(quadric, near[0, i], near[1, i], near[2, i])
    for i in range(found):
        outside = near[3, i]
        if outside >= 1.0:
            continue
        other = np.uint64(others[at, i])
        if space[other] < 0.0:
            _measure(points, boxes, depth, other, space, rule, scratch)
        if space[other] * ratio2 >= least:
            count += 1
            outer[0] = max(outer[0], outside)
    return count


@njit(nogil=True, cache=True)
def _score(inside, mean, outermost, tie):  # type: ignore[no-untyped-def]
    """Tail of a count; with ``tie`` between it and the next by the outermost point inside."""
    tail = poisson_tail(inside, mean)
    if not tie or inside == 0:
        return tail
    more = poisson_tail(inside + 1, mean)
    return more + outermost ** (1.5 * inside) * (tail - more)


@njit(nogil=True, cache=True)
def _neighbours(points, boxes, depth, leaves, query, shape, space, rule, others, found, last):  # type: ignore[no-untyped-def]
    """Neighbours of the query points of some leaves, with the spacings that come with them.

    ``others`` (m, k), ``found`` (m,) and ``last`` (m,) receive the slots of the neighbours,
    their number and the squared distance of the farthest, from the first leaf's first slot on.
    """
    n, k = np.uint64(points.shape[1]), shape.neighbours
    distance, near, kept, stack = workspace(k)
    wide = np.float64(rule.cap) * np.float64(rule.cap)
    shared = rule.neighbours <= k and rule.cap <= shape.neighbour_cap
    start, _ = leaf_slots(leaves[0], depth, n)
    for leaf in range(leaves[0], leaves[1]):
        low, high = leaf_slots(leaf, depth, n)
        for slot in range(low, high):
            if not query[points[U3, slot]]:
                continue
            at = slot - start
            found[at], last[at] = nearest_slots(
                points, boxes, depth, leaf, slot, k, shape.neighbour_cap, distance, near, kept,
                stack,
            )  # fmt: skip
            for i in range(found[at]):
                others[at, i] = kept[i]
            if shared and space[slot] < 0.0:
                space[slot] = wide
                if found[at] >= rule.neighbours:
                    few = distance_to(near, np.uint64(found[at]), rule.neighbours)
                    space[slot] = min(few, wide)


@njit(nogil=True, cache=True)
def _count_all(  # type: ignore[no-untyped-def]
    points, boxes, depth, query, density, shape, alpha, space, rule, ratio2, tie,
    count, expected, tail,
):  # fmt: skip
    """Every query point in tree order, so that the cache stays warm."""
    n, depth = np.uint64(points.shape[1]), np.uint64(depth)
    leaves, chunk = U1 << depth, np.uint64(CHUNK)
    room = min(chunk, leaves) * np.uint64(LEAF)
    others = np.empty((room, shape.neighbours), dtype=np.int32)
    found, last = np.empty(room, dtype=np.int64), np.empty(room, dtype=np.float64)
    near = np.empty((4, shape.neighbours), dtype=np.float64)
    stack = np.empty(64, dtype=np.uint64)
    moments, quadric = np.empty(6), np.empty(6)
    values, axes, half, outer = np.empty(3), np.empty(3), np.empty(3), np.empty(1)
    vectors = np.empty((3, 3))
    spare = spacing_scratch(rule)
    cap = shape.neighbour_cap
    known, asked, stop, least = -1.0, -1.0, 1, 1.0
    for begin in range(leaves, leaves + leaves, chunk):
        end = min(begin + chunk, leaves + leaves)
        _neighbours(
            points, boxes, depth, (begin, end), query, shape, space, rule, others, found, last
        )
        low, _ = leaf_slots(begin, depth, n)
        _, high = leaf_slots(end - U1, depth, n)
        for slot in range(low, high):
            row = points[U3, slot]
            if not query[row]:
                continue
            if space[slot] < 0.0:
                _measure(points, boxes, depth, slot, space, rule, spare)
            at = slot - low
            volume = fit(
                points, slot, others, at, found[at], near, shape, moments, values, vectors, axes,
            )  # fmt: skip
            mean = density[row] * volume
            expected[row] = mean
            if mean != known or alpha[row] != asked:
                known, asked = mean, alpha[row]
                stop, least = poisson_critical(mean, asked, stop)
            quadric_of(vectors, axes, quadric)
            inside = _among(
                points, boxes, depth, near, others, at, found[at], quadric, space[slot], space,
                rule, ratio2, spare, outer,
            )  # fmt: skip
            reach = float(cap)
            if found[at] == shape.neighbours:
                reach = math.sqrt(last[at])
            if inside < stop and axes[0] > reach:
                half_extents(vectors, axes, half)
                inside = walk(
                    points, boxes, depth, leaf_of(slot, depth, n), slot, quadric, vectors, axes,
                    half, stop, stack, space, rule, ratio2, spare, outer,
                )  # fmt: skip
            count[row] = min(inside, stop)
            tail[row] = least
            if inside < stop:
                tail[row] = _score(inside, mean, outer[0], tie)
