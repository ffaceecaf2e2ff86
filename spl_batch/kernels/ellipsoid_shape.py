r"""Shape of each point's adaptive ellipsoid [W18 Eq. 3-5; W17 Eq. 5.4-5.6].

============ ================================================================
symbol       name
============ ================================================================
e_1..e_3     ``values``: eigenvalues of the neighbours' covariance [m2]
a, b, c      ``axes``: semi-axes r e_i / cbrt(e_1 e_2 e_3) [m]
r            ``radius``: radius of the sphere of equal volume [m]
P            ``vectors``: eigenvectors, as rows
flag         :func:`flag`: below 1 inside
============ ================================================================

Deviations: eigenvalues are floored (coincident and collinear neighbours have none);
the long axis is capped, and the volume is that of the capped ellipsoid; with fewer than
four neighbours within reach there is no shape to speak of, and the sphere is used.
"""

import math
from typing import Final, NamedTuple

import numpy as np
from numba import njit

from spl_batch.kernels.eigen import eigen_symmetric

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


@njit(nogil=True, cache=True, fastmath={"reassoc"})
def _covariance(near, found, moments):  # type: ignore[no-untyped-def]
    """Covariance of the neighbours; the sums are whole numbers, so their order is free."""
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
def quadric_of(vectors, axes, quadric):  # type: ignore[no-untyped-def]
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
def flag(q, dx, dy, dz):  # type: ignore[no-untyped-def]
    """[W18 Eq. 5]: below 1 inside."""
    return (
        q[0] * dx * dx
        + q[3] * dy * dy
        + q[5] * dz * dz
        + 2.0 * (q[1] * dx * dy + q[2] * dx * dz + q[4] * dy * dz)
    )


@njit(nogil=True, cache=True)
def half_extents(vectors, axes, half):  # type: ignore[no-untyped-def]
    """Half-extents of the ellipsoid's bounding box, rounded up."""
    for axis in range(3):
        total = 0.0
        for i in range(3):
            total += (axes[i] * vectors[i, axis]) ** 2
        half[axis] = math.sqrt(total) + 1.0


@njit(nogil=True, cache=True, inline="always")
def fit(points, slot, others, at, found, near, shape, moments, values, vectors, axes):  # type: ignore[no-untyped-def]
    """Ellipsoid of a slot's neighbours; returns its volume and fills in their offsets.

    Parameters
    ----------
    points : (4, n) int32
        Of the tree.
    slot, others, at, found
        The slot; those of its neighbours, which are row ``at`` of ``others``; their number.
    near : (3, k) float64
        Receives the offsets of the neighbours [quanta].
    shape : Shape
        How neighbours become an ellipsoid.
    moments, values, vectors : (6,), (3,), (3, 3) float64
        Scratch; ``vectors`` receives the unit axes as rows.
    axes : (3,) float64
        Receives the semi-axes, longest first [quanta].
    """
    for axis in range(3):
        own = np.float64(points[axis, slot])
        for i in range(found):
            near[axis, i] = points[axis, np.uint64(others[at, i])] - own
    if found >= SHAPE_MIN:
        _covariance(near, found, moments)
        eigen_symmetric(moments, values, vectors)
    else:
        values[:] = 1.0
        for i in range(3):
            for j in range(3):
                vectors[i, j] = 1.0 if i == j else 0.0
    return _axes(values, shape, axes)
