"""What a beam meets on its way down: semi-transparent layers, then one hard surface.

From straight above: heights and reflectance of surfaces, and linear-mode returns.
"""

import math
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.simulate.scene.ray_trace import (
    KIND_BOTTOM,
    KIND_OTHER,
    KIND_VEGETATION,
    KIND_WATER,
    KIND_WIRE,
    SceneArrays,
    bilinear,
    clip_convex,
    clip_crown,
    lit_share,
    meet_ground,
    meet_wire,
)
from spl_batch.numerics.compiled import njit

LAYER_FIELDS = 5
"""Columns of a layer: enter, leave [m], share intercepted, reflectance, kind."""

ABOVE_M: Final = 1e4
"""Height to look from [m]."""


@njit()
def nearest_node(scene: SceneArrays, x: float, y: float) -> tuple[int, int]:
    """Row and column of the ground node nearest to a place."""
    i = min(
        max(round((x - scene.ground.grid[0]) / scene.ground.grid[2]), 0),
        scene.ground.z.shape[1] - 1,
    )
    j = min(
        max(round((y - scene.ground.grid[1]) / scene.ground.grid[2]), 0),
        scene.ground.z.shape[0] - 1,
    )
    return j, i


@njit()
def _add_water(
    layers: NDArray[np.float64], n: int, pond: NDArray[np.float64], o: Any, d: Any, hard: float
) -> int:
    """Clear water over a bottom: a thin surface, then a column that only attenuates.

    Rays go straight on and light is not slowed down: depths are apparent, as in files without a
    correction for refraction. Both ways are attenuated.
    """
    top = (pond[0] - o[2]) / d[2]
    if top >= hard:
        return n
    rho = pond[2] / pond[3]
    n = _insert(layers, n, top, top, pond[3], rho, float(KIND_WATER))
    share = 1.0 - math.exp(-2.0 * pond[1] * (hard - top))
    return _insert(layers, n, top, hard, share, 0.0, float(KIND_WATER))


@njit()
def cell_range(scene: SceneArrays, x: float, y: float) -> tuple[int, int]:
    """First and last entry (exclusive) of the objects listed for a place."""
    i = math.floor((x - scene.cell[0]) / scene.cell[2])
    j = math.floor((y - scene.cell[1]) / scene.cell[2])
    rows, columns = scene.cell_first.shape
    if i < 0 or j < 0 or i >= columns - 1 or j >= rows:
        return 0, 0
    return scene.cell_first[j, i], scene.cell_first[j, i + 1]


@njit()
def _add_turbid(
    layers: NDArray[np.float64],
    n: int,
    span: tuple[float, float],
    extinction: float,
    rho: float,
    kind: float,
) -> int:
    if span[1] <= span[0]:
        return n
    share = 1.0 - math.exp(-extinction * (span[1] - span[0]))
    return _insert(layers, n, span[0], span[1], share, rho, kind)


@njit()
def _insert(
    layers: NDArray[np.float64],
    n: int,
    enter: float,
    leave: float,
    share: float,
    rho: float,
    kind: float,
) -> int:
    """Put a layer in its place by range; the number of layers afterwards."""
    k = n
    while k > 0 and layers[k - 1, 0] > enter:
        layers[k] = layers[k - 1]
        k -= 1
    layers[k, 0] = enter
    layers[k, 1] = leave
    layers[k, 2] = share
    layers[k, 3] = rho
    layers[k, 4] = kind
    return n + 1


