"""A scene from straight above: heights and reflectance of surfaces, and linear-mode returns."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.simulate.scene.beam_layers import cell_range, look, nearest_node
from spl_batch.airborne.simulate.scene.ray_trace import (
    KIND_BOTTOM,
    KIND_OTHER,
    KIND_WATER,
    SceneArrays,
    bilinear,
    clip_convex,
)
from spl_batch.numerics.compiled import njit

ABOVE_M: Final = 1e4
"""Height to look from [m]."""

SEE_THROUGH: Final = 0.15
"""Share of a pulse that must be left for the hard surface to be recorded."""

WIRE_SHARE: Final = 0.02
"""Share of a pulse that a wire must catch to be recorded."""


@njit()
def surfaces_at(
    scene: SceneArrays, x: NDArray[np.float64], y: NDArray[np.float64], out: NDArray[np.float64]
) -> None:
    """Heights of bare ground and highest surface [m], and its reflectance: fills ``out`` (3, n).

    Surfaces are ground, roofs and crown envelopes, and of water its own. Wires, towers and poles
    are none; gaps of crowns are closed.
    """
    for p in range(len(x)):
        out[0, p], out[1, p], out[2, p] = _surface_at(scene, x[p], y[p])


@njit()
def _surface_at(scene: SceneArrays, x: float, y: float) -> tuple[float, float, float]:
    ground = bilinear(scene.ground.z, scene.ground.grid, x, y)[0]
    rho = bilinear(scene.ground.rho, scene.ground.grid, x, y)[0]
    j, i = nearest_node(scene, x, y)
    if scene.ground.kind[j, i] == KIND_BOTTOM:
        pond = scene.ground.ponds[scene.ground.pond_at[j, i]]
        if pond[0] > ground:
            ground, rho = pond[0], pond[2]
    top = ground
    origin, down = np.array([x, y, ABOVE_M]), np.array([0.0, 0.0, -1.0])
    solids, crowns = len(scene.solid), len(scene.crown)
    first, last = cell_range(scene, x, y)
    for entry in range(first, last):
        item = scene.cell_item[entry]
        height, bright = -np.inf, 0.0
        if item < solids:
            if scene.solid[item, 2] == KIND_OTHER:
                continue
            enter, leave, _ = clip_convex(scene.planes[item], origin, down)
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
    return ground, top, rho


@njit()
def linear_returns(
    rng: np.random.Generator,
    scene: SceneArrays,
    xy: NDArray[np.float64],
    above_m: float,
    spot_m: float,
    layers: NDArray[np.float64],
    z: NDArray[np.float64],
    kind: NDArray[np.uint8],
) -> None:
    """Up to two returns of each vertical pulse: one of a layer, one of the hard surface.

    The pulse is infrared: the surface of water is as far as it gets. Pulses go down at ``xy``
    (n, 2). ``z`` and ``kind``, (n, 2) each, are filled with heights [m], NaN where there is no
    return, and with what gave them.
    """
    origin, down = np.empty(3), np.array([0.0, 0.0, -1.0])
    for p in range(len(xy)):
        origin[0], origin[1], origin[2] = xy[p, 0], xy[p, 1], above_m
        n, hard, _, _, hard_kind = look(scene, origin, down, down, spot_m / above_m, layers)
        z[p, 0] = np.nan
        left = 1.0
        for k in range(n):
            if layers[k, 4] == KIND_WATER:
                hard, hard_kind = layers[k, 0], layers[k, 4]
                break
            share = layers[k, 2]
            thin = layers[k, 1] == layers[k, 0]
            seen = share > WIRE_SHARE if thin else rng.random() < share
            if seen and np.isnan(z[p, 0]):
                at = layers[k, 0]
                if not thin:
                    at += np.log(1 - rng.random() * share) / np.log(1 - share) * (layers[k, 1] - at)
                z[p, 0] = above_m - at
                kind[p, 0] = int(layers[k, 4])
            left *= 1 - share
        z[p, 1] = above_m - hard if left > SEE_THROUGH else np.nan
        kind[p, 1] = int(hard_kind)
