"""Terrain against its own ground: as high as near returns, and it ends where they do."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from spl_batch.airborne.products.cell_values import sort_into_cells
from spl_batch.airborne.products.surface_rasters import surfaces
from spl_batch.airborne.settings import ProductSettings
from spl_batch.constants import NODATA
from spl_batch.numerics.nearest_heights import nearest_heights
from tests.airborne.products.test_surface_rasters import CELL, centres, table_of, terrain

SETTINGS = ProductSettings()
X, Y = centres()
PLACES = np.column_stack([X.ravel(), Y.ravel()])


def allowed(ground, places):
    """Lowest and highest that the five nearest returns and their slope allow at places [m]."""
    away, near = cKDTree(ground[:, :2]).query(places, k=5)
    height, place = ground[near, 2], ground[near, :2]
    off = place - place.mean(axis=1, keepdims=True)
    rises = height - height.mean(axis=1, keepdims=True)
    slope = (np.linalg.pinv(off, rcond=1e-4) @ rises[:, :, None])[:, :, 0]
    share = np.hypot(*slope.T) * away[:, -1]
    far = away[:, 0] > 2
    low, high = height.min(axis=1) - share, height.max(axis=1) + share
    return np.where(far, np.nan, low), np.where(far, np.nan, high)


def off_own_ground(raster, ground):
    """How far cells are off what their own ground allows, where they have any [m]."""
    low, high = allowed(ground, PLACES)
    height = np.where(raster == NODATA, np.nan, raster).ravel()
    return np.fmax(np.fmax(low - height, height - high), 0.0)


def test_what_the_nearest_returns_allow_is_that_of_a_tree_of_them():
    ground = terrain(density=2, noise=0.5, around=6) * 1000
    ground = np.rint(ground - [-26_000, 34_000, 0]).astype(np.int32)
    order, start = sort_into_cells(
        (ground[:, 1] // 1000 * 32 + ground[:, 0] // 1000).astype(np.int64), ground[:, 2], 32 * 32
    )
    xyz = tuple(np.ascontiguousarray(axis) for axis in ground[order].T)
    found = np.empty((2, 20, 20))
    nearest_heights(xyz, start, (32, 6, 1000), 2000.0, found)
    row, col = np.indices((20, 20)) + 6.5
    low, high = allowed(ground / 1000, np.column_stack([col.ravel(), row.ravel()]))
    np.testing.assert_allclose(found.reshape(2, -1), np.array([low, high]) * 1000, atol=1e-3)
    nothing = np.zeros(32 * 32 + 1, np.int64), tuple(np.empty(0, np.int32) for _ in range(3))
    nearest_heights(nothing[1], nothing[0], (32, 6, 1000), 2000.0, found)
    assert np.isnan(found).all()


def beyond_a_bay(points, depth=4.0):
    """How far points lie beyond a slanting edge that a bay cuts [m]."""
    along, beyond = (
        (points[:, 1] - 50 + sign * (points[:, 0] + 10)) / np.sqrt(2) for sign in (1, -1)
    )
    return beyond + depth * np.clip(1 - (along / 12) ** 2, 0, None)


@pytest.mark.parametrize("depth", [1.0, 4.0])
def test_terrain_and_surface_end_where_a_slanting_edge_ends_them(depth):
    points = terrain(density=12, noise=0.03, around=45)
    along = (points[:, 1] - 50 + points[:, 0] + 10) / np.sqrt(2)
    points[:, 2] += 0.05 * along**2
    ground = points[beyond_a_bay(points, depth) < 0]
    rasters = surfaces(table_of(ground, ground=1), CELL, SETTINGS, 0.05)
    assert off_own_ground(rasters["dtm"], ground).max() <= 0.5
    away = cKDTree(ground[:, :2]).query(PLACES)[0]
    for name in ("dtm", "dsm"):
        there = (rasters[name] != NODATA).ravel()
        assert there[beyond_a_bay(PLACES, depth) < 0].all()
        assert away[there].max() < 2.0


def test_nothing_across_a_gap_at_a_step_overrules_the_returns_beside_it():
    points = terrain(density=12, noise=0.03, around=45) * [1, 1, 0]
    points[:, 2] = np.where(points[:, 0] < -10, 10.0, 0.0) + 0.1 * points[:, 1]
    gap = (np.abs(points[:, 0] + 10) < 3) & (np.sin(points[:, 1]) < 0.5)
    ground = points[~gap]
    rasters = surfaces(table_of(ground, ground=1), CELL, SETTINGS, 0.05)
    off = off_own_ground(rasters["dtm"], ground)
    assert off.max() <= 0.5
    assert (rasters["dtm"] != NODATA).all()


@pytest.mark.parametrize("seed", [13, 14, 16])
def test_terrain_of_a_steep_forest_is_as_high_as_its_nearest_ground(seed):
    # On a slope of 50 degrees crowns let through little ground, and brush is taken for it.
    rng = np.random.default_rng(seed)
    ground = terrain(seed=seed, density=2, noise=0.05, around=45)
    gaps = np.sin(ground[:, 0] / 3.0) * np.cos(ground[:, 1] / 4.0)
    ground = ground[gaps > rng.uniform(-0.2, 1, len(ground))]
    ground[:, 2] += 0.8 * ground[:, 0] + 3.0 * np.abs(np.sin(ground[:, 1] / 6.0))
    brush = rng.random(len(ground)) < 0.15
    ground[:, 2] += np.where(brush, rng.uniform(0.5, 4.0, len(ground)), 0)
    rasters = surfaces(table_of(ground, ground=1), CELL, SETTINGS, 0.05)
    off = off_own_ground(rasters["dtm"], ground)
    assert off.max() <= 0.5
    assert (rasters["dtm"] != NODATA).all()
    assert (rasters["dtm_quality"].ravel() >= off - 1e-4).all()