@njit()
def look(
    scene: SceneArrays, o: Any, d: Any, axis: Any, sigma_rad: float, layers: NDArray[np.float64]
) -> tuple[int, float, float, float, float]:
    """Everything that a beam meets: layers by range, and the hard surface behind them.

    ``o`` and ``d`` are origin and direction of the photon's path, ``axis`` the beam's axis, about
    which it spreads: wires take their share of the whole beam. ``layers`` is filled with enter,
    leave, intercepted share, reflectance and kind of each. Returned are the number of layers, and
    range [m], cosine of incidence, reflectance and kind of the hard surface.
    """
    hard, cosine = meet_ground(scene.ground, o, d)
    x, y = o[0] + hard * d[0], o[1] + hard * d[1]
    rho = bilinear(scene.ground.rho, scene.ground.grid, x, y)[0]
    j, i = nearest_node(scene, x, y)
    kind = float(scene.ground.kind[j, i])
    first, last = cell_range(scene, x, y)
    solids, crowns = len(scene.solid), len(scene.crown)
    # Entries ascend, and opaque solids have the lowest numbers: `hard` is final before a layer is
    # cut at it.
    n = 0
    for entry in range(first, last):
        item = scene.cell_item[entry]
        if item < solids:
            enter, leave, face = clip_convex(scene.planes[item], o, d)
            if leave <= enter or enter >= hard:
                continue
            row = scene.solid[item]
            if row[0] > 0.0:
                span = (enter, min(leave, hard))
                n = _add_turbid(layers, n, span, row[0], row[1], row[2])
            elif face >= 0:
                normal = scene.planes[item, face]
                hard = enter
                cosine = -(normal[0] * d[0] + normal[1] * d[1] + normal[2] * d[2])
                rho = row[1]
                kind = row[2] if normal[2] > 0.1 else row[3]
        elif item < solids + crowns:
            crown = scene.crown[item - solids]
            enter, leave = clip_crown(crown, o, d)
            span = (enter, min(leave, hard))
            n = _add_turbid(layers, n, span, crown[5], crown[6], float(KIND_VEGETATION))
        else:
            wire = scene.wire[item - solids - crowns]
            at, distance = meet_wire(wire, o, axis)
            sigma = sigma_rad * at
            if distance < wire[8] + 4.0 * sigma:
                share = lit_share(distance, wire[8], sigma)
                n = _insert(layers, n, at, at, share, wire[9], float(KIND_WIRE))
    while n > 0 and layers[n - 1, 0] >= hard:
        n -= 1
    if kind == KIND_BOTTOM:
        n = _add_water(layers, n, scene.ground.ponds[scene.ground.pond_at[j, i]], o, d, hard)
    return n, hard, cosine, rho, kind


@njit()
def layer_room(scene: SceneArrays) -> int:
    """Most objects listed for one cell, one more, and a water's surface and column."""
    return 3 + int((scene.cell_first[:, 1:] - scene.cell_first[:, :-1]).max())


@njit()
def empty_layers(scene: SceneArrays) -> NDArray[np.float64]:
    """Room for the layers of one beam."""
    return np.empty((layer_room(scene), LAYER_FIELDS))


@njit()
def surfaces_at(
    scene: SceneArrays, x: NDArray[np.float64], y: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Heights of bare ground and highest surface [m], and its reflectance: (3, n) float64.

    Surfaces are ground, roofs and crown envelopes, and of water its own. Wires, towers and poles
    are none; gaps of crowns are closed.
    """
    out = np.empty((3, len(x)))
    for p in range(len(x)):
        out[0, p], out[1, p], out[2, p] = _surface_at(scene, x[p], y[p])
    return out


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
    seen_through: float,
    seen_wire: float,
) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
    """Up to two returns of each vertical pulse: one of a layer, one of the hard surface.

    The pulse is infrared: the surface of water is as far as it gets. Pulses go down at ``xy``
    (n, 2). ``seen_through, seen_wire``: shares of a pulse at which the hard surface and a wire are
    recorded, 0..1. Heights [m], NaN where there is no return, and what gave them: (n, 2) each.
    """
    z, kind, layers = np.empty(xy.shape), np.zeros(xy.shape, np.uint8), empty_layers(scene)
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
            seen = share > seen_wire if thin else rng.random() < share
            if seen and np.isnan(z[p, 0]):
                at = layers[k, 0]
                if not thin:
                    at += np.log(1 - rng.random() * share) / np.log(1 - share) * (layers[k, 1] - at)
                z[p, 0] = above_m - at
                kind[p, 0] = int(layers[k, 4])
            left *= 1 - share
        z[p, 1] = above_m - hard if left > seen_through else np.nan
        kind[p, 1] = int(hard_kind)
    return z, kind
