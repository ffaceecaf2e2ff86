"""Eigenvalues and eigenvectors of symmetric 3 x 3 matrices in closed form.

Eigenvalues by the trigonometric solution of the cubic, eigenvectors by cross products
starting from the eigenvalue that stands farthest apart (Eberly, "A robust eigensolver
for 3 x 3 symmetric matrices", Geometric Tools, 2014). Degenerate matrices - planes,
lines, a single place - give an orthonormal basis all the same.
"""

import math

from numba import njit


@njit(nogil=True, cache=True)
def _complement(w, u, v):  # type: ignore[no-untyped-def]
    """Two unit vectors that complete the unit vector ``w`` to a basis."""
    if abs(w[0]) > abs(w[1]):
        scale = 1.0 / math.sqrt(w[0] * w[0] + w[2] * w[2])
        u[0], u[1], u[2] = -w[2] * scale, 0.0, w[0] * scale
    else:
        scale = 1.0 / math.sqrt(w[1] * w[1] + w[2] * w[2])
        u[0], u[1], u[2] = 0.0, w[2] * scale, -w[1] * scale
    v[0] = w[1] * u[2] - w[2] * u[1]
    v[1] = w[2] * u[0] - w[0] * u[2]
    v[2] = w[0] * u[1] - w[1] * u[0]


@njit(nogil=True, cache=True)
def _isolated(axx, axy, axz, ayy, ayz, azz, value, out):  # type: ignore[no-untyped-def]
    """Eigenvector of an isolated eigenvalue: the longest cross product of two rows of A - value."""
    r0x, r0y, r0z = axx - value, axy, axz
    r1x, r1y, r1z = axy, ayy - value, ayz
    r2x, r2y, r2z = axz, ayz, azz - value
    ax, ay, az = r0y * r1z - r0z * r1y, r0z * r1x - r0x * r1z, r0x * r1y - r0y * r1x
    bx, by, bz = r0y * r2z - r0z * r2y, r0z * r2x - r0x * r2z, r0x * r2y - r0y * r2x
    cx, cy, cz = r1y * r2z - r1z * r2y, r1z * r2x - r1x * r2z, r1x * r2y - r1y * r2x
    a = ax * ax + ay * ay + az * az
    b = bx * bx + by * by + bz * bz
    c = cx * cx + cy * cy + cz * cz
    if b > a:
        ax, ay, az, a = bx, by, bz, b
    if c > a:
        ax, ay, az, a = cx, cy, cz, c
    if a <= 0.0:
        out[0], out[1], out[2] = 1.0, 0.0, 0.0
        return
    scale = 1.0 / math.sqrt(a)
    out[0], out[1], out[2] = ax * scale, ay * scale, az * scale


@njit(nogil=True, cache=True)
def _within_plane(axx, axy, axz, ayy, ayz, azz, w, value, u, v, out):  # type: ignore[no-untyped-def]
    """Eigenvector of ``value`` within the plane at right angles to ``w``; fills u and v."""
    _complement(w, u, v)
    aux = axx * u[0] + axy * u[1] + axz * u[2]
    auy = axy * u[0] + ayy * u[1] + ayz * u[2]
    auz = axz * u[0] + ayz * u[1] + azz * u[2]
    avx = axx * v[0] + axy * v[1] + axz * v[2]
    avy = axy * v[0] + ayy * v[1] + ayz * v[2]
    avz = axz * v[0] + ayz * v[1] + azz * v[2]
    m00 = u[0] * aux + u[1] * auy + u[2] * auz - value
    m01 = u[0] * avx + u[1] * avy + u[2] * avz
    m11 = v[0] * avx + v[1] * avy + v[2] * avz - value
    if abs(m00) >= abs(m11):
        p, q = m01, -m00
    else:
        p, q = m11, -m01
    norm = math.sqrt(p * p + q * q)
    if norm <= 0.0:
        p, q, norm = 1.0, 0.0, 1.0
    p, q = p / norm, q / norm
    for i in range(3):
        out[i] = p * u[i] + q * v[i]


@njit(nogil=True, cache=True)
def eigen_symmetric(matrix, values, vectors, scratch):  # type: ignore[no-untyped-def]
    """Eigenvalues, descending, and eigenvectors of a symmetric matrix.

    Parameters
    ----------
    matrix : (6,) float64
        Upper triangle xx, xy, xz, yy, yz, zz; finite.
    values : (3,) float64
        Receives the eigenvalues, largest first.
    vectors : (3, 3) float64
        Receives the unit eigenvectors as rows, in the same order.
    scratch : (2, 3) float64
        Scratch.
    """
    size = 0.0
    for i in range(6):
        size = max(size, abs(matrix[i]))
    if size <= 0.0:
        for i in range(3):
            values[i] = 0.0
            for j in range(3):
                vectors[i, j] = 1.0 if i == j else 0.0
        return
    axx, axy, axz = matrix[0] / size, matrix[1] / size, matrix[2] / size
    ayy, ayz, azz = matrix[3] / size, matrix[4] / size, matrix[5] / size
    mean = (axx + ayy + azz) / 3.0
    bxx, byy, bzz = axx - mean, ayy - mean, azz - mean
    off = axy * axy + axz * axz + ayz * ayz
    spread = math.sqrt((bxx * bxx + byy * byy + bzz * bzz + 2.0 * off) / 6.0)
    half = 0.0
    if spread > 1e-15:
        determinant = (
            bxx * (byy * bzz - ayz * ayz)
            - axy * (axy * bzz - ayz * axz)
            + axz * (axy * ayz - byy * axz)
        )
        half = min(max(determinant / (2.0 * spread * spread * spread), -1.0), 1.0)
    angle = math.acos(half) / 3.0
    largest = mean + 2.0 * spread * math.cos(angle)
    smallest = mean + 2.0 * spread * math.cos(angle + 2.0943951023931953)
    middle = 3.0 * mean - largest - smallest
    apart, other = (0, 2) if half >= 0.0 else (2, 0)
    values[0], values[1], values[2] = largest, middle, smallest
    w, m, u, v = vectors[apart], vectors[1], scratch[0], scratch[1]
    _isolated(axx, axy, axz, ayy, ayz, azz, values[apart], w)
    _within_plane(axx, axy, axz, ayy, ayz, azz, w, middle, u, v, m)
    last = vectors[other]
    last[0] = w[1] * m[2] - w[2] * m[1]
    last[1] = w[2] * m[0] - w[0] * m[2]
    last[2] = w[0] * m[1] - w[1] * m[0]
    for i in range(3):
        values[i] *= size
