"""Eigenvalues and eigenvectors of symmetric 3 x 3 matrices in closed form.

Eigenvalues by the trigonometric solution of the cubic, eigenvectors by cross products
starting from the eigenvalue that is farthest apart (Eberly, "A robust eigensolver
for 3 x 3 symmetric matrices", Geometric Tools, 2014). Degenerate matrices - planes,
lines, a single point - give an orthonormal basis all the same.
"""

import math

from spl_batch.numerics.compiled import njit


@njit()
def cross(ax, ay, az, bx, by, bz):  # type: ignore[no-untyped-def]
    """Cross product of two vectors."""
    return ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx


@njit()
def _isolated(axx, axy, axz, ayy, ayz, azz, value):  # type: ignore[no-untyped-def]
    """Eigenvector of an isolated eigenvalue: the longest cross product of two rows of A - value."""
    xx, yy, zz = axx - value, ayy - value, azz - value
    ax, ay, az = cross(xx, axy, axz, axy, yy, ayz)
    bx, by, bz = cross(xx, axy, axz, axz, ayz, zz)
    cx, cy, cz = cross(axy, yy, ayz, axz, ayz, zz)
    a = ax * ax + ay * ay + az * az
    b = bx * bx + by * by + bz * bz
    c = cx * cx + cy * cy + cz * cz
    if b > a:
        ax, ay, az, a = bx, by, bz, b
    if c > a:
        ax, ay, az, a = cx, cy, cz, c
    if a <= 0.0:
        return 1.0, 0.0, 0.0
    scale = 1.0 / math.sqrt(a)
    return ax * scale, ay * scale, az * scale


@njit()
def _within_plane(axx, axy, axz, ayy, ayz, azz, wx, wy, wz, value):  # type: ignore[no-untyped-def]
    """Eigenvector of ``value`` within the plane at right angles to the unit vector w."""
    # Two unit vectors, u and v, that complete w to a basis.
    if abs(wx) > abs(wy):
        scale = 1.0 / math.sqrt(wx * wx + wz * wz)
        ux, uy, uz = -wz * scale, 0.0, wx * scale
    else:
        scale = 1.0 / math.sqrt(wy * wy + wz * wz)
        ux, uy, uz = 0.0, wz * scale, -wy * scale
    vx, vy, vz = cross(wx, wy, wz, ux, uy, uz)
    # The matrix less the value within their plane.
    aux = axx * ux + axy * uy + axz * uz
    auy = axy * ux + ayy * uy + ayz * uz
    auz = axz * ux + ayz * uy + azz * uz
    avx = axx * vx + axy * vy + axz * vz
    avy = axy * vx + ayy * vy + ayz * vz
    avz = axz * vx + ayz * vy + azz * vz
    m00 = ux * aux + uy * auy + uz * auz - value
    m01 = ux * avx + uy * avy + uz * avz
    m11 = vx * avx + vy * avy + vz * avz - value
    if abs(m00) >= abs(m11):
        p, q = m01, -m00
    else:
        p, q = m11, -m01
    norm = math.sqrt(p * p + q * q)
    if norm <= 0.0:
        p, q, norm = 1.0, 0.0, 1.0
    p, q = p / norm, q / norm
    return p * ux + q * vx, p * uy + q * vy, p * uz + q * vz


@njit()
def eigen_symmetric(matrix, values, vectors):  # type: ignore[no-untyped-def]
    """Eigenvalues, descending, and eigenvectors of a symmetric matrix.

    Parameters
    ----------
    matrix : (6,) float64
        Upper triangle xx, xy, xz, yy, yz, zz; finite.
    values : (3,) float64
        Receives the eigenvalues, largest first.
    vectors : (3, 3) float64
        Receives the unit eigenvectors as rows, in the same order.
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
    wx, wy, wz = _isolated(axx, axy, axz, ayy, ayz, azz, values[apart])
    mx, my, mz = _within_plane(axx, axy, axz, ayy, ayz, azz, wx, wy, wz, middle)
    # Numbers, not rows: numba counts the references to each view of an array.
    vectors[apart, 0], vectors[apart, 1], vectors[apart, 2] = wx, wy, wz
    vectors[1, 0], vectors[1, 1], vectors[1, 2] = mx, my, mz
    vectors[other, 0] = wy * mz - wz * my
    vectors[other, 1] = wz * mx - wx * mz
    vectors[other, 2] = wx * my - wy * mx
    for i in range(3):
        values[i] *= size
