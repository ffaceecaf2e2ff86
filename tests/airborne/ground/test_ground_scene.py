"""Ground filters on a scene whose truth is known."""

from functools import cache
from typing import Literal, NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.interpolate import LinearNDInterpolator

from spl_batch.lattice.tables import PointTable
from tests.airborne.ground.clouds import ground_of, table

Float = NDArray[np.float64]

EDGE_M = 120.0
RANGING_SD_M = 0.05
ROOFS = ((10.0, 10.0, 22.0, 24.0, 6.0), (50.0, 52.0, 105.0, 110.0, 11.0))
ORIGIN_M = (500_000.0, 3_300_000.0)


class Scene(NamedTuple):
    table: PointTable
    ground: NDArray[np.bool_]
    noise: NDArray[np.bool_]


def terrain(x: Float, y: Float) -> Float:
    """Tilted, rolling ground with a 3 m embankment and a 45 degree bank 8 m high [m]."""
    rolling = 100 + 0.08 * x + 3 * np.sin(x / 17) * np.cos(y / 23)
    embankment = np.clip((7 - np.abs(y - 40)) * 0.7, 0, 3)
    return rolling + embankment + np.clip(y - 112, 0, 8)


def roof_height(x: Float, y: Float) -> Float:
    """Height of the roof over a place; NaN where there is none [m]."""
    height = np.full_like(x, np.nan)
    for x0, y0, x1, y1, above in ROOFS:
        over = (x >= x0) & (x < x1) & (y >= y0) & (y < y1)
        height[over] = terrain(np.array((x0 + x1) / 2), np.array((y0 + y1) / 2)) + above
    return height


@cache
def scene(density: float = 25.0) -> Scene:
    """Ground, two roofs (one of 55 m), trees, shrubs and 2 per 1000 points deep below."""
    rng = np.random.default_rng(7)
    n = int(density * EDGE_M**2)
    x, y = rng.uniform(0, EDGE_M, (2, n))
    base, roof = terrain(x, y), roof_height(x, y)
    z, ground = base.copy(), np.isnan(roof)
    z[~ground] = roof[~ground]
    for cx, cy, r, top in zip(*_plants(rng), strict=True):
        under = ground & ((x - cx) ** 2 + (y - cy) ** 2 < r * r) & (rng.random(n) < 0.85)
        z[under] += rng.uniform(0.3 * top, top, int(under.sum()))
        ground &= ~under
    z += rng.normal(0, RANGING_SD_M, n)
    noise = rng.random(n) < 0.002
    z[noise] = base[noise] - rng.uniform(0.5, 50, int(noise.sum()))
    points = table(x + ORIGIN_M[0], y + ORIGIN_M[1], z)
    points = points.with_columns(range_sigma=np.full(n, RANGING_SD_M))
    return Scene(points, ground & ~noise, noise)


def _plants(rng: np.random.Generator) -> tuple[Float, Float, Float, Float]:
    """Places, radii and heights of 60 trees and 40 shrubs [m]."""
    place = rng.uniform(0, EDGE_M, (2, 100))
    radius = np.concatenate([rng.uniform(2, 5, 60), rng.uniform(0.5, 1.5, 40)])
    height = np.concatenate([rng.uniform(6, 20, 60), rng.uniform(0.6, 2.0, 40)])
    return place[0], place[1], radius, height


def dtm_error(scene: Scene, mask: NDArray[np.bool_]) -> Float:
    """Interpolated ground less truth at cell centres that are open ground [m]."""
    x = scene.table["x"] / 1000 - ORIGIN_M[0]
    y = scene.table["y"] / 1000 - ORIGIN_M[1]
    column, row = np.floor(x[mask]).astype(int), np.floor(y[mask]).astype(int)
    key, place = np.unique(row * 1000 + column, return_inverse=True)
    mean = [
        np.bincount(place, v[mask]) / np.bincount(place) for v in (x, y, scene.table["z"] / 1000)
    ]
    assert len(key) > 3
    gx, gy = (v.ravel() for v in np.meshgrid(np.arange(2.5, 118), np.arange(2.5, 118)))
    error = LinearNDInterpolator(np.column_stack(mean[:2]), mean[2])(gx, gy) - terrain(gx, gy)
    return error[np.isnan(roof_height(gx, gy)) & np.isfinite(error)]


@cache
def ground(method: Literal["multiscale", "ptd", "smrf"]) -> NDArray[np.bool_]:
    """Ground of the whole scene; several tests look at it."""
    return ground_of(scene().table, method)


@pytest.mark.parametrize(
    ("method", "missed", "taken", "rmse_m"),
    [("multiscale", 0.02, 0.01, 0.05), ("ptd", 0.005, 0.01, 0.05), ("smrf", 0.06, 0.02, 0.15)],
)
def test_known_scene(
    method: Literal["multiscale", "ptd", "smrf"], missed: float, taken: float, rmse_m: float
) -> None:
    found = scene()
    mask = ground(method)
    objects = ~found.ground & ~found.noise
    error = dtm_error(found, mask)
    assert np.mean(~mask[found.ground]) < missed
    assert np.mean(mask[objects]) < taken
    assert np.mean(mask[found.noise]) < 0.02
    assert np.sqrt(np.mean(error**2)) < rmse_m
    assert abs(np.mean(error)) < 0.02
    assert len(error) > 7000


