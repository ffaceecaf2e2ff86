"""Ground by scales that follow the data: each step against what it must find, and whole scenes."""

from typing import get_args

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage

from spl_batch.airborne.ground.ground_methods import METHODS
from spl_batch.airborne.ground.multiscale_surface import (
    agreeing_nodes,
    depths_below,
    low_outliers,
    spread_below,
)
from spl_batch.airborne.ground.node_grids import lowest_nodes, plane_heights
from spl_batch.airborne.ground.scales import DAMPING_M2
from spl_batch.airborne.settings import GroundSettings
from tests.airborne.ground.clouds import ground_of, places, table

Float = NDArray[np.float64]


def test_every_method_of_the_settings_is_in_the_table() -> None:
    names = get_args(GroundSettings.model_fields["method"].annotation)
    assert set(METHODS) == set(names)
    assert {"ptd", "smrf"} < set(names)


def test_lowest_nodes_are_the_lowest_of_their_cells() -> None:
    rng = np.random.default_rng(3)
    xyz = rng.uniform(-20, 20, (500, 3))
    chosen = rng.random(500) < 0.7
    grid = lowest_nodes(xyz, chosen, 4.0)
    cell = np.floor(xyz[:, :2] / 4.0)
    low = cell.min(axis=0)
    for row in range(grid.shape[0]):
        for column in range(grid.shape[1]):
            inside = np.flatnonzero(chosen & (cell - low == [column, row]).all(axis=1))
            expected = inside[xyz[inside, 2].argmin()] if len(inside) else -1
            assert grid[row, column] == expected


@pytest.mark.parametrize("own", [False, True])
def test_planes_are_those_of_damped_least_squares(*, own: bool) -> None:
    rng = np.random.default_rng(8)
    xyz = rng.uniform(0, 20, (300, 3))
    grid = lowest_nodes(xyz, np.ones(300, np.bool_), 4.0)
    cell = np.floor(xyz[:, :2] / 4.0).astype(int)
    cell -= cell.min(axis=0)
    asked = np.arange(0, 300, 7)
    found = plane_heights(xyz, asked, grid, 4.0, own=own)
    for i, height in zip(asked, found, strict=True):
        column, row = cell[i]
        around = [
            grid[r, c]
            for r in range(max(row - 1, 0), row + 2)
            for c in range(max(column - 1, 0), column + 2)
            if r < grid.shape[0] and c < grid.shape[1] and (own or (r, c) != (row, column))
        ]
        near = xyz[[j for j in around if j >= 0]]
        centre = near.mean(axis=0)
        off = near - centre
        normal = off[:, :2].T @ off[:, :2] / len(near) + DAMPING_M2 * np.eye(2)
        gradient = np.linalg.solve(normal, off[:, :2].T @ off[:, 2] / len(near))
        expected = centre[2] + gradient @ (xyz[i, :2] - centre[:2])
        assert height == pytest.approx(expected, abs=1e-9)


def test_low_outliers_are_found_side_by_side_and_a_ditch_is_not() -> None:
    x, y = places(20_000, 100)
    z = np.where(np.abs(y - 70) < 2, -3.0, 0.0)
    low = (np.abs(x - 31) < 3) & (np.abs(y - 30) < 1)
    z[low] = -20.0
    assert np.array_equal(low_outliers(np.column_stack([x, y, z])), low)


def test_of_rough_ground_no_node_is_left_out_and_few_stand_out() -> None:
    bare = layers_under_shrubs(np.zeros((64, 64), np.bool_))
    bumps = ndimage.uniform_filter(bare[:, 2].reshape(64, 64), 2, mode="wrap")
    for height, most in ((3.0 * bare[:, 2], 0.2), (10.0 * bumps.ravel(), 0.12)):
        rough = np.column_stack([bare[:, :2], height])
        chosen, high = agreeing_nodes(rough, *np.ones((2, 64 * 64), np.bool_))
        assert chosen.all()
        assert high.mean() < most


def layers_under_shrubs(shrub: NDArray[np.bool_]) -> Float:
    """Nodes of cells of 1 m, each the mean of a layer; some lie in shrubs of 0.1 to 0.5 m."""
    rng = np.random.default_rng(3)
    y, x = (np.indices(shrub.shape) + 0.5).reshape(2, -1)
    height = rng.normal(0, 0.01, shrub.shape) + shrub * rng.uniform(0.1, 0.5, shrub.shape)
    return np.column_stack([x, y, height.ravel()])


