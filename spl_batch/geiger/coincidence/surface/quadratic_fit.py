r"""Moving quadratic least squares and its maxima [M20 4.2-4.3].

Around each voxel the detections of a cube of voxels are fitted by

    d(p) = c0 + g.p + p.H.p / 2,    p = (x, y, z) from the voxel's centre [voxel edges],

Eq. 1-2: a fixed matrix on ten moments of the neighbourhood, which are sums of whole numbers. Along
an eigenvector v of H with a negative eigenvalue L the maximum is at ``-(g.v) / L`` (Eq. 4 by
eigenvectors, without an inverse of H).

Deviations, with reasons:

- Eq. 3 as printed, 2 [c4 c7 c8; ...], doubles the mixed derivatives: the one of ``c7 x y`` is c7.
- Eq. 5 as printed, v1 v1' p_center, lies on a line *through the voxel's centre* when v1 is
  tangential, as 4.3 has it. The point of a ridge closest to the centre is
  ``(I - v1 v1') p_center``, that of a surface ``v3 v3' p_center``, v3 being the normal.
- Where the source normalises by interrogations is open. Here the polynomial's value is divided by
  their mean in the neighbourhood: quotients of voxels are mostly noise.
- A point is the strongest along its normal within its neighbourhood: a polynomial of few detections
  has maxima of its own beside surfaces.
- No threshold parts the blur beyond a target's edge from a faint target. A point is blur if its
  detections lie farther to the side than on a straight edge (:func:`edge_offset`), or if it has
  less than a share of what is strong beside it (:func:`drop_weaker`).
- A voxel has one point at most: of a peak, else a ridge, else a surface.
"""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.geiger.coincidence.surface.voxel_raster import UNIT
from spl_batch.numerics.compiled import njit
from spl_batch.numerics.planes.eigen import eigen_symmetric

NOTHING: Final = 0
SURFACE: Final = 1
RIDGE: Final = 2
PEAK: Final = 3
"""What a point is a maximum of: one direction, two, or all three."""

Maxima = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.uint8]]


def fit_matrix(half: int) -> NDArray[np.float64]:
    """Matrix that turns moments of a neighbourhood into coefficients, (M'M)^-1 of Eq. 1: (10, 10).

    Both in the order 1, x, y, z, x2, y2, z2, xy, xz, yz; ``half``: voxels beside the centre, > 0.
    """
    axis = np.arange(-half, half + 1)
    x, y, z = (a.ravel() for a in np.meshgrid(axis, axis, axis, indexing="ij"))
    terms = np.stack([np.ones_like(x), x, y, z, x * x, y * y, z * z, x * y, x * z, y * z])
    return np.linalg.inv((terms @ terms.T).astype(np.float64))


def edge_offset(half: int) -> float:
    """Distance of a neighbourhood's mean from its centre on a straight edge [voxel edges].

    Of a level target that ends at the centre, as a detector sees it that is two voxels wide, with
    trilinear weights: the voxel beside the edge has 11/12 of the inside, the one beyond it 1/12.
    """
    return (0.5 * half * (half + 1) - 1.0 / 6.0) / (half + 0.5)


@njit()
def _to_the_side(moment: NDArray[np.int64], normal: NDArray[np.float64]) -> float:
    """Distance of a neighbourhood's mean from the line through its centre along a normal."""
    x, y, z = moment[1] / moment[0], moment[2] / moment[0], moment[3] / moment[0]
    along = x * normal[0] + y * normal[1] + z * normal[2]
    return math.sqrt(max(x * x + y * y + z * z - along * along, 0.0))


@njit()
def moments(
    raster: NDArray[np.int64], i: int, j: int, k: int, half: int, out: NDArray[np.int64]
) -> None:
    """Ten moments of the cube around a voxel, M'd of Eq. 1, in the order of :func:`fit_matrix`."""
    out[:] = 0
    for x in range(-half, half + 1):
        for y in range(-half, half + 1):
            column = raster[i + x, j + y]
            s0, s1, s2 = 0, 0, 0
            for z in range(-half, half + 1):
                value = column[k + z]
                s0 += value
                s1 += value * z
                s2 += value * z * z
            out[0] += s0
            out[1] += s0 * x
            out[2] += s0 * y
            out[3] += s1
            out[4] += s0 * x * x
            out[5] += s0 * y * y
            out[6] += s2
            out[7] += s0 * x * y
            out[8] += s1 * x
            out[9] += s1 * y


