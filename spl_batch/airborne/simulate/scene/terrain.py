"""Ground heights, reflectance and water of a scene, on a grid of nodes."""

import math
from typing import Any, NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree

from spl_batch.airborne.simulate.scene.ray_trace import KIND_BOTTOM, KIND_GROUND, KIND_WATER
from spl_batch.airborne.simulate.scene.scene_file import Landform, Scene

APRON_M = 60.0
"""How far the ground goes on beyond the extent, so that slanted beams meet it [m]."""

WAVE_M = 10.0
"""Length of waves on water [m]."""


class Ground(NamedTuple):
    """Node grids; see :class:`~spl_batch.airborne.simulate.scene.ray_trace.SceneArrays`."""

    z: NDArray[np.float64]
    rho: NDArray[np.float64]
    kind: NDArray[np.uint8]
    grid: NDArray[np.float64]
    pond_at: NDArray[np.uint8] = np.zeros((0, 0), dtype=np.uint8)
    ponds: NDArray[np.float64] = np.zeros((0, 3))


def make_ground(scene: Scene, rng: np.random.Generator) -> Ground:
    """Ground of a scene."""
    terrain = scene.terrain
    step = terrain.grid_m
    apron = math.ceil(APRON_M / step) * step
    nx, ny = (math.ceil((size + 2 * apron) / step) + 1 for size in scene.extent_m)
    relief = _smooth_noise(rng, (ny, nx), terrain.wavelength_m / step / 4)
    z = scene.origin_m[2] + terrain.relief_m * (relief - 0.5)
    z += terrain.roughness_m * rng.standard_normal((ny, nx))
    for form in terrain.landforms:
        z += _raised(form, np.array([-apron, -apron, step]), z.shape)
    bright = _smooth_noise(rng, (ny, nx), 10.0 / step) - 0.5
    bright /= max(float(bright.std()), 1e-9)
    rho = terrain.reflectance * np.clip(1 + terrain.reflectance_variation * bright, 0.05, 3.0)
    if terrain.parcel_m is not None:
        rho *= _parcels(scene, (ny, nx))
    kind = np.full((ny, nx), KIND_GROUND, dtype=np.uint8)
    ground = Ground(z, np.clip(rho, 0.0, 1.0), kind, np.array([-apron, -apron, step]))
    return _flood(scene, ground)


def node_points(ground: Ground, window: tuple[slice, slice]) -> NDArray[Any]:
    """Nodes of some rows and columns as points: (rows, columns) of shapely's [m]."""
    rows, columns = window
    x = ground.grid[0] + ground.grid[2] * np.arange(columns.start, columns.stop)
    y = ground.grid[1] + ground.grid[2] * np.arange(rows.start, rows.stop)
    points: NDArray[Any] = shapely.points(*np.meshgrid(x, y))
    return points


def _window(ground: Ground, shape: shapely.Geometry, reach_m: float) -> tuple[slice, slice]:
    """Rows and columns of all nodes that are no further from a shape."""
    west, south, east, north = shape.bounds
    rows, columns = (
        slice(
            min(max(math.floor((low - reach_m - first) / ground.grid[2]), 0), count),
            max(min(math.ceil((high + reach_m - first) / ground.grid[2]) + 1, count), 0),
        )
        for low, high, first, count in (
            (south, north, ground.grid[1], ground.z.shape[0]),
            (west, east, ground.grid[0], ground.z.shape[1]),
        )
    )
    return rows, columns


