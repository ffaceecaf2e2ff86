"""Noise at points from what beamlets over squares stand for."""

import numpy as np
from numba import njit
from numpy.typing import NDArray


@njit(nogil=True, cache=True)
def density_between(
    beamlets: NDArray[np.float64],
    near: NDArray[np.bool_],
    each: NDArray[np.float64],
    usual: NDArray[np.float64],
    voxel_x: NDArray[np.int64],
    voxel_y: NDArray[np.int64],
    layer: NDArray[np.int64],
    square_x: NDArray[np.int64],
    square_y: NDArray[np.int64],
    across: NDArray[np.float64],
    along: NDArray[np.float64],
    squares: float,
    prior: float,
    density: NDArray[np.float64],
) -> None:
    """Density at points by the beamlets around, linear between the centres of four squares.

    A count that ``prior`` beamlets would be worth as much as is held for what it stands for by
    half, and for the voxel's mean by half: (b^2 each + prior usual / squares) / (b + prior /
    squares).

    Parameters
    ----------
    beamlets : (nx, ny, nz) float64
        Beamlets over a square, of its covered part [count].
    near : (nx, ny, nz) bool
        Squares where the density is not nothing.
    each : (vx, vy, nz) float64
        What one of them stands for, by voxel [1/m3].
    usual : (vx, vy, nz) float64
        Mean density of the voxel's covered part [1/m3].
    voxel_x, voxel_y, layer, square_x, square_y : (n,) int64
        Places of the points.
    across, along : (n,) float64
        From the centres of their squares [-0.5..0.5].
    squares : float
        Squares whose beamlets tell what is over one of them.
    prior : float
        Beamlets that the voxel's mean is worth [count].
    density : (n,) float64
        Written [1/m3].
    """
    nx, ny = beamlets.shape[:2]
    for p in range(len(layer)):
        x, y, z = square_x[p], square_y[p], layer[p]
        if not near[x, y, z]:
            density[p] = 0.0
            continue
        i = min(max(x + (1 if across[p] > 0.0 else -1), 0), nx - 1)
        j = min(max(y + (1 if along[p] > 0.0 else -1), 0), ny - 1)
        right, up = abs(across[p]), abs(along[p])
        own = (1.0 - right) * beamlets[x, y, z] + right * beamlets[i, y, z]
        beside = (1.0 - right) * beamlets[x, j, z] + right * beamlets[i, j, z]
        count = (1.0 - up) * own + up * beside
        known = squares * count
        mean = usual[voxel_x[p], voxel_y[p], z]
        found = known * count * each[voxel_x[p], voxel_y[p], z] + prior * mean
        density[p] = found / (known + prior)
