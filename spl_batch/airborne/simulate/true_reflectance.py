"""Reflectance of what a scene shows from straight above."""

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.simulate.scene.beam_layers import cell_range, nearest_node
from spl_batch.airborne.simulate.scene.ray_trace import (
    KIND_BOTTOM,
    KIND_OTHER,
    SceneArrays,
    bilinear,
    clip_convex,
)
from spl_batch.numerics.compiled import njit

ABOVE_M = 1e4
"""Height to look from [m]."""


@njit()
def top_reflectance(scene: SceneArrays, x: float, y: float) -> float:
    """Reflectance of the highest of ground, water, roofs and crown envelopes.

    Wires, towers and poles are no surface; gaps of crowns are closed; of clear water it is
    the surface's.

    Parameters
    ----------
    x, y : float
        Place [m].
    """
    top = bilinear(scene.ground_z, scene.grid, x, y)[0]
    rho = bilinear(scene.ground_rho, scene.grid, x, y)[0]
    j, i = nearest_node(scene, x, y)
    if scene.ground_kind[j, i] == KIND_BOTTOM:
        pond = scene.ground_pond[j, i]
        if scene.pond[pond, 0] > top:
            top, rho = scene.pond[pond, 0], scene.pond[pond, 2]
    origin, down = np.array([x, y, ABOVE_M]), np.array([0.0, 0.0, -1.0])
    solids, crowns = len(scene.solid), len(scene.crown)
    first, last = cell_range(scene, x, y)
    for entry in range(first, last):
        item = scene.cell_item[entry]
        height, bright = -np.inf, 0.0
        if item < solids:
            if scene.solid[item, 2] == KIND_OTHER:
                continue
            enter, leave, _ = clip_convex(scene.planes[item], scene.faces[item], origin, down)
            if leave > enter:
                height, bright = ABOVE_M - enter, scene.solid[item, 1]
        elif item < solids + crowns:
            crown = scene.crown[item - solids]
            dx, dy = (x - crown[0]) / crown[3], (y - crown[1]) / crown[3]
            inside = 1 - dx * dx - dy * dy
            if inside > 0:
                height, bright = crown[2] + crown[4] * np.sqrt(inside), crown[6]
        if height > top:
            top, rho = height, bright
    return float(rho)


@njit()
def mean_reflectance(
    scene: SceneArrays,
    west: float,
    north: float,
    cell_m: float,
    samples: int,
    out: NDArray[np.float64],
) -> None:
    """Mean of :func:`top_reflectance` over raster cells.

    Parameters
    ----------
    west, north : float
        Upper left corner of the raster [m].
    samples : int
        Places along one side of a cell.
    out : (rows, cols) float64
        Filled; row 0 northernmost.
    """
    step = cell_m / samples
    for row in range(out.shape[0]):
        for col in range(out.shape[1]):
            total = 0.0
            for k in range(samples * samples):
                x = west + col * cell_m + (k % samples + 0.5) * step
                y = north - row * cell_m - (k // samples + 0.5) * step
                total += top_reflectance(scene, x, y)
            out[row, col] = total / (samples * samples)
