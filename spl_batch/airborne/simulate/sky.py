"""Air of a scene as numbers for the kernels."""

import math

import numpy as np
from scipy.stats import norm

from spl_batch.airborne.simulate.haze import WAVES, Air
from spl_batch.airborne.simulate.scene.scene_file import Scene


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
