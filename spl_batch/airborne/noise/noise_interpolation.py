"""Noise at points, from the density over squares around them and the ends of gates."""

import math

import numpy as np
from numpy.typing import NDArray

from spl_batch.numerics.compiled import njit


@njit()
def add_between(
    density: NDArray[np.float32],
    side: NDArray[np.int8],
    end: NDArray[np.float32],
    voxel: tuple[NDArray[np.int64], ...],
    square: tuple[NDArray[np.int64], ...],
    offset: tuple[NDArray[np.float64], ...],
    least: float,
    out: NDArray[np.float64],
) -> None:
    """Add the density at points, linear between squares and between layers without a gate's end.

    Up to a gate's end the density falls linearly over half the length of a square, to a half: some
    beamlets may go on.

    Parameters
    ----------
    density : (nx, ny, nz) float32
        Of each square [1/m3]; 0 where nothing is listened to.
    side : (vx, vy, nz) int8
        Voxels in which the gate ends: 1 at the upper end, -1 at the lower one; 0 elsewhere.
    end : (vx, vy, nz) float32
        Height of that end over the voxel's centre [voxels].
    voxel : three of (n,) int64
        Index of each point's voxel.
    square : two of (n,) int64
        Index of its square.
    offset : three of (n,) float64
        From the centre of the square, in squares, and of the voxel, in voxels [-0.5..0.5].
    least : float
        Part of the largest of the four that is left at an edge [0..1].
    out : (n,) float64
        The density is added to these [1/m3].
    """
    nx, ny, layers = density.shape
    per_voxel = nx // side.shape[0]
    for p in range(len(out)):
        # Unsigned indices: a signed one costs numba a test for wrapping.
        vx, vy, z = np.uint64(voxel[0][p]), np.uint64(voxel[1][p]), np.uint64(voxel[2][p])
        west, south, up = np.floor(offset[0][p]), np.floor(offset[1][p]), offset[2][p]
        right, ahead = offset[0][p] - west, offset[1][p] - south
        i = np.uint64(_within(square[0][p] + west, nx))
        j = np.uint64(_within(square[1][p] + south, ny))
        e = np.uint64(_within(square[0][p] + west + 1.0, nx))
        n = np.uint64(_within(square[1][p] + south + 1.0, ny))
        found = _linear(density, i, e, j, n, z, right, ahead, least)
        if side[vx, vy, z] != 0:
            beyond = side[vx, vy, z] * (up - end[vx, vy, z]) * per_voxel
            found *= min(max(0.5 - beyond, 0.5), 1.0)
        else:
            k = np.uint64(_within(voxel[2][p] + (1 if up > 0.0 else -1), layers))
            beside = _linear(density, i, e, j, n, k, right, ahead, least)
            if found > 0.0 and beside > 0.0 and side[vx, vy, k] == 0:
                found += abs(up) * (beside - found)
        out[p] += found


@njit()
def put_places(x, y, z, edge, parts, corner, top, voxel, square, offset):  # type: ignore[no-untyped-def]
    """Voxels and squares of points, and how far they lie off the middles of both.

    Parameters
    ----------
    x, y, z : (n,) integer
        Absolute coordinates [quanta].
    edge, parts : int
        Edge of a voxel [quanta], and squares along it [count].
    corner : (int, int, int)
        Absolute index of the first voxel.
    top : int
        Highest layer: what lies above or below is as silent as the highest or lowest one.
    voxel, square, offset
        (3, n), (2, n), (3, n), out: as in :func:`add_between`.
    """
    # In the middle of its quantum no quotient is near a whole number.
    voxels = 1.0 / edge
    for p in range(len(x)):
        for axis in range(2):
            v = np.int64(x[p] if axis == 0 else y[p])
            at = np.int64(math.floor((v * parts + 0.5) * voxels))
            own = np.int64(math.floor((v + 0.5) * voxels)) - corner[axis]
            voxel[axis, p], square[axis, p] = own, at - corner[axis] * parts
            offset[axis, p] = (v * parts - at * edge) / edge - 0.5
        v = np.int64(z[p])
        at = np.int64(math.floor((v + 0.5) * voxels))
        voxel[2, p] = min(max(at - corner[2], 0), top)
        offset[2, p] = (v - at * edge) / edge - 0.5


@njit(inline="always")
def _within(at, size):  # type: ignore[no-untyped-def]
    """Nearest index that exists."""
    return min(max(np.int64(at), 0), size - 1)


@njit(inline="always")
def _linear(values, i, e, j, n, z, right, ahead, least):  # type: ignore[no-untyped-def]
    """Value between four squares of a layer, and at least a part of the largest one."""
    a, b, c, d = values[i, j, z], values[e, j, z], values[i, n, z], values[e, n, z]
    near, far = (1.0 - right) * a + right * b, (1.0 - right) * c + right * d
    return max((1.0 - ahead) * near + ahead * far, least * max(a, b, c, d))
