"""Ground heights, reflectance and water of a scene, on a grid of nodes."""

import math
from typing import Final

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree

from spl_batch.airborne.simulate.scene.ray_trace import (
    KIND_BOTTOM,
    KIND_GROUND,
    KIND_WATER,
    Ground,
)
from spl_batch.airborne.simulate.scene.scene_file import Scene

STEEPEST = 0.7
"""Slope times tangent off nadir from which on beams are followed down to the ground."""

_ALL: Final = (slice(None), slice(None))


def make_ground(scene: Scene, rng: np.random.Generator, lean: float) -> Ground:
    """Ground of a scene; ``lean``: tangent off nadir that no beam exceeds."""
    terrain = scene.terrain
    step = terrain.grid_m
    apron = math.ceil(terrain.apron_m / step) * step
    nx, ny = (math.ceil((size + 2 * apron) / step) + 1 for size in scene.extent_m)
    grid = np.array([-apron, -apron, step])
    relief = _smooth_noise(rng, (ny, nx), terrain.wavelength_m / step / 4)
    z = scene.origin_m[2] + terrain.relief_m * (relief - 0.5)
    z += terrain.roughness_m * rng.standard_normal((ny, nx))
    for form in terrain.landforms:
        fall = distance_to(shapely.Polygon(form.ring_m), grid, z.shape, _ALL)
        fall *= math.tan(math.radians(form.slope_deg))
        z += math.copysign(1.0, form.height_m) * np.maximum(abs(form.height_m) - fall, 0.0)
    bright = _smooth_noise(rng, (ny, nx), terrain.reflectance_m / step / 4) - 0.5
    bright /= max(float(bright.std()), 1e-9)
    rho = terrain.reflectance * np.clip(1 + terrain.reflectance_variation * bright, 0.05, 3.0)
    if terrain.parcel_m is not None:
        rho *= _parcels(scene, (ny, nx), terrain.parcel_m)
    kind = np.full((ny, nx), KIND_GROUND, dtype=np.uint8)
    pond_at = np.zeros((ny, nx), dtype=np.uint8)
    dry = Ground(z, np.clip(rho, 0.0, 1.0), kind, grid, pond_at, np.zeros((0, 4)))
    ground = dry._replace(ponds=_flood(scene, dry))
    rise = max(float(np.abs(np.diff(z, axis=axis)).max(initial=0.0)) for axis in (0, 1))
    return ground._replace(steep_top=float(z.max()) if rise * lean > STEEPEST * step else -math.inf)


def distance_to(
    shape: shapely.Geometry, grid: NDArray[np.float64], nodes: tuple[int, ...],
    window: tuple[slice, slice],
) -> NDArray[np.float64]:  # fmt: skip
    """Distances of the nodes in some rows and columns from a shape [m]."""
    y, x = (
        (first + grid[2] * np.arange(count))[part]
        for first, count, part in zip(grid[1::-1], nodes, window, strict=True)
    )
    distance: NDArray[np.float64] = shapely.distance(shape, shapely.points(*np.meshgrid(x, y)))
    return distance


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


def _waves(scene: Scene, wavelength_m: float, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Waves of mean zero and spread one."""
    rng = scene.chance(7)
    sigma = wavelength_m / scene.terrain.grid_m / 4
    rough = ndimage.gaussian_filter(rng.standard_normal(shape), sigma, mode="wrap")
    waves: NDArray[np.float64] = (rough - rough.mean()) / max(float(rough.std()), 1e-12)
    return waves


def _parcels(scene: Scene, shape: tuple[int, int], parcel_m: float) -> NDArray[np.float64]:
    """Factor of the reflectance, one for the places nearest to each of some random ones."""
    rng, step = scene.chance(8), scene.terrain.grid_m
    size = np.array(shape) * step
    middles = rng.random((max(round(float(np.prod(size)) / parcel_m**2), 2), 2)) * size
    factors = np.exp(rng.uniform(-1.0, 1.0, len(middles)))
    nodes = np.moveaxis(np.indices(shape), 0, -1) * step
    factor: NDArray[np.float64] = factors[cKDTree(middles).query(nodes)[1]]
    return factor


def _flood(scene: Scene, ground: Ground) -> NDArray[np.float64]:
    """Lower the ground to each water level, with banks of the stated slope; the clear waters.

    Clear water shows its bottom, which falls from the shore at the same slope.
    """
    ponds: list[tuple[float, ...]] = []
    nodes, step = ground.z.shape, ground.grid[2]
    for water in scene.water:
        polygon = shapely.Polygon(water.ring_m)
        near = _window(ground, polygon, 3 * step)
        distance = distance_to(polygon, ground.grid, nodes, near)
        if not (distance == 0.0).any():
            continue
        # below every node of the shore, so that no ground stands in a pit beside it
        level = float(ground.z[near][distance <= 2 * step].min()) - 0.3
        # beyond, the bank is higher than all ground
        near = _window(ground, polygon, (float(ground.z.max()) - level) / water.bank_slope + step)
        distance = distance_to(polygon, ground.grid, nodes, near)
        z, rho, kind, pond_at = (
            a[near] for a in (ground.z, ground.rho, ground.kind, ground.pond_at)
        )
        wet = distance == 0.0
        z[:] = np.minimum(z, level + 0.05 + water.bank_slope * distance)
        z[wet] = level
        if water.waves_m:
            z[wet] += water.waves_m * _waves(scene, water.wavelength_m, wet.shape)[wet]
        rho[wet], kind[wet] = water.reflectance, KIND_WATER
        if water.depth_m > 0.0:
            shore = distance_to(polygon.exterior, ground.grid, nodes, near)
            deep = wet & (shore > 0.0)
            z[deep] = level - np.minimum(water.bank_slope * shore, water.depth_m)[deep]
            rho[deep], kind[deep] = water.bottom_reflectance, KIND_BOTTOM
            pond_at[deep] = len(ponds)
            ponds.append((level, water.attenuation_per_m, water.reflectance, water.surface_share))
    return np.array(ponds, dtype=np.float64).reshape(-1, 4)
