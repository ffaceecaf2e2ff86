r"""Light that air sends back: haze in layers with drifting patches, and fog on the ground.

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


class Air(NamedTuple):
    """Layers and fog, as numbers for the kernels."""

    #: (k, 7): base, top and width of the edge as heights [m]; rate at full strength [1/m];
    #: threshold of the patches; wind east and north [m/s].
    layers: NDArray[np.float64]
    #: (k, WAVES, 3): wave numbers east and north [rad/m] and phases [rad].
    waves: NDArray[np.float64]
    fog: NDArray[np.float64]  #: (f, 2): rate at the ground [1/m] and scale height [m].
    gate_fall: float  #: Background at the start of the gate less that at its end, over their sum.


def make_air(scene: Scene, noise_per_m: float) -> Air:
    """Air of a scene.

    ``noise_per_m``: mean background of a channel of gain 1, which strengths are relative to [1/m].
    """
    ground, sky = scene.origin_m[2], scene.sky
    layers, waves = np.empty((len(sky.haze), 7)), np.empty((len(sky.haze), WAVES, 3))
    for k, haze in enumerate(sky.haze):
        rng = np.random.default_rng(np.random.SeedSequence(scene.seed, spawn_key=(5, k)))
        threshold = float(norm.isf(haze.cover)) if haze.cover < 1 else -math.inf
        layers[k] = (
            ground + haze.base_m, ground + haze.top_m, haze.edge_m,
            haze.times_noise * noise_per_m, threshold, *haze.drift_m_s,
        )  # fmt: skip
        length = 2 * np.pi / haze.patch_m * rng.uniform(0.3, 1.0, WAVES)
        turn = rng.uniform(0, 2 * np.pi, WAVES)
        waves[k] = np.column_stack(
            [length * np.cos(turn), length * np.sin(turn), rng.uniform(0, 2 * np.pi, WAVES)]
        )
    fog = np.array([(f.times_noise * noise_per_m, f.scale_m) for f in sky.fog])
    return Air(layers, waves, fog.reshape(-1, 2), sky.gate_fall)


@njit()
def patch_strength(layer: Any, waves: Any, x: float, y: float, time_s: float) -> float:
    """How much of a layer's full strength a place has, 0..1.

    Parameters
    ----------
    layer : (7,) float64
        Row of :attr:`Air.layers`.
    waves : (WAVES, 3) float64
        Its waves.
    x, y : float
        Place relative to the scene's origin [m].
    """
    if layer[4] == -np.inf:
        return 1.0
    east, north, total = x - layer[5] * time_s, y - layer[6] * time_s, 0.0
    for w in range(len(waves)):
        total += math.cos(waves[w, 0] * east + waves[w, 1] * north + waves[w, 2])
    field = total * math.sqrt(2.0 / len(waves))
    return float(min(max((field - layer[4]) / RIM + 0.5, 0.0), 1.0))


@njit()
def layer_strength(layer: Any, z: float) -> float:
    """How much of a layer's full strength a height has, 0..1."""
    edge = max(layer[2], 1e-6)
    inside = min(z - layer[0], layer[1] - z)
    return float(min(max(inside / edge + 0.5, 0.0), 1.0))


@njit()
def add_air(
    rng: np.random.Generator, scene: SceneArrays, air: Air, gain: float, time_s: float, ray: Any,
    span: tuple[float, float], ranges: NDArray[np.float64], facts: NDArray[np.int64], n: int,
) -> int:  # fmt: skip
    """Photo-electrons that haze and fog send back along one beamlet, by thinning.

    Parameters
    ----------
    rng : Generator
        Source of chance; not consumed where there is no layer and no fog.
    time_s : float
        Of the shot, since the scene's take-off [s].
    ray : tuple of (3,) float64
        Origin [m] and axis of the beamlet.
    span : (float, float)
        Start of the gate, and the hard surface or the gate's end [m].
    ranges, facts, n
        Events so far, as in :func:`~spl_batch.airborne.simulate.detector.add_event`.
    """
    origin, axis = ray
    for k in range(len(air.layers)):
        layer = air.layers[k]
        at, stop = reach(layer, origin, axis, span)
        rate = gain * layer[3]
        at -= math.log(1.0 - rng.random()) / rate
        while at < stop:
            x, y, z = origin[0] + at * axis[0], origin[1] + at * axis[1], origin[2] + at * axis[2]
            share = layer_strength(layer, z) * patch_strength(layer, air.waves[k], x, y, time_s)
            if rng.random() < share:
                n = add_event(ranges, facts, n, at, KIND_BACKGROUND, NO_PARENT, -1)
            at -= math.log(1.0 - rng.random()) / rate
    for k in range(len(air.fog)):
        rate, scale = gain * air.fog[k, 0], air.fog[k, 1]
        at = max(span[0], span[1] + 2.0 * FOG_DEPTH * scale / axis[2])
        at -= math.log(1.0 - rng.random()) / rate
        while at < span[1]:
            x, y, z = origin[0] + at * axis[0], origin[1] + at * axis[1], origin[2] + at * axis[2]
            above = z - bilinear(scene.ground_z, scene.grid, x, y)[0]
            if above >= 0.0 and rng.random() < math.exp(-above / scale):
                n = add_event(ranges, facts, n, at, KIND_BACKGROUND, NO_PARENT, -1)
            at -= math.log(1.0 - rng.random()) / rate
    return n


@njit()
def reach(layer: Any, origin: Any, axis: Any, span: tuple[float, float]) -> tuple[float, float]:
    """Where a beamlet enters and leaves a layer with its edges [m]."""
    half = 0.5 * layer[2]
    enter = (layer[1] + half - origin[2]) / axis[2]
    leave = (layer[0] - half - origin[2]) / axis[2]
    return max(enter, span[0]), min(leave, span[1])
