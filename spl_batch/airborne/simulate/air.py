r"""Light that air sends back, and the true noise density: haze in layers with patches, and fog.

Returns of a layer are a Poisson process along each beamlet [W17 Eq. 2.6] of the rate

.. math:: \lambda(x, y, z, t) = \lambda_0 \, p(x - v t) \, h(z)

The patches p are a random field between 0 and 1, with waves about ``patch_m`` long that the wind v
carries along. The edges of the layer h fall off linearly over ``edge_m``, fog exponentially with
the height above the ground. Nothing comes from behind a hard surface, and air does not weaken what
lies behind it. [W17] has no such air.
"""

import math
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm

from spl_batch.airborne.simulate.detector import NO_PARENT, add_event
from spl_batch.airborne.simulate.scene.ray_trace import KIND_BACKGROUND, SceneArrays, bilinear
from spl_batch.airborne.simulate.scene.scene_file import Scene
from spl_batch.numerics.compiled import njit

WAVES: Final = 16
"""Plane waves that make up the patches of a layer."""

RIM: Final = 0.5
"""Over so much of the field's spread a patch fades."""

FOG_DEPTH: Final = 8.0
"""Scales above the ground at which fog ends."""

NOISE_SAMPLES: Final = 6
"""Samples along the gate at which a beamlet adds to the true noise density."""

LAYER_SAMPLES: Final = 4
"""Samples within a layer of haze at which it does."""

VOXEL_M: Final = 10.0
"""Edge of the voxels of the true noise density [m]."""


class Air(NamedTuple):
    """Layers, as numbers for the kernels."""

    #: (k, 8): base, top and width of the edge as heights [m]; rate at full strength [1/m];
    #: threshold of the patches; wind east and north [m/s]; scale height of fog on the ground, which
    #: has nothing else but a rate, 0 for haze [m].
    layers: NDArray[np.float64]
    #: (k, WAVES, 3): wave numbers east and north [rad/m] and phases [rad].
    waves: NDArray[np.float64]
    gate_fall: float  #: Background at the start of the gate less that at its end, over their sum.


class NoiseGrid(NamedTuple):
    """Voxels that collect the expected background."""

    amount: NDArray[np.float64]  #: (nx, ny, nz): expected background points [count].
    #: (3,): lower corner, relative to the scene's origin [m]; z is a height.
    corner: NDArray[np.float64]


def make_air(scene: Scene, noise_per_m: float) -> Air:
    """Air of a scene, whose strengths are relative to a channel's mean background [1/m]."""
    ground, sky = scene.origin_m[2], scene.sky
    layers = np.zeros((len(sky.haze) + len(sky.fog), 8))
    waves = np.zeros((len(layers), WAVES, 3))
    for k, haze in enumerate(sky.haze):
        rng = scene.chance(5, k)
        threshold = float(norm.isf(haze.cover)) if haze.cover < 1 else -math.inf
        layers[k, :7] = (
            ground + haze.base_m, ground + haze.top_m, haze.edge_m,
            haze.times_noise * noise_per_m, threshold, *haze.drift_m_s,
        )  # fmt: skip
        length = 2 * np.pi / haze.patch_m * rng.uniform(0.3, 1.0, WAVES)
        turn = rng.uniform(0, 2 * np.pi, WAVES)
        waves[k] = np.column_stack(
            [length * np.cos(turn), length * np.sin(turn), rng.uniform(0, 2 * np.pi, WAVES)]
        )
    for k, fog in enumerate(sky.fog, start=len(sky.haze)):
        layers[k, 3], layers[k, 7] = fog.times_noise * noise_per_m, fog.scale_m
    return Air(layers, waves, sky.gate_fall)


def empty_grid(scene: Scene) -> NoiseGrid:
    """Voxels on the absolute lattice over the extent, as high as the gates reach."""
    gate = max(map(scene.gate_of, scene.flights))
    # 20 m more than the gate, for relief and for what the aircraft's wobble does to ranges
    low = np.array([*scene.origin_m[:2], scene.origin_m[2] - gate - 20])
    high = low + np.array([*scene.extent_m, 2 * gate + 40])
    first, last = np.floor(low / VOXEL_M), np.ceil(high / VOXEL_M)
    corner = first * VOXEL_M - np.array([*scene.origin_m[:2], 0.0])
    return NoiseGrid(np.zeros(tuple((last - first).astype(int))), corner)


@njit()
def patch_strength(layer: Any, waves: Any, x: float, y: float, time_s: float) -> float:
    """How much of a layer's full strength a place has, 0..1."""
    if layer[4] == -np.inf:
        return 1.0
    east, north, total = x - layer[5] * time_s, y - layer[6] * time_s, 0.0
    for w in range(len(waves)):
        total += math.cos(waves[w, 0] * east + waves[w, 1] * north + waves[w, 2])
    field = total * math.sqrt(2.0 / len(waves))
    return float(min(max((field - layer[4]) / RIM + 0.5, 0.0), 1.0))