def test_single_cells_of_shrubs_stand_out_where_cells_are_small() -> None:
    shrub = np.random.default_rng(4).random((64, 64)) < 0.12
    chosen, high = agreeing_nodes(layers_under_shrubs(shrub), *np.ones((2, 64 * 64), np.bool_))
    assert chosen.all()
    assert high[shrub.ravel()].mean() > 0.97
    assert high[~shrub.ravel()].mean() < 0.02


def test_under_crowns_nodes_are_those_of_larger_cells() -> None:
    """West of x = 64 m every return is ground; east of it one of twelve."""
    x, y = places(24_000, 128)
    rng = np.random.default_rng(2)
    leaf = (x > 64) & (rng.random(len(x)) > 1 / 12)
    xyz = np.column_stack([x, y, np.where(leaf, rng.uniform(4, 18, len(x)), 0.0)])
    cell = np.floor(xyz[:, :2]).astype(int) @ (1, 1000)
    order = np.lexsort([xyz[:, 2], cell])
    nodes = order[np.r_[True, np.diff(cell[order]) > 0]]
    chosen, _ = agreeing_nodes(xyz[nodes], *np.ones((2, len(nodes)), np.bool_))
    open_ground = x[nodes] < 40
    assert chosen[open_ground].all()
    shade = (x[nodes] > 90) & chosen
    assert shade.sum() > 100
    assert leaf[nodes][x[nodes] > 90].mean() > 0.6
    assert leaf[nodes][shade].mean() < 0.2


@pytest.mark.parametrize("share", [0.5, 0.9])
def test_spread_is_that_of_the_noise_whatever_grows_above(share: float) -> None:
    x, y = places(20_000, 64)
    rng = np.random.default_rng(4)
    off = rng.normal(0, 0.04, len(x))
    off += np.where(rng.random(len(x)) < 0.7, rng.uniform(0.2, 1.5, len(x)), 0.0)
    assert spread_below(depths_below(off, x, y), share) == pytest.approx(0.04, rel=0.15)


def test_roofs_of_a_thinned_town_are_no_ground() -> None:
    """One return per four square metres: four of five cells of a metre are empty."""
    x, y = places(22_500, 300)
    rng = np.random.default_rng(5)
    z = 0.03 * x + rng.normal(0, 0.03, len(x))
    roof = np.zeros(len(x), dtype=np.bool_)
    for cx, cy in rng.uniform(30, 270, (40, 2)):
        across, along, eave = rng.uniform(4, 6), rng.uniform(5, 14), rng.uniform(2.8, 7)
        ridge = np.clip(across - np.abs(x - cx), 0, None) * 0.6
        inside = (np.abs(x - cx) < across) & (np.abs(y - cy) < along)
        z[inside & ~roof] += (eave + ridge)[inside & ~roof]
        roof |= inside
    found = ground_of(table(x, y, z))
    assert found[roof].mean() < 0.01
    assert found[~roof].mean() > 0.98


def test_kept_noise_below_a_closed_forest_is_no_ground() -> None:
    """20 returns per m2, a fiftieth of them of the ground, and some noise a metre or two below."""
    n, noise = 100_000, 150
    x, y = places(n, 70)
    rng = np.random.default_rng(16)
    floor = 3 * np.sin(x / 30) + 2 * np.cos(y / 25)
    leaf = rng.random(n) > 0.02
    height = rng.normal(0, 0.03, n) + np.where(leaf, rng.uniform(2, 20, n), 0.0)
    height[:noise] = rng.uniform(-2.0, -0.8, noise)
    found = ground_of(table(x, y, floor + height))
    inner = np.all([(v > 5) & (v < 65) for v in (x, y)], axis=0)
    assert found[inner & (height < -0.7)].mean() < 0.02
    assert found[inner & ~leaf & (height > -0.2)].mean() > 0.97


