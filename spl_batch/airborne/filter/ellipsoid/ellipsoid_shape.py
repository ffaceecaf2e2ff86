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
from numpy.typing import NDArray

from spl_batch.airborne.settings import FilterSettings
from spl_batch.lattice.tiles import quanta
from spl_batch.numerics.compiled import njit
from spl_batch.numerics.neighbours.kdtree import U0, U1, U2, U3, U4, U5
from spl_batch.numerics.planes.eigen import eigen_symmetric
from spl_batch.numerics.simd import LANES, load, spread, store

SHAPE_MIN: Final = 4
"""Neighbours below which the ellipsoid is the sphere [count]."""


class Shape(NamedTuple):
    """How neighbours become an ellipsoid; lengths in quanta."""

    neighbours: int
    #: Sphere of equal volume, smallest spread, longest semi-axis, farthest neighbour.
    radius: float
    floor: float
    axis_cap: float
    neighbour_cap: int
    power: float  #: 1 for eigenvalues [W18 Eq. 3], 0.5 for their roots.


def shape_of(settings: FilterSettings, neighbours: int, radius_m: float) -> Shape:
    """How neighbours become an ellipsoid, in quanta."""
    return Shape(
        neighbours=neighbours,
        radius=float(quanta(radius_m)),
        floor=float(quanta(settings.eigen_floor_m)),
        axis_cap=float(quanta(settings.axis_cap_m)),
        neighbour_cap=quanta(settings.neighbour_cap_m),
        power=1.0 if settings.axis_power == "eigenvalue" else 0.5,
    )


@njit(fastmath={"reassoc"})
def offsets(points, slot, others, at, found, near, member, moments):  # type: ignore[no-untyped-def]
    """Offsets of a slot's neighbours, and their covariance; sums of whole numbers, in any order.

    ``others``: slots of the neighbours, in row ``at``. Of a member, ``near`` (m, 3, k) receives the
    offsets [quanta], and ``moments`` (6, m) xx, xy, xz, yy, yz, zz.
    """
    for axis in range(U3):
        own = np.float64(points[axis, slot])
        for i in range(found):
            near[member, axis, i] = points[axis, np.uint64(others[at, i])] - own
    sx = sy = sz = 0.0
    sxx = sxy = sxz = syy = syz = szz = 0.0
    for i in range(found):
        dx, dy, dz = near[member, U0, i], near[member, U1, i], near[member, U2, i]
        sx += dx
        sy += dy
        sz += dz
        sxx += dx * dx
        sxy += dx * dy
        sxz += dx * dz
        syy += dy * dy
        syz += dy * dz
        szz += dz * dz
    n = np.float64(found) if found > 0 else 1.0
    scale = 1.0 / (n * n)
    moments[0, member] = (n * sxx - sx * sx) * scale
    moments[1, member] = (n * sxy - sx * sy) * scale
    moments[2, member] = (n * sxz - sx * sz) * scale
    moments[3, member] = (n * syy - sy * sy) * scale
    moments[4, member] = (n * syz - sy * sz) * scale
    moments[5, member] = (n * szz - sz * sz) * scale


@njit()
def _axes(values, shape, axes, member):  # type: ignore[no-untyped-def]
    """Semi-axes (3, m) of a member from eigenvalues [W18 Eq. 3]; returns the volume.

    Uncapped it is the sphere's to the last bit, so points share a critical count.
    """
    floor = shape.floor * shape.floor
    product = 1.0
    for i in range(3):
        value = max(values[i, member], floor)
        axes[i, member] = value if shape.power == 1.0 else value**shape.power
        product *= axes[i, member]
    scale = shape.radius / np.cbrt(product)
    volume = 4.0 / 3.0 * math.pi * shape.radius**3
    for i in range(3):
        axes[i, member] *= scale
        if axes[i, member] > shape.axis_cap:
            volume *= shape.axis_cap / axes[i, member]
            axes[i, member] = shape.axis_cap
    return volume


