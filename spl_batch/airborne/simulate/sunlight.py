"""Sunlight that comes back from what a beamlet looks at [W17 Eq. 2.4].

A beamlet's background from the ground follows the reflectance of what it meets times the light
there, d + (1 - d) s cos(beta) / cos(zenith): d is the share of skylight, s is 0 in cast shadows and
1 elsewhere, beta is the angle between the sun and the surface's normal. [W17] has one reflectance,
level ground and no shadows. Light is that of the highest surface at a place.
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.simulate.scene.beam_layers import look, surfaces_at
from spl_batch.airborne.simulate.scene.ray_trace import SceneArrays, bilinear
from spl_batch.airborne.simulate.scene.scene_file import Scene
from spl_batch.numerics.compiled import njit


def lit(scene: Scene, arrays: SceneArrays) -> SceneArrays:
    """A scene with its light, relative to the mean brightness of its extent."""
    step = float(arrays.ground.grid[2])
    y, x = (
        first + step * np.arange(n)
        for first, n in zip(arrays.ground.grid[1::-1], arrays.ground.z.shape, strict=True)
    )
    xx, yy = np.meshgrid(x, y)
    above = surfaces_at(arrays, xx.ravel(), yy.ravel()).reshape(3, *xx.shape)
    light = sunlight(above[1], step, scene)
    inside = (xx >= 0) & (xx <= scene.extent_m[0]) & (yy >= 0) & (yy <= scene.extent_m[1])
    mean = float((light * above[2])[inside].mean())
    ground = arrays.ground._replace(light=light / max(mean, 1e-9))
    return arrays._replace(ground=ground)


def sunlight(surface: NDArray[np.float64], step_m: float, scene: Scene) -> NDArray[np.float64]:
    """Light at the nodes of a surface over that on level ground in the sun: (ny, nx) float64.

    ``surface`` (ny, nx): heights, rows from south to north, ``step_m`` apart [m].
    """
    sky = scene.sky
    zenith, azimuth = math.radians(sky.zenith_deg), math.radians(sky.azimuth_deg)
    east, north = math.sin(azimuth), math.cos(azimuth)
    rise_y, rise_x = np.gradient(surface, step_m)
    along = (rise_x * east + rise_y * north) * math.tan(zenith)
    cosine = (1.0 - along) / np.sqrt(1.0 + rise_x**2 + rise_y**2)
    sunny = np.clip(cosine, 0.0, sky.brightest)
    rows, columns = np.indices(surface.shape)
    slope = 1.0 / max(math.tan(zenith), 1e-6)
    for k in range(1, math.ceil(float(np.ptp(surface)) / slope / step_m) + 1):
        there = (
            np.clip(np.rint(rows + k * north).astype(np.int64), 0, surface.shape[0] - 1),
            np.clip(np.rint(columns + k * east).astype(np.int64), 0, surface.shape[1] - 1),
        )
        sunny[surface[there] > surface + k * step_m * slope] = 0.0
    light: NDArray[np.float64] = sky.skylight + (1.0 - sky.skylight) * sunny
    return light


@njit()
def brightness(
    scene: SceneArrays, ray: Any, sigma_rad: float, layers: NDArray[np.float64]
) -> float:
    """Light that the patch of a beamlet, its origin and axis, sends back over the scene's mean."""
    origin, axis = ray
    count, hard, _, rho, _ = look(scene, origin, axis, axis, sigma_rad, layers)
    left, albedo = 1.0, 0.0
    for k in range(count):
        albedo += left * layers[k, 2] * layers[k, 3]
        left *= 1.0 - layers[k, 2]
    albedo += left * rho
    x, y = origin[0] + hard * axis[0], origin[1] + hard * axis[1]
    return float(albedo * bilinear(scene.ground.light, scene.ground.grid, x, y)[0])