@pytest.mark.parametrize(("share", "grass_m"), [(1 / 20, (0.08, 0.5)), (1 / 5, (0.0, 0.5))])
def test_grass_and_moss_do_not_raise_dense_ground(
    share: float, grass_m: tuple[float, float]
) -> None:
    """50 returns per m2: few of them of the ground below moss, or more in grass."""
    x, y = places(45_000, 30)
    rng = np.random.default_rng(9)
    plant = rng.random(len(x)) > share
    height = rng.normal(0, 0.02, len(x)) + np.where(plant, rng.uniform(*grass_m, len(x)), 0.0)
    found = ground_of(table(x, y, 0.05 * x + height))
    assert found[~plant].mean() > 0.95
    assert np.median(height[found]) < 0.03
    assert found[height > 0.15].mean() < 0.01


def test_ground_goes_on_to_crests_and_decks_and_houses_do_not() -> None:
    """A ridge of 55 degrees, and a house and a bridge over a flat valley beside it."""
    x, y = places(60_000, 90)
    rng = np.random.default_rng(8)
    slope = np.tan(np.radians(55))
    ground = np.maximum(28 - slope * np.abs(x - 30), 0) - 6.0 * (np.abs(x - 70) < 8)
    deck = (np.abs(x - 70) < 8) & (np.abs(y - 40) < 4)
    house = (np.abs(x - 52) < 4) & (np.abs(y - 70) < 8)
    z = ground + 6.0 * deck + 4.0 * house + rng.normal(0, 0.03, len(x))
    leaf = (rng.random(len(x)) < 0.5) & (y < 30) & (x < 50)
    z[leaf] += rng.uniform(1, 12, leaf.sum())
    found = ground_of(table(x, y, z))
    crest = (np.abs(x - 30) < 8) & ~leaf & (np.abs(y - 45) < 42)
    assert found[crest].mean() > 0.9
    inside = (np.abs(x - 70) < 6) & (np.abs(y - 40) < 3)
    assert found[(deck & inside) | house].mean() < 0.01
    assert found[leaf & (z > ground + 2.5)].mean() < 0.01


@pytest.mark.parametrize(
    ("slope_deg", "pitch_deg", "eave_m", "along_slope"),
    [(20, 35, 0.5, False), (20, 35, 0.0, True), (30, 35, 0.0, False), (40, 35, 0.5, False)],
)
def test_ground_does_not_go_on_to_roofs_of_a_hillside(
    slope_deg: float, pitch_deg: float, eave_m: float, *, along_slope: bool
) -> None:
    """A gabled roof whose uphill eave is hardly above the slope, its ridge across or along it."""
    x, y = places(30_000, 64)
    across = np.abs(y - 32) if along_slope else np.abs(x - 32)
    roof = (np.abs(x - 32) < 6) & (np.abs(y - 32) < 6)
    slope, pitch = np.tan(np.radians([slope_deg, pitch_deg]))
    height = np.where(roof, slope * 38 + eave_m + pitch * (6 - across), slope * x)
    found = ground_of(table(x, y, height + np.random.default_rng(3).normal(0, 0.03, len(x))))
    assert found[roof].mean() < 0.16
    assert found[~roof].mean() > 0.99


def test_shrubs_of_a_dense_heath_are_no_ground() -> None:
    """40 returns per m2, a sixth of them of the ground, the rest in shrubs up to a metre."""
    x, y = places(36_000, 30)
    rng = np.random.default_rng(7)
    shrub = rng.random(len(x)) > 1 / 6
    height = rng.normal(0, 0.03, len(x)) + np.where(shrub, rng.uniform(0.05, 1.0, len(x)), 0.0)
    found = ground_of(table(x, y, 0.05 * x + height))
    assert found[~shrub].mean() > 0.95
    assert found[height > 0.3].mean() < 0.01
    assert np.median(height[found & ~shrub]) == pytest.approx(0.0, abs=0.01)


def test_forest_floor_is_found_between_rare_ground_returns() -> None:
    """1.5 returns per m2, a tenth of them of the ground."""
    x, y = places(60_000, 200)
    rng = np.random.default_rng(6)
    floor = 3 * np.sin(x / 30) + 2 * np.cos(y / 25)
    leaf = rng.random(len(x)) > 0.1
    height = rng.normal(0, 0.03, len(x)) + np.where(leaf, rng.uniform(2, 20, len(x)), 0.0)
    found = ground_of(table(x, y, floor + height))
    assert np.quantile(height[found], 0.99) < 0.5
    assert found[~leaf].mean() > 0.95