@njit()
def _strength(scene, layer, waves, ray, at, time_s):  # type: ignore[no-untyped-def]
    """How much of a layer's full strength there is at a range, 0..1; negative below the ground."""
    origin, axis = ray
    x, y, z = origin[0] + at * axis[0], origin[1] + at * axis[1], origin[2] + at * axis[2]
    if layer[7] > 0.0:
        above = z - bilinear(scene.ground.z, scene.ground.grid, x, y)[0]
        return math.exp(-above / layer[7]) if above >= 0.0 else -1.0
    inside = min(z - layer[0], layer[1] - z) / max(layer[2], 1e-6)
    share = float(min(max(inside + 0.5, 0.0), 1.0))
    return share * patch_strength(layer, waves, x, y, time_s)


@njit()
def _reach(layer, ray, span):  # type: ignore[no-untyped-def]
    """Where a beamlet enters and leaves a layer with its edges [m]."""
    origin, axis = ray
    if layer[7] > 0.0:
        return max(span[0], span[1] + 2.0 * FOG_DEPTH * layer[7] / axis[2]), span[1]
    half = 0.5 * layer[2]
    enter = (layer[1] + half - origin[2]) / axis[2]
    leave = (layer[0] - half - origin[2]) / axis[2]
    return max(enter, span[0]), min(leave, span[1])


@njit()
def add_air(
    rng: np.random.Generator, scene: SceneArrays, air: Air, gain: float, time_s: float, ray: Any,
    span: tuple[float, float], ranges: NDArray[np.float64], facts: NDArray[np.int64], n: int,
) -> int:  # fmt: skip
    """Photo-electrons that layers send back along one beamlet, by thinning.

    ``time_s``: of the shot, since the scene's take-off; ``ray``: origin and axis of the beamlet;
    ``span``: start of the gate, and the hard surface or the gate's end [m]; the rest: events so
    far, as in :func:`~spl_batch.airborne.simulate.detector.add_event`.
    """
    for k in range(len(air.layers)):
        layer = air.layers[k]
        at, stop = _reach(layer, ray, span)
        rate = gain * layer[3]
        at -= math.log(1.0 - rng.random()) / rate
        while at < stop:
            share = _strength(scene, layer, air.waves[k], ray, at, time_s)
            if share >= 0.0 and rng.random() < share:
                n = add_event(ranges, facts, n, at, KIND_BACKGROUND, NO_PARENT, -1)
            at -= math.log(1.0 - rng.random()) / rate
    return n


@njit()
def _put(grid, ray, at, expected):  # type: ignore[no-untyped-def]
    """Add to the voxel at a range, if the grid has it."""
    origin, axis = ray
    nx, ny, nz = grid.amount.shape
    i = math.floor((origin[0] + at * axis[0] - grid.corner[0]) / VOXEL_M)
    j = math.floor((origin[1] + at * axis[1] - grid.corner[1]) / VOXEL_M)
    k = math.floor((origin[2] + at * axis[2] - grid.corner[2]) / VOXEL_M)
    if 0 <= i < nx and 0 <= j < ny and 0 <= k < nz:
        grid.amount[i, j, k] += expected


@njit()
def deposit(
    grid: NoiseGrid, scene: SceneArrays, air: Air, gain: float, time_s: float, ray: Any,
    gate: tuple[float, float], per_m: float, stop_m: float,
) -> None:  # fmt: skip
    """Spread what a beamlet expects of background over the voxels that it crosses.

    ``per_m``: its mean along the gate [1/m]; haze is met down to ``stop_m``. Fog is left out: it is
    thinner than a voxel.
    """
    start, stop = gate
    axis = ray[1]
    step, expected = (stop - start) / NOISE_SAMPLES, per_m * (stop - start)
    # A start that wanders with the beamlet fills the gaps between the samples.
    at = start + step * (abs(axis[0] * 1e6 + axis[1] * 1.618e6) % 1.0)
    for _ in range(NOISE_SAMPLES):
        share = 1.0 + air.gate_fall * (1.0 - 2.0 * (at - start) / (stop - start))
        _put(grid, ray, at, expected / NOISE_SAMPLES * share)
        at += step
    for k in range(len(air.layers)):
        layer = air.layers[k]
        enter, leave = _reach(layer, ray, (start, stop_m))
        if leave <= enter or layer[7] > 0.0:
            continue
        for s in range(LAYER_SAMPLES):
            at = enter + (s + 0.5) / LAYER_SAMPLES * (leave - enter)
            share = _strength(scene, layer, air.waves[k], ray, at, time_s)
            _put(grid, ray, at, gain * layer[3] * share * (leave - enter) / LAYER_SAMPLES)
