"""The level of water polygons: clear lakes, rivers, decks; terrain and classes over them."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from spl_batch.airborne.classes.point_classes import classify
from spl_batch.airborne.ground.ground_methods import ground_mask
from spl_batch.airborne.ground.water.level import NOWHERE, Levels, flattened, in_water, water_levels
from spl_batch.airborne.ground.water.off_water import off_surface
from spl_batch.airborne.products.surface_rasters import surfaces
from spl_batch.airborne.settings import GroundSettings, ProductSettings
from spl_batch.lattice.tables import PointFlag, PointTable
from spl_batch.lattice.tiles import Bounds

Float = NDArray[np.float64]
EDGE_M, RANGING_SD_M = 100.0, 0.05
ORIGIN = np.array([500_000_000, 3_300_000_000])


def quantised(x: Float, y: Float, z: Float) -> tuple[NDArray[np.int64], ...]:
    xq, yq, zq = (np.rint(v * 1000).astype(np.int64) for v in (x, y, z))
    return xq + ORIGIN[0], yq + ORIGIN[1], zq


def differ(a: tuple[int, int], b: tuple[int, int]) -> tuple[int, int]:
    return a[0] - b[0], a[1] - b[1]


def water_level(x: NDArray[Any], y: NDArray[Any], z: NDArray[Any]) -> NDArray[np.int64]:
    """Level of the water around each of its returns, from all of them at once."""
    return water_levels(x, y, z).at(x, y)


def slow_level(x: NDArray[np.int64], y: NDArray[np.int64], z: NDArray[np.int64]) -> list[int]:
    """Cell by cell, in words of the module's description."""
    cells: dict[tuple[int, int], list[int]] = {}
    for p, q, height in zip(x.tolist(), y.tolist(), z.tolist(), strict=True):
        cells.setdefault((p // 5000, q // 5000), []).append(height)
    tops: dict[tuple[int, int], float] = {}
    for cell, heights in cells.items():
        heights.sort(reverse=True)
        needed = max(3, -(-len(heights) // 20))
        for first in heights:
            layer = [h for h in heights if first - 300 <= h <= first]
            if len(layer) >= needed:
                middle = np.median(layer)
                tops[cell] = float(np.median([h for h in heights if abs(h - middle) <= 150]))
                break
    beside = {c: [tops[o] for o in tops if 0 < max(map(abs, differ(o, c))) <= 1] for c in tops}
    agreed = {
        c: top
        for c, top in tops.items()
        if 3 * sum(abs(other - top) <= 250 for other in beside[c]) >= len(beside[c])
    }
    levels = {}
    for cell in cells:
        water, todo = {cell}, [cell]
        while todo:
            i, j = todo.pop()
            beside = {(i + a, j + b) for a in (-1, 0, 1) for b in (-1, 0, 1)} & set(cells) - water
            water |= beside
            todo += beside
        near = sorted(
            agreed[c]
            for c in water & set(agreed)
            if abs(c[0] - cell[0]) <= 5 and abs(c[1] - cell[1]) <= 5
        )
        levels[cell] = int(near[(len(near) - 1) // 2]) if near else NOWHERE
    return [levels[(p // 5000, q // 5000)] for p, q in zip(x.tolist(), y.tolist(), strict=True)]


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(0, 150), st.integers(1, 80))
def test_levels_are_those_of_a_slow_twin_in_any_order(seed: int, n: int, spread: int) -> None:
    rng = np.random.default_rng(seed)
    x, y = rng.integers(-spread * 1000, spread * 1000, (2, n))
    z = rng.choice([0, 100, 140, 400, 2000], n) + rng.integers(0, 60, n)
    found = water_level(x, y, z)
    np.testing.assert_array_equal(found, slow_level(x, y, z))
    order = rng.permutation(n)
    np.testing.assert_array_equal(water_level(x[order], y[order], z[order]), found[order])


def clear_water(rng: np.random.Generator, share: float, fall: float = 0.0) -> tuple[Float, ...]:
    """Returns of 20 per m2 of clear water 2 m deep; x, y, z, and the surface's height [m]."""
    x, y = rng.uniform(0, EDGE_M, (2, int(20 * EDGE_M**2)))
    level = 50.0 - fall * x
    top = rng.random(len(x)) < share
    z = level - np.where(top, 0.0, 2.0) + rng.normal(0, RANGING_SD_M, len(x))
    return x, y, z, level


def test_crowns_over_most_of_a_creek_do_not_lift_its_level() -> None:
    rng = np.random.default_rng(5)
    x, y = rng.uniform(0, (EDGE_M, 8.0), (int(20 * EDGE_M * 8), 2)).T
    level = 50 - 0.005 * x
    z = level + rng.normal(0, RANGING_SD_M, len(x))
    leaf = (np.sin(x / 6) > -0.5) & (rng.random(len(x)) < 0.9)
    z[leaf] = level[leaf] + rng.uniform(1.5, 9, int(leaf.sum()))
    found = water_level(*quantised(x, y, z)) / 1000
    assert np.abs(found - level).max() < 0.25


def lake() -> tuple[PointTable, NDArray[np.bool_], NDArray[np.bool_]]:
    """Land that falls to a clear lake of 60 m, whose bottom sends back eight of nine returns."""
    rng = np.random.default_rng(4)
    x, y = rng.uniform(0, EDGE_M, (2, int(20 * EDGE_M**2)))
    inland = np.hypot(x - 50, y - 50) - 30
    wet = inland < 0
    surface = wet & (rng.random(len(x)) < 1 / 9)
    z = 50 + np.where(wet, np.maximum(inland * 0.3, -2.0), 0.05 + 0.3 * inland)
    z = np.where(surface, 50.0, z) + rng.normal(0, RANGING_SD_M, len(x))
    xq, yq, zq = quantised(x, y, z)
    columns: dict[str, NDArray[Any]] = {
        "x": xq, "y": yq, "z": zq.astype(np.int32),
        "flags": np.where(wet, int(PointFlag.WATER), 0).astype(np.uint8),
        "noise_class": np.zeros(len(x), np.uint8), "input_class": np.ones(len(x), np.uint8),
    }  # fmt: skip
    return PointTable(columns), wet, surface


def test_terrain_over_clear_water_is_its_flat_surface_and_the_bottom_stays() -> None:
    table, wet, surface = lake()
    usable = ~off_surface(table, np.ones(len(table), np.bool_))
    assert usable[surface | ~wet].mean() > 0.999
    deep = wet & (table["z"] < 49_500)
    assert not usable[deep].any()
    ground = ground_mask(table, usable, GroundSettings())
    table = table.with_columns(ground=ground)
    cell = Bounds(*(int(v) for v in (*ORIGIN, *(ORIGIN + 100_000))))
    dtm = surfaces(table, cell, ProductSettings(intensity="las"), 0.05)["dtm"]
    row, col = np.mgrid[0:100, 0:100] + 0.5
    inner = np.hypot(row - 50, col - 50) < 27
    assert np.abs(dtm[inner] - 50).max() < 0.02
    found = classify(table, cell, dtm)
    assert (found[surface] == 9).mean() > 0.999
    assert (found[deep] == 1).all()
    assert (found[~wet] == 2).mean() > 0.98


def test_only_what_lies_at_the_surface_is_put_on_it() -> None:
    table, wet, _ = lake()
    lifted = flattened(table, level_of(table))
    moved = lifted["z"] != table["z"]
    assert not moved[~wet].any()
    assert np.abs(lifted["z"][moved] - table["z"][moved]).max() <= 300
    near = wet & (np.abs(table["z"] - 50_000) < 150)
    assert np.ptp(lifted["z"][near]) < 30
    np.testing.assert_array_equal(lifted["z"][wet & (table["z"] < 49_500)],
                                  table["z"][wet & (table["z"] < 49_500)])  # fmt: skip


def level_of(ground: PointTable) -> Levels:
    """The level of the water among some ground, all at once."""
    return water_levels(*in_water(ground)[1], beyond=True)


def points(x: Float, y: Float, z: Float, wet: NDArray[np.bool_] | bool = True) -> PointTable:  # noqa: FBT001, FBT002
    """Signal that nothing else is known of."""
    xq, yq, zq = quantised(x, y, z)
    flags = np.where(np.broadcast_to(wet, x.shape), int(PointFlag.WATER), 0)
    columns: dict[str, NDArray[Any]] = {
        "x": xq, "y": yq, "z": zq.astype(np.int32), "flags": flags.astype(np.uint8),
        "noise_class": np.zeros(len(x), np.uint8), "input_class": np.ones(len(x), np.uint8),
    }  # fmt: skip
    return PointTable(columns)


def off(table: PointTable) -> NDArray[np.bool_]:
    return off_surface(table, np.ones(len(table), np.bool_))


def terrain(table: PointTable) -> tuple[PointTable, Bounds, Float]:
    """Ground, the cell, and its DTM from the south [m]."""
    table = table.with_columns(ground=ground_mask(table, ~off(table), GroundSettings()))
    cell = Bounds(*(int(v) for v in (*ORIGIN, *(ORIGIN + 100_000))))
    dtm = surfaces(table, cell, ProductSettings(intensity="las"), 0.05)["dtm"]
    return table, cell, dtm


def noisy_water(seed: int, density_m3: float) -> tuple[Float, ...]:
    """Clear water 2 m deep below 100 m of noise; x, y, z, and which are noise."""
    rng = np.random.default_rng(seed)
    x, y, z, _ = clear_water(rng, 0.15)
    n = rng.poisson(density_m3 * EDGE_M**3)
    more = rng.uniform((0, 0, 0), EDGE_M, (n, 3)).T
    noise = np.arange(len(x) + n) >= len(x)
    return *(np.concatenate(both) for both in zip((x, y, z), more, strict=True)), noise


@pytest.mark.parametrize("seed", [6, 7])
def test_noise_above_clear_water_raises_no_terrain_and_is_no_water(seed: int) -> None:
    x, y, z, _ = noisy_water(seed, 0.08)
    table, cell, dtm = terrain(points(x, y, z))
    assert np.abs(dtm - 50).max() < 0.03
    found = classify(table, cell, dtm)
    assert np.abs(z[np.isin(found, (2, 9))] - 50).max() < 0.33
    assert (found[z > 50.33] == 1).all()
    assert (found[np.abs(z - 50) < 0.2] == 9).all()


@pytest.mark.parametrize("seed", [6, 7])
def test_terrain_under_a_bridge_is_the_level_of_the_water_beside_it(seed: int) -> None:
    x, y, z, noise = noisy_water(seed, 0.08)
    deck = np.abs(y - 50) < 4.99
    hit = deck & (noise == 0)
    z = np.where(hit, 58 + np.random.default_rng(seed).normal(0, RANGING_SD_M, len(z)), z)
    seen = ~deck | (z > 49.5)
    table = points(x[seen], y[seen], z[seen])
    gone = off(table)
    beneath = deck[seen] & (np.abs(z[seen] - 53.5) < 3.2)
    assert beneath.sum() > 100
    assert gone[beneath].all()
    assert not gone[hit[seen]].any()
    _, _, dtm = terrain(table)
    assert np.abs(dtm - 50).max() < 0.03


def test_islands_and_banks_in_the_polygon_stay_and_boats_go() -> None:
    rng = np.random.default_rng(8)
    x, y, z, level = clear_water(rng, 0.15)
    island = 1.5 * (8 - np.hypot(x - 40, y - 40)) / 8
    bank = (x - 85) / 5
    boat = (np.abs(x - 70) < 2) & (np.abs(y - 20) < 1)
    land = np.maximum(np.maximum(island, bank), np.where(boat, 2.0, -9.0))
    high = land > 0
    z[high] = level[high] + land[high] + rng.normal(0, RANGING_SD_M, int(high.sum()))
    gone = off(points(x, y, z, x < 95))
    above = high & (land > 0.5)
    assert gone[boat].all()
    assert gone[above & ~boat].mean() < 0.002


@pytest.mark.parametrize("fall", [0.005, 0.03])
def test_the_surface_of_a_river_stays_where_its_level_lags_behind(fall: float) -> None:
    rng = np.random.default_rng(9)
    x, y, z, level = clear_water(rng, 0.2, fall)
    gone = off(points(x, y, z))
    surface = np.abs(z - level) < 0.5
    assert gone[~surface].all()
    # Of a cell that crosses the limit of the level some returns are too few to be dense.
    assert gone[surface & (x < 70)].mean() < 0.02


def test_what_is_off_the_surface_does_not_depend_on_what_lies_farther_than_its_reach() -> None:
    x, y, z, _ = noisy_water(10, 0.5)
    z = np.where((np.hypot(x - 46, y - 50) < 4) & (z < 51), 51.0, z)
    order = np.random.default_rng(10).permutation(len(x))
    whole = off(points(x, y, z))
    np.testing.assert_array_equal(off(points(x[order], y[order], z[order])), whole[order])
    part = x < 90
    mine = x[part] < 45
    np.testing.assert_array_equal(off(points(x[part], y[part], z[part]))[mine],
                                  whole[part][mine])  # fmt: skip
    assert 0.02 < whole[z > 50.3].mean() < 1


def test_a_return_alone_under_a_deck_is_put_on_the_level_of_the_water_beside_it() -> None:
    rng = np.random.default_rng(11)
    x, y, z, _ = clear_water(rng, 1.0)
    beside = np.abs(y - 50) > 12.5
    x, y, z = (np.append(v[beside], add) for v, add in ((x, 52.0), (y, 52.0), (z, 50.2)))
    table = points(x, y, z)
    assert abs(flattened(table, level_of(table))["z"][-1] / 1000 - 50) < 0.02


def test_a_pond_beside_a_lake_keeps_its_own_level() -> None:
    rng = np.random.default_rng(3)
    x, y, z, level = clear_water(rng, 0.5)
    pond = (x > 80) & (y > 80)
    z[pond], level[pond] = z[pond] - 4, level[pond] - 4
    dam = ~pond & (x > 70) & (y > 70)
    x, y, z, level = (v[~dam] for v in (x, y, z, level))
    found = water_level(*quantised(x, y, z)) / 1000
    assert np.abs(found - level).max() < 0.03
