"""True noise density: what beamlets expect of background, spread over voxels."""

import math
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.simulate.haze import Air, layer_strength, patch_strength, reach
from spl_batch.numerics.compiled import njit

NOISE_SAMPLES: Final = 6
"""Samples along the gate at which a beamlet adds to the true noise density."""

LAYER_SAMPLES: Final = 4
"""Samples within a layer of haze at which it does."""


class NoiseGrid(NamedTuple):
    """Voxels that collect the expected background."""

    amount: NDArray[np.float64]  #: (nx, ny, nz): expected background points [count].
    #: (3,): lower corner, relative to the scene's origin [m]; z is a height.
    corner: NDArray[np.float64]
    voxel_m: float


@njit()
def _put(grid: NoiseGrid, x: float, y: float, z: float, expected: float) -> None:
    """Add to the voxel at a location, if the grid has it."""
    nx, ny, nz = grid.amount.shape
    i = math.floor((x - grid.corner[0]) / grid.voxel_m)
    j = math.floor((y - grid.corner[1]) / grid.voxel_m)
    k = math.floor((z - grid.corner[2]) / grid.voxel_m)
    if 0 <= i < nx and 0 <= j < ny and 0 <= k < nz:
        grid.amount[i, j, k] += expected


@njit()
def deposit(
    grid: NoiseGrid, origin: Any, axis: Any, start: float, stop: float, expected: float, fall: float
) -> None:
    """Spread a beamlet's expected background over the voxels that it crosses."""
    step = (stop - start) / NOISE_SAMPLES
    # A start that wanders with the beamlet fills the gaps between the samples.
    at = start + step * (abs(axis[0] * 1e6 + axis[1] * 1.618e6) % 1.0)
    for _ in range(NOISE_SAMPLES):
        share = 1.0 + fall * (1.0 - 2.0 * (at - start) / (stop - start))
        x, y, z = origin[0] + at * axis[0], origin[1] + at * axis[1], origin[2] + at * axis[2]
        _put(grid, x, y, z, expected / NOISE_SAMPLES * share)
        at += step


@njit()
def deposit_air(
    grid: NoiseGrid, air: Air, gain: float, time_s: float, ray: Any, span: tuple[float, float]
) -> None:
    """Spread what a beamlet expects from layers of haze over the voxels of the true noise density.

    Fog is left out: it is thinner than a voxel. ``air`` to ``span``: as for
    :func:`~spl_batch.airborne.simulate.haze.add_air`.
    """
    origin, axis = ray
    for k in range(len(air.layers)):
        layer = air.layers[k]
        start, stop = reach(layer, origin, axis, span)
        if stop <= start:
            continue
        for s in range(LAYER_SAMPLES):
            at = start + (s + 0.5) / LAYER_SAMPLES * (stop - start)
            x, y, z = origin[0] + at * axis[0], origin[1] + at * axis[1], origin[2] + at * axis[2]
            share = layer_strength(layer, z) * patch_strength(layer, air.waves[k], x, y, time_s)
            _put(grid, x, y, z, gain * layer[3] * share * (stop - start) / LAYER_SAMPLES)
