"""The level of water polygons: clear lakes, rivers, decks; terrain and classes over them."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from spl_batch.model import PointFlag, PointTable
from spl_batch.settings import GroundSettings, ProductSettings
from spl_batch.stages.classes import classify
from spl_batch.stages.ground import ground_mask
from spl_batch.stages.surface import surfaces
from spl_batch.stages.water import flattened, submerged, water_level
from spl_batch.tiling import Bounds

Float = NDArray[np.float64]
EDGE_M, RANGING_SD_M = 100.0, 0.05
ORIGIN = np.array([500_000_000, 3_300_000_000])


def quantised(x: Float, y: Float, z: Float) -> tuple[NDArray[np.int64], ...]:
    xq, yq, zq = (np.rint(v * 1000).astype(np.int64) for v in (x, y, z))
    return xq + ORIGIN[0], yq + ORIGIN[1], zq


def differ(a: tuple[int, int], b: tuple[int, int]) -> tuple[int, int]:
    return a[0] - b[0], a[1] - b[1]


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
        levels[cell] = int(near[(len(near) - 1) // 2]) if near else -(2**40)
    return [levels[(p // 5000, q // 5000)] for p, q in zip(x.tolist(), y.tolist(), strict=True)]


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(0, 150), st.integers(1, 80))
def test_levels_are_those_of_a_slow_twin_in_any_order(seed: int, n: int, spread: int) -> None:
    rng = np.random.default_rng(seed)
    x, y = rng.integers(-spread * 1000, spread * 1000, (2, n))
    z = rng.choice([0, 100, 140, 2000], n) + rng.integers(0, 60, n)
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


@pytest.mark.parametrize(("share", "fall"), [(0.1, 0.0), (0.9, 0.0), (0.15, 0.005)])
def test_the_surface_of_clear_water_is_its_level(share: float, fall: float) -> None:
    rng = np.random.default_rng(1)
    x, y, z, level = clear_water(rng, share, fall)
    found = water_level(*quantised(x, y, z)) / 1000
    off = np.abs(found - level)
    inner = (x > 27.5) & (x < EDGE_M - 27.5)
    # a cell is 5 m long, and holds one level
    assert off[inner].max() < 0.03 + 5 * fall
    assert off.max() < 0.03 + 17.5 * fall


def test_decks_crowns_and_noise_above_do_not_lift_the_level() -> None:
    rng = np.random.default_rng(2)
    x, y, z, level = clear_water(rng, 0.15)
    deck = (np.abs(x - 50) < 6) | (np.hypot(x - 20, y - 20) < 5)
    z[deck] = level[deck] + 6 + rng.normal(0, RANGING_SD_M, int(deck.sum()))
    stray = rng.random(len(x)) < 0.002
    z[stray] = level[stray] + rng.uniform(0, 100, int(stray.sum()))
    found = water_level(*quantised(x, y, z)) / 1000
    assert np.abs(found - level).max() < 0.03


def test_crowns_over_most_of_a_creek_do_not_lift_its_level() -> None:
    rng = np.random.default_rng(5)
    x, y = rng.uniform(0, (EDGE_M, 8.0), (int(20 * EDGE_M * 8), 2)).T
    level = 50 - 0.005 * x
    z = level + rng.normal(0, RANGING_SD_M, len(x))
    leaf = (np.sin(x / 6) > -0.5) & (rng.random(len(x)) < 0.9)
    z[leaf] = level[leaf] + rng.uniform(1.5, 9, int(leaf.sum()))
    found = water_level(*quantised(x, y, z)) / 1000
    assert np.abs(found - level).max() < 0.25


def test_a_pond_beside_a_lake_keeps_its_own_level() -> None:
    rng = np.random.default_rng(3)
    x, y, z, level = clear_water(rng, 0.5)
    pond = (x > 80) & (y > 80)
    z[pond], level[pond] = z[pond] - 4, level[pond] - 4
    dam = ~pond & (x > 70) & (y > 70)
    x, y, z, level = (v[~dam] for v in (x, y, z, level))
    found = water_level(*quantised(x, y, z)) / 1000
    assert np.abs(found - level).max() < 0.03


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
    usable = ~submerged(table, np.ones(len(table), np.bool_))
    assert usable[surface | ~wet].mean() > 0.999
    deep = wet & (table["z"] < 49_500)
    assert not usable[deep].any()
    ground = ground_mask(table, usable, GroundSettings())
    table = table.with_columns(ground=ground)
    cell = Bounds(*(int(v) for v in (*ORIGIN, *(ORIGIN + 100_000))))
    dtm = surfaces(table, cell, ProductSettings(intensity="las"))["dtm"]
    row, col = np.mgrid[0:100, 0:100] + 0.5
    inner = np.hypot(row - 50, col - 50) < 27
    assert np.abs(dtm[inner] - 50).max() < 0.02
    found = classify(table, cell, dtm)
    assert (found[surface] == 9).mean() > 0.999
    assert (found[deep] == 1).all()
    assert (found[~wet] == 2).mean() > 0.99


def test_only_what_lies_at_the_surface_is_put_on_it() -> None:
    table, wet, _ = lake()
    lifted = flattened(table)
    moved = lifted["z"] != table["z"]
    assert not moved[~wet].any()
    assert np.abs(lifted["z"][moved] - table["z"][moved]).max() <= 250
    near = wet & (np.abs(table["z"] - 50_000) < 150)
    assert np.ptp(lifted["z"][near]) < 30
    np.testing.assert_array_equal(lifted["z"][wet & (table["z"] < 49_500)],
                                  table["z"][wet & (table["z"] < 49_500)])  # fmt: skip