@njit()
def _quadrics(vectors, axes, quadrics):  # type: ignore[no-untyped-def]
    """Upper triangles (6, 8) of the matrices Q with flag = d' Q d [W18 Eq. 4-5]."""
    q0 = q1 = q2 = q3 = q4 = q5 = spread(0.0)
    for i in range(U3):
        axis, x = load(axes, (i, U0)), load(vectors, (U3 * i, U0))
        y, z = load(vectors, (U3 * i + U1, U0)), load(vectors, (U3 * i + U2, U0))
        weight = spread(1.0) / (axis * axis)
        q0, q1, q2 = q0 + weight * x * x, q1 + weight * x * y, q2 + weight * x * z
        q3, q4, q5 = q3 + weight * y * y, q4 + weight * y * z, q5 + weight * z * z
    store(quadrics, (U0, U0), q0)
    store(quadrics, (U1, U0), q1)
    store(quadrics, (U2, U0), q2)
    store(quadrics, (U3, U0), q3)
    store(quadrics, (U4, U0), q4)
    store(quadrics, (U5, U0), q5)


@njit()
def flag(q, dx, dy, dz):  # type: ignore[no-untyped-def]
    """[W18 Eq. 5]: below 1 inside."""
    return (
        q[0] * dx * dx
        + q[3] * dy * dy
        + q[5] * dz * dz
        + 2.0 * (q[1] * dx * dy + q[2] * dx * dz + q[4] * dy * dz)
    )


class Bodies(NamedTuple):
    """Ellipsoids of eight points at a time, one to a column."""

    found: NDArray[np.int64]  #: (8,): neighbours that shape each [count].
    #: (6, 8): covariance of the neighbours, and the matrix of the ellipsoid, upper triangles.
    moments: NDArray[np.float64]
    quadrics: NDArray[np.float64]
    #: (3, 8): eigenvalues and semi-axes, longest first [quanta].
    values: NDArray[np.float64]
    axes: NDArray[np.float64]
    vectors: NDArray[np.float64]  #: (9, 8): unit axes, x, y, z of each.
    volume: NDArray[np.float64]  #: (8,): [quanta3].
    #: (6,), (3,), (3, 3) float64: scratch for one of them.
    matrix: NDArray[np.float64]
    value: NDArray[np.float64]
    rows: NDArray[np.float64]


def no_bodies() -> Bodies:
    """Room for :class:`Bodies`."""
    return Bodies(
        np.zeros(LANES, np.int64), np.zeros((6, LANES)), np.zeros((6, LANES)),
        np.zeros((3, LANES)), np.zeros((3, LANES)), np.zeros((9, LANES)), np.zeros(LANES),
        np.zeros(6), np.zeros(3), np.zeros((3, 3)),
    )  # fmt: skip


@njit()
def fit(bodies, shape):  # type: ignore[no-untyped-def]
    """Ellipsoids of eight points by how many neighbours they have, and by their covariance."""
    found, moments, quadrics, values, axes, vectors, volume, matrix, value, rows = bodies
    for member in range(LANES):
        for i in range(6):
            matrix[i] = moments[i, member]
        eigen_symmetric(matrix, value, rows)
        lone = found[member] < SHAPE_MIN
        for i in range(3):
            values[i, member] = 1.0 if lone else value[i]
            for j in range(3):
                vectors[3 * i + j, member] = (1.0 if i == j else 0.0) if lone else rows[i, j]
        volume[member] = _axes(values, shape, axes, member)
    _quadrics(vectors, axes, quadrics)


@njit()
def lone_body(bodies, member, quadric, vectors, axes, half):  # type: ignore[no-untyped-def]
    """One of them as arrays of its own: (6,), (3, 3) by rows, (3,).

    ``half`` (3,): half-extents of its bounding box, rounded up.
    """
    for i in range(3):
        axes[i] = bodies.axes[i, member]
        for j in range(3):
            vectors[i, j] = bodies.vectors[3 * i + j, member]
    for i in range(6):
        quadric[i] = bodies.quadrics[i, member]
    for axis in range(3):
        total = 0.0
        for i in range(3):
            total += (axes[i] * vectors[i, axis]) ** 2
        half[axis] = math.sqrt(total) + 1.0