@njit()
def closest_maximum(
    c: NDArray[np.float64], ratio: float, reach: float,
    values: NDArray[np.float64], vectors: NDArray[np.float64],
    offset: NDArray[np.float64],
) -> tuple[int, float]:  # fmt: skip
    """Offset from a voxel's centre to its polynomial's maximum: kind, and value there.

    ``c``: (10,) coefficients. ``ratio``: a further direction counts from this part of the strongest
    curvature. ``reach``: largest distance along each axis. ``values``, ``vectors``: scratch of
    :func:`eigen_symmetric`; the last vector is the normal. ``offset`` receives it, from the
    centre. Lengths are in voxel edges.
    """
    matrix = np.array([2.0 * c[4], c[7], c[8], 2.0 * c[5], c[9], 2.0 * c[6]])
    eigen_symmetric(matrix, values, vectors)
    offset[:] = 0.0
    if values[2] >= 0.0:
        return NOTHING, 0.0
    value, kind = c[0], NOTHING
    for at in range(2, -1, -1):
        if values[at] > ratio * values[2]:
            break
        v = vectors[at]
        slope = c[1] * v[0] + c[2] * v[1] + c[3] * v[2]
        step = -slope / values[at]
        value += 0.5 * slope * step
        for axis in range(3):
            offset[axis] += step * v[axis]
        kind += 1
    for axis in range(3):
        if not -reach <= offset[axis] < reach:
            return NOTHING, 0.0
    return kind, value


@njit()
def find_surfaces(
    detections: NDArray[np.int64], looks: NDArray[np.int64], voxel: NDArray[np.int64],
    half: int, fit: NDArray[np.float64],
    threshold: float, looks_min: float, ratio: float, reach: float, off_centre: float,
) -> Maxima:  # fmt: skip
    """Points of maximum density near (n, 3) voxels of a raster of detections.

    ``looks``: (n,), interrogations summed over each neighbourhood; as ``detections`` in parts of
    :data:`~.voxel_raster.UNIT`. ``half``, ``fit``: voxels beside a neighbourhood's centre, and its
    matrix. ``off_centre``: largest distance of the detections' mean from the centre, across the
    normal [voxel edges].

    Gives for each voxel the offset from its centre [voxel edges], the direction of the strongest
    maximum, detections per interrogation, and :data:`NOTHING` or what was found.
    """
    n = len(voxel)
    offset, normal = np.zeros((n, 3)), np.zeros((n, 3))
    value, kind = np.zeros(n), np.zeros(n, np.uint8)
    moment, c = np.empty(10, np.int64), np.empty(10)
    values, vectors = np.empty(3), np.empty((3, 3))
    cube = (2 * half + 1) ** 3
    for row in range(n):
        if looks[row] < looks_min * cube * UNIT:
            continue
        moments(detections, voxel[row, 0], voxel[row, 1], voxel[row, 2], half, moment)
        for i in range(10):
            total = 0.0
            for j in range(10):
                total += fit[i, j] * moment[j]
            c[i] = total
        found, height = closest_maximum(c, ratio, reach, values, vectors, offset[row])
        share = height * cube / looks[row]
        if found == NOTHING or share < threshold:
            continue
        if _to_the_side(moment, vectors[2]) <= off_centre:
            kind[row] = found
            value[row] = share
            normal[row] = vectors[2]
    return offset, normal, value, kind


@njit()
def drop_weaker(
    voxel: NDArray[np.int64], offset: NDArray[np.float64], normal: NDArray[np.float64],
    value: NDArray[np.float64], row_of: NDArray[np.int32], half: int, reach: int, share: float,
) -> NDArray[np.bool_]:  # fmt: skip
    """Which points have no stronger one before or behind them, nor much stronger ones beside.

    Before and behind is within 45 degrees of the point's own normal; of equal ones the first in the
    order of voxels stays. Beside is everything else: its strength is the mean of the values, the
    point's own among them, weighted with themselves.

    ``voxel`` and what follows: voxels of the points in a raster, in its order, and what
    :func:`find_surfaces` gives. ``row_of``: (nx, ny, nz), row of the point of each voxel, -1 for
    none. ``half``, ``reach``: voxels on either side that are looked at before and behind, and in
    all; reach >= half. ``share``: least part of the strength beside it that a point needs.
    """
    nx, ny, nz = row_of.shape
    keep = np.ones(len(voxel), np.bool_)
    for row in range(len(voxel)):
        i, j, k = voxel[row, 0], voxel[row, 1], voxel[row, 2]
        total = value[row]
        squares = total * total
        for p in range(max(i - reach, 0), min(i + reach + 1, nx)):
            for q in range(max(j - reach, 0), min(j + reach + 1, ny)):
                for r in range(max(k - reach, 0), min(k + reach + 1, nz)):
                    other = row_of[p, q, r]
                    if other < 0 or other == row or not keep[row]:
                        continue
                    dx = p - i + offset[other, 0] - offset[row, 0]
                    dy = q - j + offset[other, 1] - offset[row, 1]
                    dz = r - k + offset[other, 2] - offset[row, 2]
                    along = dx * normal[row, 0] + dy * normal[row, 1] + dz * normal[row, 2]
                    if 2.0 * along * along < dx * dx + dy * dy + dz * dz:
                        total += value[other]
                        squares += value[other] * value[other]
                    elif max(abs(p - i), abs(q - j), abs(r - k)) <= half:
                        stronger = value[other] > value[row]
                        if stronger or (value[other] == value[row] and other < row):
                            keep[row] = False
        keep[row] &= value[row] * total >= share * squares
    return keep
