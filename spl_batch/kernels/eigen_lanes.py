"""Eigenvalues and eigenvectors of eight symmetric 3 x 3 matrices at a time.

Each lane takes the steps of :func:`~spl_batch.kernels.eigen.eigen_symmetric`, which says what they
are: what a matrix gets does not depend on its neighbours, and is the same to the bit.
"""

import math

import numpy as np

from spl_batch.kernels.eigen import cross, restricted
from spl_batch.kernels.lanes import (
    LANES,
    absolute,
    greater,
    lesser,
    load,
    root,
    spread,
    store,
    where,
)
from spl_batch.numerics.compiled import njit

_ROW = tuple(np.uint64(i) for i in range(9))
R0, R1, R2, R3, R4, R5, R6, R7, R8 = _ROW
U0 = R0


@njit(nogil=True, cache=True)
def _isolated(axx, axy, axz, ayy, ayz, azz, value):  # type: ignore[no-untyped-def]
    """Eigenvectors of isolated eigenvalues: the longest cross product of two rows of A - value."""
    xx, yy, zz = axx - value, ayy - value, azz - value
    ax, ay, az = cross(xx, axy, axz, axy, yy, ayz)
    bx, by, bz = cross(xx, axy, axz, axz, ayz, zz)
    cx, cy, cz = cross(axy, yy, ayz, axz, ayz, zz)
    a = ax * ax + ay * ay + az * az
    b = bx * bx + by * by + bz * bz
    c = cx * cx + cy * cy + cz * cz
    longer = b > a
    ax, ay, az = where(longer, bx, ax), where(longer, by, ay), where(longer, bz, az)
    a = where(longer, b, a)
    longer = c > a
    ax, ay, az = where(longer, cx, ax), where(longer, cy, ay), where(longer, cz, az)
    a = where(longer, c, a)
    none, one, nothing = a <= spread(0.0), spread(1.0), spread(0.0)
    scale = one / root(a)
    return (
        where(none, one, ax * scale), where(none, nothing, ay * scale),
        where(none, nothing, az * scale),
    )  # fmt: skip


@njit(nogil=True, cache=True)
def _complement(wx, wy, wz):  # type: ignore[no-untyped-def]
    """Two unit vectors that complete each unit vector w to a basis."""
    one, none = spread(1.0), spread(0.0)
    wide = absolute(wx) > absolute(wy)
    scale = one / root(where(wide, wx * wx, wy * wy) + wz * wz)
    ux = where(wide, spread(-1.0) * wz * scale, none)
    uy = where(wide, none, wz * scale)
    uz = where(wide, wx * scale, spread(-1.0) * wy * scale)
    vx, vy, vz = cross(wx, wy, wz, ux, uy, uz)
    return ux, uy, uz, vx, vy, vz


@njit(nogil=True, cache=True)
def _within_plane(axx, axy, axz, ayy, ayz, azz, wx, wy, wz, value):  # type: ignore[no-untyped-def]
    """Eigenvectors of ``value`` within the planes at right angles to w."""
    ux, uy, uz, vx, vy, vz = _complement(wx, wy, wz)
    m00, m01, m11 = restricted(
        axx, axy, axz, ayy, ayz, azz, ux, uy, uz, vx, vy, vz, value
    )  # fmt: skip
    first, minus = absolute(m00) >= absolute(m11), spread(-1.0)
    p, q = where(first, m01, m11), where(first, minus * m00, minus * m01)
    norm = root(p * p + q * q)
    none, one, nothing = norm <= spread(0.0), spread(1.0), spread(0.0)
    p, q, norm = where(none, one, p), where(none, nothing, q), where(none, one, norm)
    p, q = p / norm, q / norm
    return p * ux + q * vx, p * uy + q * vy, p * uz + q * vz


@njit(nogil=True, cache=True)
def eigen_of_eight(matrices, values, vectors, spare):  # type: ignore[no-untyped-def]
    """Eigenvalues, descending, and eigenvectors of eight symmetric matrices.

    Parameters
    ----------
    matrices : (6, 8) float64
        Upper triangles xx, xy, xz, yy, yz, zz; finite.
    values : (3, 8) float64
        Receives the eigenvalues, largest first.
    vectors : (9, 8) float64
        Receives the unit eigenvectors, x, y, z of each, in the same order.
    spare : (3, 8) float64
        Scratch.
    """
    axx, axy, axz = load(matrices, (R0, U0)), load(matrices, (R1, U0)), load(matrices, (R2, U0))
    ayy, ayz, azz = load(matrices, (R3, U0)), load(matrices, (R4, U0)), load(matrices, (R5, U0))
    none, one, two, three = spread(0.0), spread(1.0), spread(2.0), spread(3.0)
    size = greater(greater(absolute(axx), absolute(axy)), greater(absolute(axz), absolute(ayy)))
    size = greater(size, greater(absolute(ayz), absolute(azz)))
    nothing = size <= none
    divisor = where(nothing, one, size)
    axx, axy, axz = axx / divisor, axy / divisor, axz / divisor
    ayy, ayz, azz = ayy / divisor, ayz / divisor, azz / divisor
    mean = (axx + ayy + azz) / three
    bxx, byy, bzz = axx - mean, ayy - mean, azz - mean
    off = axy * axy + axz * axz + ayz * ayz
    width = root((bxx * bxx + byy * byy + bzz * bzz + two * off) / spread(6.0))
    determinant = (
        bxx * (byy * bzz - ayz * ayz)
        - axy * (axy * bzz - ayz * axz)
        + axz * (axy * ayz - byy * axz)
    )
    wide = width > spread(1e-15)
    half = determinant / where(wide, two * width * width * width, one)
    half = where(wide, lesser(greater(half, spread(-1.0)), one), none)
    store(spare, (R0, U0), half)
    for i in range(LANES):
        angle = math.acos(spare[0, i]) / 3.0
        spare[1, i], spare[2, i] = math.cos(angle), math.cos(angle + 2.0943951023931953)
    largest = mean + two * width * load(spare, (R1, U0))
    smallest = mean + two * width * load(spare, (R2, U0))
    middle = three * mean - largest - smallest
    upper = half >= none
    wx, wy, wz = _isolated(axx, axy, axz, ayy, ayz, azz, where(upper, largest, smallest))
    mx, my, mz = _within_plane(axx, axy, axz, ayy, ayz, azz, wx, wy, wz, middle)
    ox, oy, oz = cross(wx, wy, wz, mx, my, mz)
    store(values, (R0, U0), where(nothing, none, largest * size))
    store(values, (R1, U0), where(nothing, none, middle * size))
    store(values, (R2, U0), where(nothing, none, smallest * size))
    store(vectors, (R0, U0), where(nothing, one, where(upper, wx, ox)))
    store(vectors, (R1, U0), where(nothing, none, where(upper, wy, oy)))
    store(vectors, (R2, U0), where(nothing, none, where(upper, wz, oz)))
    store(vectors, (R3, U0), where(nothing, none, mx))
    store(vectors, (R4, U0), where(nothing, one, my))
    store(vectors, (R5, U0), where(nothing, none, mz))
    store(vectors, (R6, U0), where(nothing, none, where(upper, ox, wx)))
    store(vectors, (R7, U0), where(nothing, none, where(upper, oy, wy)))
    store(vectors, (R8, U0), where(nothing, one, where(upper, oz, wz)))
