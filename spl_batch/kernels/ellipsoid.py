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
from typing import Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spl_batch.kernels.eigen import eigen_symmetric
from spl_batch.kernels.kdtree import (
    CAP_MAX,
    LEAF,
    ROW_MASK,
    U0,
    U1,
    U2,
    U3,
    U4,
    U5,
    KdTree,
    leaf_slots,
    nearest_keys,
)
from spl_batch.kernels.poisson import poisson_critical, poisson_tail

SHAPE_MIN: Final = 4
"""Neighbours below which the ellipsoid is the sphere [count]."""


class Shape(NamedTuple):
    """How neighbours become an ellipsoid; lengths in quanta.

    Parameters
    ----------
    neighbours : int
        Neighbours that shape it [count].
    radius, floor, axis_cap, neighbour_cap : float
        Sphere of equal volume, smallest spread, longest semi-axis, farthest neighbour.
    power : float
        1 for eigenvalues [W18 Eq. 3], 0.5 for their roots.
    """

    neighbours: int
    radius: float
    floor: float
    axis_cap: float
    neighbour_cap: int
    power: float


def count_inside(
    xyz: NDArray[np.int32],
    tree: KdTree,
    query: NDArray[np.bool_],
    density: NDArray[np.float64],
    shape: Shape,
    *,
    alpha: float | NDArray[np.float64],
    spacing: NDArray[np.float64] | None = None,
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
        Squared spacing at each point [quanta2], from
        :func:`spl_batch.kernels.spacing.spacings`; without it every neighbour is a peer.
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
    if not 0 < shape.neighbour_cap <= CAP_MAX:
        raise ValueError(f"neighbour cap {shape.neighbour_cap} quanta: must lie in 1..{CAP_MAX}")
    count = np.zeros(len(xyz), dtype=np.int32)
    expected = np.zeros(len(xyz), dtype=np.float64)
    tail = np.ones(len(xyz), dtype=np.float64)
    if spacing is None:
        spacing = np.zeros(len(xyz), dtype=np.float64)
    if len(xyz):
        ratio2 = peer_ratio * peer_ratio
        limit = np.broadcast_to(np.asarray(alpha, dtype=np.float64), (len(xyz),))
        _count_all(
            xyz, *tree, query, density, shape, np.ascontiguousarray(limit), spacing, ratio2, tie,
            count, expected, tail,
        )  # fmt: skip
    return count, expected, tail


@njit(nogil=True, cache=True)
def _covariance(near, found, moments):  # type: ignore[no-untyped-def]
    """Covariance of the neighbours; the sums are exact integers, so their order is free."""
    sx = sy = sz = 0.0
    sxx = sxy = sxz = syy = syz = szz = 0.0
    for i in range(found):
        dx, dy, dz = near[0, i], near[1, i], near[2, i]
        sx += dx
        sy += dy
        sz += dz
        sxx += dx * dx
        sxy += dx * dy
        sxz += dx * dz
        syy += dy * dy
        syz += dy * dz
        szz += dz * dz
    n = np.float64(found)
    scale = 1.0 / (n * n)
    moments[0] = (n * sxx - sx * sx) * scale
    moments[1] = (n * sxy - sx * sy) * scale
    moments[2] = (n * sxz - sx * sz) * scale
    moments[3] = (n * syy - sy * sy) * scale
    moments[4] = (n * syz - sy * sz) * scale
    moments[5] = (n * szz - sz * sz) * scale


@njit(nogil=True, cache=True)
def _axes(values, shape, axes):  # type: ignore[no-untyped-def]
    """Semi-axes from eigenvalues [W18 Eq. 3]; returns the volume.

    Without a cap it is the sphere's to the last bit, so that the critical count of one
    point serves the next.
    """
    floor = shape.floor * shape.floor
    product = 1.0
    for i in range(3):
        value = max(values[i], floor)
        axes[i] = value if shape.power == 1.0 else value**shape.power
        product *= axes[i]
    scale = shape.radius / np.cbrt(product)
    volume = 4.0 / 3.0 * math.pi * shape.radius**3
    for i in range(3):
        axes[i] *= scale
        if axes[i] > shape.axis_cap:
            volume *= shape.axis_cap / axes[i]
            axes[i] = shape.axis_cap
    return volume


@njit(nogil=True, cache=True)
def _quadric(vectors, axes, quadric):  # type: ignore[no-untyped-def]
    """Upper triangle of the matrix Q with flag = d' Q d [W18 Eq. 4-5]."""
    for i in range(6):
        quadric[i] = 0.0
    for i in range(3):
        weight = 1.0 / (axes[i] * axes[i])
        x, y, z = vectors[i, 0], vectors[i, 1], vectors[i, 2]
        quadric[0] += weight * x * x
        quadric[1] += weight * x * y
        quadric[2] += weight * x * z
        quadric[3] += weight * y * y
        quadric[4] += weight * y * z
        quadric[5] += weight * z * z


@njit(nogil=True, cache=True)
def _flag(q, dx, dy, dz):  # type: ignore[no-untyped-def]
    """[W18 Eq. 5]: below 1 inside."""
    return (
        q[0] * dx * dx
        + q[3] * dy * dy
        + q[5] * dz * dz
        + 2.0 * (q[1] * dx * dy + q[2] * dx * dz + q[4] * dy * dz)
    )


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
def _walk(  # type: ignore[no-untyped-def]
    points, boxes, depth, leaf, slot, quadric, vectors, axes, half, stop, stack, wide, least, outer
):
    """Peers inside the ellipsoid around a slot, up to ``stop``, from its leaf upwards."""
    n = np.uint64(points.shape[1])
    first = U1 << depth
    x = np.float64(points[U0, slot])
    y = np.float64(points[U1, slot])
    z = np.float64(points[U2, slot])
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
                flag = _flag(quadric, dx, dy, dz)
                if flag < 1.0 and wide[i] >= least:
                    count += 1
                    outer[0] = max(outer[0], flag)
            if count >= stop:
                return stop
        if climb <= U1:
            return count
        stack[0] = climb ^ U1
        climb >>= U1


@njit(nogil=True, cache=True)
def _reach(vectors, axes, half):  # type: ignore[no-untyped-def]
    """Half-extents of the ellipsoid's bounding box, rounded up."""
    for axis in range(3):
        total = 0.0
        for i in range(3):
            total += (axes[i] * vectors[i, axis]) ** 2
        half[axis] = math.sqrt(total) + 1.0


@njit(nogil=True, cache=True)
def _fit(xyz, row, keys, found, near, shape, moments, values, vectors, scratch, axes):  # type: ignore[no-untyped-def]
    """Ellipsoid of a point's neighbours; returns its volume and fills in their offsets."""
    x, y, z = np.float64(xyz[row, 0]), np.float64(xyz[row, 1]), np.float64(xyz[row, 2])
    for i in range(found):
        other = keys[i] & ROW_MASK
        near[0, i] = xyz[other, 0] - x
        near[1, i] = xyz[other, 1] - y
        near[2, i] = xyz[other, 2] - z
    if found >= SHAPE_MIN:
        _covariance(near, found, moments)
        eigen_symmetric(moments, values, vectors, scratch)
    else:
        values[:] = 1.0
        for i in range(3):
            for j in range(3):
                vectors[i, j] = 1.0 if i == j else 0.0
    return _axes(values, shape, axes)


@njit(nogil=True, cache=True)
def _among(near, keys, found, quadric, spacing, ratio2, own, outer):  # type: ignore[no-untyped-def]
    """Peers inside among the neighbours that shaped the ellipsoid."""
    count = 0
    outer[0] = 0.0
    for i in range(found):
        flag = _flag(quadric, near[0, i], near[1, i], near[2, i])
        if flag < 1.0 and spacing[keys[i] & ROW_MASK] * ratio2 >= own:
            count += 1
            outer[0] = max(outer[0], flag)
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
def _count_all(  # type: ignore[no-untyped-def]
    xyz, points, boxes, depth, query, density, shape, alpha, spacing, ratio2, tie,
    count, expected, tail,
):  # fmt: skip
    """Every query point in tree order, so that the cache stays warm."""
    n, depth = np.uint64(points.shape[1]), np.uint64(depth)
    keys = np.empty(shape.neighbours, dtype=np.int64)
    near = np.empty((3, shape.neighbours), dtype=np.float64)
    distance, fresh = np.empty(LEAF, dtype=np.float64), np.empty(LEAF, dtype=np.int64)
    stack, bound = np.empty(64, dtype=np.uint64), np.empty(64, dtype=np.float64)
    moments, quadric = np.empty(6), np.empty(6)
    values, axes, half, outer = np.empty(3), np.empty(3), np.empty(3), np.empty(1)
    vectors, scratch = np.empty((3, 3)), np.empty((2, 3))
    cap = shape.neighbour_cap
    wide = np.empty(len(xyz), dtype=np.float64)
    for i in range(n):
        wide[i] = spacing[points[U3, i]] * ratio2
    known, asked, stop, least = -1.0, -1.0, 0, 1.0
    for leaf in range(U1 << depth, U1 << (depth + U1)):
        low, high = leaf_slots(leaf, depth, n)
        for slot in range(low, high):
            row = points[U3, slot]
            if not query[row]:
                continue
            found = nearest_keys(
                points, boxes, depth, leaf, slot, cap, keys, distance, fresh, stack, bound
            )
            volume = _fit(
                xyz, row, keys, found, near, shape, moments, values, vectors, scratch, axes
            )
            mean = density[row] * volume
            expected[row] = mean
            if mean != known or alpha[row] != asked:
                known, asked = mean, alpha[row]
                stop = poisson_critical(mean, asked)
                least = poisson_tail(stop, mean)
            _quadric(vectors, axes, quadric)
            inside = _among(near, keys, found, quadric, spacing, ratio2, spacing[row], outer)
            reach = float(cap)
            if found == shape.neighbours:
                reach = math.sqrt(np.float64(keys[found - 1] >> 32))
            if inside < stop and axes[0] > reach:
                _reach(vectors, axes, half)
                inside = _walk(
                    points, boxes, depth, leaf, slot, quadric, vectors, axes, half, stop, stack,
                    wide, spacing[row], outer,
                )  # fmt: skip
            count[row] = min(inside, stop)
            tail[row] = least
            if inside < stop:
                tail[row] = _score(inside, mean, outer[0], tie)
