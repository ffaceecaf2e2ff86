"""A scene seen from straight above: linear-mode returns, and heights of surfaces."""

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

SEE_THROUGH = 0.15
"""Share of a pulse that must be left for the hard surface to be recorded."""

WIRE_SHARE = 0.02
"""Share of a pulse that a wire must catch to be recorded."""


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

    The pulse is infrared: the surface of water is as far as it gets.

    Parameters
    ----------
    xy : (n, 2) float64
        Places of the pulses [m].
    layers : (k, 5) float64
        Room for :func:`~spl_batch.airborne.simulate.scene.beam_layers.look`.
    z : (n, 2) float64
        Filled with heights [m]; NaN where there is no return.
    kind : (n, 2) uint8
        Filled with what gave them.
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


@njit()
def surface_heights(
    scene: SceneArrays,
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    ground: NDArray[np.float64],
    surface: NDArray[np.float64],
) -> None:
    """Bare ground, and the highest of ground, roofs and crown envelopes, at places.

    Of water it is the surface. Wires, towers and poles are no surface; gaps of crowns are closed.

    Parameters
    ----------
    x, y : (n,) float64
        Places [m].
    ground, surface : (n,) float64
        Filled [m].
    """
    origin, down = np.zeros(3), np.array([0.0, 0.0, -1.0])
    solids, crowns = len(scene.solid), len(scene.crown)
    for p in range(len(x)):
        ground[p] = bilinear(scene.ground_z, scene.grid, x[p], y[p])[0]
        j, i = nearest_node(scene, x[p], y[p])
        if scene.ground_kind[j, i] == KIND_BOTTOM:
            ground[p] = max(ground[p], scene.pond[scene.ground_pond[j, i], 0])
        top = ground[p]
        origin[0], origin[1], origin[2] = x[p], y[p], 1e4
        first, last = cell_range(scene, x[p], y[p])
        for entry in range(first, last):
            item = scene.cell_item[entry]
            if item < solids:
                if scene.solid[item, 2] == KIND_OTHER:
                    continue
                enter, leave, _ = clip_convex(scene.planes[item], scene.faces[item], origin, down)
                if leave > enter:
                    top = max(top, 1e4 - enter)
            elif item < solids + crowns:
                crown = scene.crown[item - solids]
                dx, dy = (x[p] - crown[0]) / crown[3], (y[p] - crown[1]) / crown[3]
                inside = 1 - dx * dx - dy * dy
                if inside > 0:
                    top = max(top, crown[2] + crown[4] * np.sqrt(inside))
        surface[p] = top
