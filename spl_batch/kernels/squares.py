"""Noise at points from what beamlets over squares stand for."""

from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

CHANCE: Final = 2.0
"""Standard errors that beamlets may fall short by chance."""


@njit(nogil=True, cache=True)
def density_between(
    beamlets: NDArray[np.float64],
    near: NDArray[np.bool_],
    each: NDArray[np.float64],
    usual: NDArray[np.float64],
    mean: NDArray[np.float64],
    voxel_x: NDArray[np.int64],
    voxel_y: NDArray[np.int64],
    layer: NDArray[np.int64],
    square_x: NDArray[np.int64],
    square_y: NDArray[np.int64],
    across: NDArray[np.float64],
    along: NDArray[np.float64],
    up: NDArray[np.float64],
    squares: float,
    prior: float,
    alike: float,
    rim: NDArray[np.bool_],
    density: NDArray[np.float64],
    partly: NDArray[np.bool_],
) -> None:
    """Density at points by the beamlets around, linear between the centres of eight squares.

    What b beamlets over ``squares`` squares say, b ``each``, counts as ``squares`` b, and the
    voxel's ``usual`` density as ``prior`` beamlets do, as fewer where beamlets fall short of it by
    more than chance lets them: the mean of a voxel tells little of the foot of a slope in it. Tops
    are not believed as soon, as chance makes some. The layer above or below tells where beamlets
    are and not how many: where it has many more or fewer, a gate ends, and its counts are brought
    to the mean of the point's own layer.

    Parameters
    ----------
    beamlets : (nx, ny, nz) float64
        Beamlets over a square, of its covered part [count]; 0 where that is not known.
    near : (nx, ny, nz) bool
        Squares where the density is not nothing.
    each : (vx, vy, nz) float64
        What one of them stands for, by voxel [1/m3].
    usual : (vx, vy, nz) float64
        Mean density of the voxel's covered part [1/m3].
    mean : (vx, vy, nz) float64
        Beamlets over a covered square around the voxel [count].
    voxel_x, voxel_y, layer, square_x, square_y : (n,) int64
        Places of the points.
    across, along, up : (n,) float64
        From the centres of their squares, in squares, and layers, in layers [-0.5..0.5].
    squares : float
        Squares whose beamlets tell what is over one of them.
    prior : float
        Beamlets that the mean of an even voxel is worth [count].
    alike : float
        Means of layers that differ by less have no gate's end between them [ratio].
    rim : (nx, ny, nz) bool
        Squares that are marked.
    density : (n,) float64
        Written [1/m3].
    partly : (n,) bool
        Written: points over such squares.
    """
    nx, ny, nz = beamlets.shape
    for p in range(len(layer)):
        # Unsigned indices: a signed one costs numba a test for wrapping.
        x, y, z = np.uint64(square_x[p]), np.uint64(square_y[p]), np.uint64(layer[p])
        partly[p] = rim[x, y, z]
        if not near[x, y, z]:
            density[p] = 0.0
            continue
        vx, vy = np.uint64(voxel_x[p]), np.uint64(voxel_y[p])
        beside, part, ratio = layer[p] + (1 if up[p] > 0.0 else -1), abs(up[p]), 1.0
        k = z
        if 0 <= beside < nz and mean[vx, vy, np.uint64(beside)] > 0.0:
            k = np.uint64(beside)
            ratio = mean[vx, vy, z] / mean[vx, vy, k]
            if ratio < alike and ratio * alike > 1.0:
                ratio = 1.0
        i = np.uint64(min(max(square_x[p] + (1 if across[p] > 0.0 else -1), 0), nx - 1))
        j = np.uint64(min(max(square_y[p] + (1 if along[p] > 0.0 else -1), 0), ny - 1))
        right, ahead = abs(across[p]), abs(along[p])
        own = (1.0 - right) * _between(beamlets, x, y, z, k, part, ratio)
        own += right * _between(beamlets, i, y, z, k, part, ratio)
        other = (1.0 - right) * _between(beamlets, x, j, z, k, part, ratio)
        other += right * _between(beamlets, i, j, z, k, part, ratio)
        count = (1.0 - ahead) * own + ahead * other
        known, told, around = squares * count, count * each[vx, vy, z], usual[vx, vy, z]
        worth = prior
        if known > 0.0 and told < around:
            short = (1.0 - told / around) ** 2 - CHANCE**2 / known
            worth = prior / (1.0 + prior * max(short, 0.0))
        density[p] = (known * told + worth * around) / (known + worth)


@njit(nogil=True, cache=True, inline="always")
def _between(beamlets, x, y, z, k, part, ratio):  # type: ignore[no-untyped-def]
    """Beamlets over a square, between its layer and another one."""
    own, other = beamlets[x, y, z], beamlets[x, y, k]
    if own <= 0.0 or other <= 0.0:
        return own
    return (1.0 - part) * own + part * ratio * other
