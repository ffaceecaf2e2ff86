"""Noise at points from what beamlets over squares stand for, and how beams lean by those."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.numerics.compiled import njit

CHANCE: Final = 3.0
"""Part of the relative variance of a density by chance that is added to it: where it is too small
more noise is kept than is lost where it is as much too large."""

MOST: Final = 0.05
"""Part of the density that is added for chance at most."""


@njit(nogil=True, cache=True)
def density_between(
    beamlets: NDArray[np.float64],
    there: NDArray[np.float32],
    near: NDArray[np.bool_],
    each: NDArray[np.float64],
    usual: NDArray[np.float64],
    worth: NDArray[np.float64],
    lean: NDArray[np.float64],
    voxel_x: NDArray[np.int64],
    voxel_y: NDArray[np.int64],
    layer: NDArray[np.int64],
    square_x: NDArray[np.int64],
    square_y: NDArray[np.int64],
    across: NDArray[np.float64],
    along: NDArray[np.float64],
    up: NDArray[np.float64],
    squares: float,
    edge: NDArray[np.float32],
    density: NDArray[np.float64],
    part: NDArray[np.float64],
    sharp: NDArray[np.float32],
) -> None:
    """Density at points by the beamlets around, linear between the centres of four squares.

    They are those around the place where a beam through the point crosses the middle of its layer.
    What b beamlets over ``squares`` squares say, b ``each``, counts as ``squares`` b, and the
    voxel's ``usual`` density as ``worth`` beamlets do.

    Parameters
    ----------
    beamlets : (nx, ny, nz) float64
        Beamlets over a square, of its covered part [count]; 0 where that is not known.
    there : (nx, ny, nz) float32
        Beamlets over it, whatever is covered [count].
    near : (nx, ny, nz) bool
        Squares where the density is not nothing.
    each : (vx, vy, nz) float64
        What one of them stands for, by voxel [1/m3].
    usual : (vx, vy, nz) float64
        Mean density of the voxel's covered part [1/m3].
    worth : (vx, vy, nz) float64
        Beamlets that it is worth [count].
    lean : (2, vx, vy, nz) float64
        How far beams lean along x and y from a layer to the next one upwards [squares].
    voxel_x, voxel_y, layer, square_x, square_y : (n,) int64
        Places of the points.
    across, along, up : (n,) float64
        From the centres of their squares, in squares, and layers, in layers [-0.5..0.5].
    squares : float
        Squares whose beamlets tell what is over one of them.
    edge : (nx, ny, nz) float32
        What is known of squares near an edge; negative for others.
    density : (n,) float64
        Written [1/m3].
    part : (n,) float64
        Written: part of the density that the beamlets over squares near an edge leave, whatever is
        covered; 1 elsewhere.
    sharp : (n,) float32
        Written: what is known of the edge; negative elsewhere.
    """
    nx, ny, _ = beamlets.shape
    for p in range(len(layer)):
        # Unsigned indices: a signed one costs numba a test for wrapping.
        vx, vy, z = np.uint64(voxel_x[p]), np.uint64(voxel_y[p]), np.uint64(layer[p])
        right = across[p] - lean[0, vx, vy, z] * up[p]
        ahead = along[p] - lean[1, vx, vy, z] * up[p]
        x = np.uint64(_within(square_x[p] + np.floor(right + 0.5), nx))
        y = np.uint64(_within(square_y[p] + np.floor(ahead + 0.5), ny))
        part[p], sharp[p] = 1.0, edge[x, y, z]
        if not near[x, y, z]:
            density[p] = 0.0
            continue
        west, south = np.floor(right), np.floor(ahead)
        right, ahead = right - west, ahead - south
        i = np.uint64(_within(square_x[p] + west, nx))
        j = np.uint64(_within(square_y[p] + south, ny))
        # the next one, or at the end of the box the same
        e = np.uint64(_within(square_x[p] + west + 1.0, nx))
        n = np.uint64(_within(square_y[p] + south + 1.0, ny))
        count = _between(beamlets, i, e, j, n, z, right, ahead)
        if sharp[p] >= 0.0 and count > 0.0:
            part[p] = min(_between(there, i, e, j, n, z, right, ahead) / count, 1.0)
        known, mean = squares * count, worth[vx, vy, z]
        told = known * count * each[vx, vy, z]
        sure = known + mean
        chance = min(CHANCE * known / (sure * sure), MOST) if known > 0.0 else 0.0
        density[p] = (told + mean * usual[vx, vy, z]) / sure * (1.0 + chance)


@njit(nogil=True, cache=True, inline="always")
def _within(at, size):  # type: ignore[no-untyped-def]
    """Nearest index that there is."""
    return min(max(np.int64(at), 0), size - 1)


@njit(nogil=True, cache=True, inline="always")
def _between(values, i, e, j, n, z, right, ahead):  # type: ignore[no-untyped-def]
    """Linear between four squares of a layer."""
    south = (1.0 - right) * values[i, j, z] + right * values[e, j, z]
    north = (1.0 - right) * values[i, n, z] + right * values[e, n, z]
    return (1.0 - ahead) * south + ahead * north


@njit(nogil=True, cache=True)
def slopes_and_steps(beamlets: NDArray[np.float32], out: NDArray[np.float64]) -> None:
    """Products of slopes and steps, summed over the squares of each voxel, by pairs of layers.

    A slope is that from one neighbour to the other, two squares farther, so a step that is
    compared with it is the mean of as wide a strip.

    Parameters
    ----------
    beamlets : (4 vx, 4 vy, nz) float32
        Beamlets over squares, smoothed [count].
    out : (5, vx, vy, nz - 1) float64
        Written: x slope squared, x slope times y slope, y slope squared, x slope times step, y
        slope times step. Slopes are those of the mean of a layer and the next one per square, the
        step is from the lower one to the upper one.
    """
    nx, ny, nz = beamlets.shape
    out[:] = 0.0
    for x in range(1, nx - 1):
        for y in range(1, ny - 1):
            i, j = x // 4, y // 4
            for z in range(nz - 1):
                east = beamlets[x + 1, y, z + 1], beamlets[x + 1, y, z]
                west = beamlets[x - 1, y, z + 1], beamlets[x - 1, y, z]
                north = beamlets[x, y + 1, z + 1], beamlets[x, y + 1, z]
                south = beamlets[x, y - 1, z + 1], beamlets[x, y - 1, z]
                slope_x = 0.25 * (east[0] - west[0] + east[1] - west[1])
                slope_y = 0.25 * (north[0] - south[0] + north[1] - south[1])
                step = 0.5 * (beamlets[x, y, z + 1] - beamlets[x, y, z])
                step_x = step + 0.25 * (east[0] - east[1] + west[0] - west[1])
                step_y = step + 0.25 * (north[0] - north[1] + south[0] - south[1])
                out[0, i, j, z] += slope_x * slope_x
                out[1, i, j, z] += slope_x * slope_y
                out[2, i, j, z] += slope_y * slope_y
                out[3, i, j, z] += slope_x * step_x
                out[4, i, j, z] += slope_y * step_y