def _smooth_noise(
    rng: np.random.Generator, shape: tuple[int, int], sigma: float
) -> NDArray[np.float64]:
    """Smooth random field from 0 to 1."""
    coarse = max(int(sigma / 4), 1)
    small = tuple(n // coarse + 3 for n in shape)
    field = ndimage.gaussian_filter(rng.standard_normal(small), sigma / coarse, mode="wrap")
    large = ndimage.zoom(field, coarse, order=3)[: shape[0], : shape[1]]
    low, high = float(large.min()), float(large.max())
    scaled: NDArray[np.float64] = (large - low) / max(high - low, 1e-12)
    return scaled


def _waves(scene: Scene, shape: tuple[int, ...], step: float) -> NDArray[np.float64]:
    """Waves of mean zero and spread one."""
    rng = np.random.default_rng(np.random.SeedSequence(scene.seed, spawn_key=(7,)))
    rough = ndimage.gaussian_filter(rng.standard_normal(shape), WAVE_M / step / 4, mode="wrap")
    waves: NDArray[np.float64] = (rough - rough.mean()) / max(float(rough.std()), 1e-12)
    return waves


def _parcels(scene: Scene, shape: tuple[int, int]) -> NDArray[np.float64]:
    """Factor of the reflectance, one for the places nearest to each of some random ones."""
    rng = np.random.default_rng(np.random.SeedSequence(scene.seed, spawn_key=(8,)))
    step, parcel_m = scene.terrain.grid_m, scene.terrain.parcel_m or math.inf
    size = np.array(shape) * step
    middles = rng.random((max(round(float(np.prod(size)) / parcel_m**2), 2), 2)) * size
    factors = np.exp(rng.uniform(-1.0, 1.0, len(middles)))
    nodes = np.moveaxis(np.indices(shape), 0, -1) * step
    factor: NDArray[np.float64] = factors[cKDTree(middles).query(nodes)[1]]
    return factor


def _raised(
    form: Landform, grid: NDArray[np.float64], shape: tuple[int, ...]
) -> NDArray[np.float64]:
    """By how much a landform raises each node [m]."""
    x, y = (first + grid[2] * np.arange(n) for first, n in zip(grid, shape[::-1], strict=False))
    away = shapely.distance(shapely.Polygon(form.ring_m), shapely.points(*np.meshgrid(x, y)))
    fall = away * math.tan(math.radians(form.slope_deg))
    left: NDArray[np.float64] = np.maximum(abs(form.height_m) - fall, 0.0)
    return math.copysign(1.0, form.height_m) * left


def _flood(scene: Scene, ground: Ground) -> Ground:
    """Lower the ground to each water level, with banks of the stated slope.

    Clear water shows its bottom, which falls from the shore at the same slope.
    """
    z, rho, kind = ground.z.copy(), ground.rho.copy(), ground.kind.copy()
    pond_at = np.zeros(z.shape, dtype=np.uint8)
    ponds: list[tuple[float, float, float]] = []
    step = ground.grid[2]
    for water in scene.water:
        polygon = shapely.Polygon(water.ring_m)
        near = _window(ground, polygon, 3 * step)
        distance = shapely.distance(polygon, node_points(ground, near))
        if not (distance == 0.0).any():
            continue
        # below every node of the shore, so that no ground stands in a pit beside it
        level = float(z[near][distance <= 2 * step].min()) - 0.3
        # beyond, the bank is higher than all ground
        near = _window(ground, polygon, (float(z.max()) - level) / water.bank_slope + step)
        points = node_points(ground, near)
        distance = shapely.distance(polygon, points)
        wet = distance == 0.0
        z[near] = np.minimum(z[near], level + 0.05 + water.bank_slope * distance)
        z[near][wet] = level
        if water.waves_m:
            z[near][wet] += water.waves_m * _waves(scene, wet.shape, step)[wet]
        rho[near][wet] = water.reflectance
        kind[near][wet] = KIND_WATER
        if water.depth_m > 0.0:
            depth = water.bank_slope * shapely.distance(polygon.exterior, points)
            deep = wet & (depth > 0.0)
            z[near][deep] = level - np.minimum(depth, water.depth_m)[deep]
            rho[near][deep], kind[near][deep] = water.bottom_reflectance, KIND_BOTTOM
            pond_at[near][deep] = len(ponds)
            ponds.append((level, water.attenuation_per_m, water.reflectance))
    return Ground(
        z, rho, kind, ground.grid, pond_at, np.array(ponds, dtype=np.float64).reshape(-1, 3)
    )