def test_ground_is_not_biased_low() -> None:
    found = scene()
    kept = ground("multiscale") & found.ground
    x = found.table["x"] / 1000 - ORIGIN_M[0]
    y = found.table["y"] / 1000 - ORIGIN_M[1]
    residual = found.table["z"] / 1000 - terrain(x, y)
    assert abs(residual[kept].mean()) < 0.002
    assert residual[kept].std() == pytest.approx(RANGING_SD_M, rel=0.03)


def test_ground_of_untold_spread_is_a_centimetre_low_at_most() -> None:
    """Ranges that scatter twice as much as is reckoned with where no flightline states it."""
    found = scene()
    bare = PointTable({axis: found.table[axis] for axis in "xyz"})
    error = dtm_error(found, ground_of(bare))
    assert -0.01 < np.mean(error) < 0.002
    assert np.sqrt(np.mean(error**2)) < 0.03


def test_ground_of_coarse_ranges_is_not_biased() -> None:
    """Ranges that scatter by 15 cm, as their flightline has shown: the layer is as thick."""
    rng = np.random.default_rng(3)
    x, y = rng.uniform(0, 40, (2, 12 * 40 * 40))
    z = 0.1 * x + rng.normal(0, 0.15, len(x))
    untold = table(x, y, z)
    found = ground_of(untold.with_columns(range_sigma=np.full(len(x), 0.15)))
    assert found.mean() > 0.985
    assert abs((z - 0.1 * x)[found].mean()) < 0.01
    assert ground_of(untold).mean() < 0.97


@pytest.mark.parametrize(
    ("method", "seed"), [("multiscale", 0), ("multiscale", 1), ("ptd", 0), ("ptd", 1), ("smrf", 0)]
)
def test_single_returns_under_wide_crowns_are_ground(
    method: Literal["multiscale", "ptd", "smrf"], seed: int
) -> None:
    """1.2 ground returns per m2 beneath 25 of leaves, on a slope: crown bottoms are no ground."""
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(0, 40, (2, 25 * 40 * 40))
    crown = np.hypot(x - 20, y - 20) < 12
    leaf = crown & (rng.random(len(x)) > 1.2 / 25)
    height = rng.normal(0, RANGING_SD_M, len(x)) + np.where(leaf, rng.uniform(3, 15, len(x)), 0)
    found = ground_of(table(x, y, 0.5 * x + height), method)
    assert height[found].max() < 1
    assert found[crown & ~leaf].mean() > 0.99


@pytest.mark.parametrize(("per_m2", "share"), [(1, 0.91), (8, 0.88)])
def test_terraces_are_ground_to_their_edges(per_m2: int, share: float) -> None:
    """Steps of 4 m every 8 m: ground below an edge says nothing against that on it."""
    x, y = np.random.default_rng(1).uniform(0, 60, (2, per_m2 * 60 * 60))
    z = 4 * np.floor(x / 8) + np.random.default_rng(2).normal(0, RANGING_SD_M, len(x))
    assert ground_of(table(x, y, z)).mean() > share


def crowns_on_a_slope(seed: int) -> tuple[PointTable, Float]:
    """Slope of 56 degrees, half of it under crowns, 1.2 ground returns per m2 there; heights."""
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(0, 40, (2, 25 * 40 * 40))
    leaves = np.zeros(len(x))
    crowns = zip(
        *rng.uniform(0, 40, (2, 40)), rng.uniform(1.5, 4, 40), rng.uniform(4, 8, 40), strict=True
    )
    for east, north, radius, bottom in crowns:
        under = (np.hypot(x - east, y - north) < radius) & (leaves == 0)
        above = bottom + rng.uniform(0, 8, int(under.sum()))
        leaves[under] = np.maximum(above - 1.5 * (x[under] - east), 0.5)
    height = rng.normal(0, RANGING_SD_M, len(x)) + leaves * (rng.random(len(x)) > 1.2 / 25)
    return table(x, y, 1.5 * x + height), height


@pytest.mark.parametrize(
    ("method", "least", "most"), [("multiscale", 0.97, 0.0), ("ptd", 0.998, 5e-4)]
)
@pytest.mark.parametrize("seed", [0, 1])
def test_crowns_on_steep_slopes_are_no_ground(
    seed: int, method: Literal["multiscale", "ptd"], least: float, most: float
) -> None:
    """Ground rises by more than a shrub from a metre to the next: nothing lies "below" a crown."""
    points, height = crowns_on_a_slope(seed)
    found = ground_of(points, method)
    assert (height[found] > 1.5).mean() <= most
    assert found[np.abs(height) < 0.15].mean() > least


@pytest.mark.parametrize(("method", "least"), [("multiscale", 0.94), ("ptd", 0.97)])
@pytest.mark.parametrize("seed", [0, 1])
def test_single_returns_in_deep_shade_are_ground(
    seed: int, method: Literal["multiscale", "ptd"], least: float
) -> None:
    """A road cut into a slope under closed canopy; of 25 returns per m2 0.8 are of the ground."""
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(0, 60, (2, 25 * 60 * 60))
    leaf = rng.random(len(x)) > 0.8 / 25
    height = rng.normal(0, RANGING_SD_M, len(x)) + np.where(leaf, rng.uniform(3, 15, len(x)), 0)
    road = 0.7 * y - np.clip(0.7 * (y - 28), 0, 2.8)
    found = ground_of(table(x, y, road + height), method)
    assert found[~leaf].mean() > least
    assert found[leaf].sum() < 20
