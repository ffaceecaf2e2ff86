"""The scan along lines: its kernels against slow twins, planted wires, pure noise, tilings."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from spl_batch.airborne.classes.point_classes import classify
from spl_batch.airborne.filter.cube_counts import cube_counts
from spl_batch.airborne.filter.denoise import denoise
from spl_batch.airborne.filter.denoise import reach_m as filter_reach_m
from spl_batch.airborne.filter.filter_interface import Cloud
from spl_batch.airborne.filter.wires.line_hough import (
    PAD,
    fullest,
    grid,
    half_turn,
    tube_volume,
)
from spl_batch.airborne.filter.wires.tubes import PARTS, Tubes, agreeing, refine, surroundings, vote
from spl_batch.airborne.filter.wires.wire_scan import reach_m, scan
from spl_batch.airborne.settings import FilterSettings, WireSettings
from spl_batch.constants import CLASS_HIGH_NOISE, CLASS_WIRE, NOISE_SIGNAL
from spl_batch.lattice.lattice_columns import Columns, columns
from spl_batch.lattice.tables import PointTable
from spl_batch.lattice.tiles import Bounds
from tests.airborne.filter.test_denoise import as_table

FAST = settings(max_examples=15, deadline=None)
BEND = 0.5 / 700e3
SETTINGS = WireSettings(classify=True)


def made_cloud(
    xyz: NDArray[np.int64], density: float | NDArray[Any], asked: NDArray[np.bool_] | None = None
) -> Cloud:
    """Points on the absolute lattice, in the order given."""
    low, n = xyz.min(axis=0, initial=2**40), len(xyz)
    return Cloud(
        xyz=(xyz - low).astype(np.int32), anchor=(int(low[0]), int(low[1]), int(low[2])),
        density=np.full(n, density), asked=np.ones(n, np.bool_) if asked is None else asked,
        shot_noise=np.zeros(n, np.bool_),
    )  # fmt: skip


def noise(rng: np.random.Generator, density: float, *size_m: float) -> NDArray[np.int64]:
    n = rng.poisson(density * math.prod(size_m))
    return np.rint(rng.uniform(0, 1, (n, 3)) * np.array(size_m) * 1000).astype(np.int64)


def conductor(
    rng: np.random.Generator, per_m: float, length_m: float, y_m: float, z_m: float
) -> NDArray[np.int64]:
    """A hanging wire along x, a little askew, with 5 cm of spread."""
    x = rng.uniform(0, length_m, rng.poisson(per_m * length_m))
    middle = x - length_m / 2
    clean = np.stack([x, y_m + 0.03 * middle, z_m + middle**2 / 1200.0], axis=1)
    return np.rint((clean + rng.normal(0, 0.05, clean.shape)) * 1000).astype(np.int64)


@FAST
@given(
    st.integers(0, 2**32 - 1), st.integers(1, 200), st.integers(-5000, 5000),
    st.sampled_from([0, 9000, 10**6]),
)  # fmt: skip
def test_cubes_hold_what_all_pairs_say(seed: int, n: int, base: int, gap: int) -> None:
    # wide gaps count as single cells
    rng = np.random.default_rng(seed)
    xyz = (rng.integers(0, 6000, (n, 3)) + gap * rng.integers(0, 4, (n, 3))).astype(np.int32)
    anchor = (base, 2 * base, -base)
    cell = (xyz.astype(np.int64) + np.array(anchor)) // 1000
    near = np.all(np.abs(cell[:, None] - cell[None]) <= 1, axis=2)
    np.testing.assert_array_equal(cube_counts(xyz, anchor, 1000), near.sum(axis=1))


def test_half_turn_is_the_arctangent() -> None:
    angle = np.linspace(0, 2 * np.pi, 3001)
    found = [half_turn(x, y) for x, y in zip(np.cos(angle), np.sin(angle), strict=True)]
    apart = np.abs(np.array(found) - angle % np.pi)
    assert np.minimum(apart, np.pi - apart).max() < 0.0017


def slow_fullest(
    points: NDArray[np.int32], i: int, reach: float, radius: float, least: float, steep: float
) -> tuple[NDArray[np.int64], int]:
    """Counts of every cell of direction around one point, and all neighbours of the cone."""
    step, turns, levels = (found.item() for found in grid(np.array([reach]), radius, steep))
    cells = np.zeros((turns, levels + 2 * PAD), dtype=np.int64)
    near = 0
    for j in range(len(points)):
        d = points[j].astype(np.int64) - points[i].astype(np.int64)
        flat = float(d[0] * d[0] + d[1] * d[1])
        dz = d[2] - BEND * flat
        if not least**2 <= flat <= reach**2 or dz * dz > steep * steep * flat:
            continue
        near += 1
        rise = dz / math.sqrt(flat) * (-1 if d[1] < 0 else 1)
        share = flat / reach**2
        half = 1 if share >= 0.25 else (3 if share >= 0.0625 else 7)
        a = min(int(half_turn(float(d[0]), float(d[1])) * (1 / step)), turns - 1)
        b = min(int((rise + steep) * (1 / step)), levels - 1)
        for turn in range(a - half, a + half + 1):
            middle = b if 0 <= turn < turns else levels - 1 - b
            cells[turn % turns, middle - half + PAD : middle + half + 1 + PAD] += 1
    return cells, near


@FAST
@given(st.integers(0, 2**32 - 1), st.integers(2, 120), st.sampled_from([3000, 4000, 9000]))
def test_fullest_tubes_are_the_slow_twins(seed: int, n: int, edge: int) -> None:
    rng = np.random.default_rng(seed)
    xyz = (rng.uniform(0, 1, (n, 3)) * [20e3, 20e3, 5e3]).astype(np.int32)
    made = columns(xyz, np.arange(n), (7, -13, 5), edge)
    rows = rng.permutation(n)[: rng.integers(1, n + 1)]
    m = len(rows)
    seed_of = np.full(n, -1, np.int32)
    seed_of[rows] = np.arange(m)
    length, density = rng.uniform(4000, 9000, m), np.full(m, 1e-11)
    count, found = np.zeros(m, np.int32), [np.zeros(m) for _ in range(3)]
    fullest(
        made, seed_of, length, density, np.full(99, np.inf), 250.0, 1500.0, 0.3, BEND, count, *found
    )  # fmt: skip
    azimuth, slope, expected = found
    grids = grid(length, 250.0, 0.3)
    volume = tube_volume(length, 1500.0, grids[0])
    for i, row in enumerate(rows):
        cells, near = slow_fullest(xyz, row, length[i], 250.0, 1500.0, 0.3)
        assert count[i] == cells.max()
        step, turns, levels = (values[i] for values in grids)
        cone = 4 / 3 * math.pi * 0.3 * (length[i] ** 3 - 1500.0**3)
        crowd = max(1e-11, (near - cells.max()) / cone)
        assert expected[i] == pytest.approx(crowd * volume[i])
        a, b = azimuth[i] / step - 0.5, (slope[i] + 0.3) / step + PAD - 0.5
        best = np.argwhere(cells == cells.max())
        assert np.abs(best - [a, b]).max(axis=1).min() <= 2.5
        assert 0 <= a <= turns
        assert b <= levels + 2 * PAD


def test_a_tube_holds_the_noise_that_is_expected() -> None:
    rng = np.random.default_rng(4)
    reach = np.array([9000.0])
    step, _, _ = grid(reach, 250.0, 0.3)
    points = rng.uniform(-9000, 9000, (2_000_000, 3)) * [1, 0.2, 0.2]
    h2 = points[:, 0] ** 2 + points[:, 1] ** 2
    h = np.sqrt(h2)
    half = np.where(h2 >= 0.25 * 81e6, 1.5, np.where(h2 >= 0.0625 * 81e6, 3.5, 7.5)) * step
    inside = (h <= 9000) & (h >= 1500) & (np.abs(points[:, 2] / h) <= half)
    inside &= np.abs(points[:, 1] / points[:, 0]) <= np.tan(half)
    volume = inside.mean() * 18000.0 * 3600.0**2
    assert tube_volume(reach, 1500.0, step) == pytest.approx(volume, rel=0.02)


def drawn_tubes(seed: int, n: int) -> Tubes:
    rng = np.random.default_rng(seed)
    middle = rng.uniform(0, 1, (n, 3)) * [40e3, 40e3, 4e3]
    half = n // 2
    middle[:half, 1:] = rng.normal([20e3, 2e3], 400, (half, 2))
    azimuth, slope = rng.uniform(0, np.pi, n), rng.uniform(-0.3, 0.3, n)
    azimuth[:half], slope[:half] = rng.normal(0, 0.03, half) % np.pi, rng.normal(0, 0.02, half)
    return Tubes(np.arange(n), middle, azimuth, slope, rng.uniform(5e3, 12e3, n), np.ones(n))


def laid(xyz: NDArray[Any], edge: int) -> Columns:
    return columns(np.rint(xyz).astype(np.int32), np.arange(len(xyz)), (-700, 300, 0), edge)


def along(xyz: NDArray[Any], tubes: Tubes, s: int) -> tuple[NDArray[np.float64], ...]:
    d = xyz - tubes.middle[s]
    cosine, sine = math.cos(tubes.azimuth[s]), math.sin(tubes.azimuth[s])
    x = d[:, 0] * cosine + d[:, 1] * sine
    return x, d[:, 1] * cosine - d[:, 0] * sine, d[:, 2] - tubes.slope[s] * x - BEND * x * x


@FAST
@given(st.integers(0, 2**32 - 1), st.integers(2, 80))
def test_agreement_votes_and_surroundings_are_the_slow_twins(seed: int, n: int) -> None:
    tubes, rings = drawn_tubes(seed, n), np.array([400.0, 900.0, 2500.0])
    azimuth, slope, length = tubes.azimuth, tubes.slope, tubes.length
    made, places = laid(tubes.middle, 8000), np.rint(tubes.middle)
    agree, against, votes = (np.zeros(n, np.int32) for _ in range(3))
    agreeing(
        made, tubes, 2.0, 250.0, 6000.0, 0.05, BEND, agree, against
    )  # fmt: skip
    vote(made, tubes, 250.0, BEND, votes)
    count, held = np.zeros((n, 3), np.int32), np.zeros((n, PARTS), np.bool_)
    surroundings(made, tubes, rings, BEND, count, held)
    expected_votes = np.zeros(n, np.int64)
    for s in range(n):
        x, y, v = along(tubes.middle, tubes, s)
        on = (np.abs(y) <= 250.0) & (np.abs(v) <= 250.0)
        near = (np.abs(x) <= 2 * length[s]) & (np.abs(y) <= 6000) & (np.abs(v) <= 6000)
        near[s] = False
        turn = np.abs(azimuth - azimuth[s]) % np.pi
        rise = np.where(np.cos(azimuth - azimuth[s]) >= 0, slope, -slope) - slope[s]
        same = np.minimum(turn, np.pi - turn) <= 0.05
        same &= np.abs(rise - 2 * BEND * x) <= 0.05
        short = np.abs(x) <= length[s]
        assert agree[s] == (near & same & ~(on & short)).sum()
        assert against[s] == (near & on & short & ~same).sum() - (near & on & short & same).sum()
        x, y, v = along(places, tubes, s)
        off, within = np.maximum(np.abs(y), np.abs(v)), np.abs(x) <= length[s]
        expected_votes += within & (off <= 250.0)
        assert count[s].tolist() == [int((within & (off <= ring)).sum()) for ring in rings]
        own = x[within & (off <= rings[0])] + length[s]
        parts = np.unique(np.floor(own / (2 * length[s]) * PARTS).astype(int))
        assert np.flatnonzero(held[s]).tolist() == parts.clip(max=PARTS - 1).tolist()
    np.testing.assert_array_equal(votes, expected_votes)


def test_a_line_is_laid_through_the_returns() -> None:
    x = np.linspace(-11e3, 11e3, 23)
    wire = np.stack([1000 + x, 2000 + 0.02 * x + 100, 3000 - 0.03 * x + BEND * x * x - 80], axis=1)
    beside = wire[::2] + np.array([0, 600, 0])
    made, flank = laid(np.concatenate([wire, beside]), 4000), np.zeros(1, np.int32)
    tube = Tubes(
        np.zeros(1, np.int64), np.array([[1000.0, 2000.0, 3000.0]]), np.array([0.01]),
        np.array([-0.02]), np.array([12e3]), np.ones(1),
    )  # fmt: skip
    for _ in range(2):
        refine(made, tube, 250.0, BEND, flank)
    assert tube.azimuth[0] == pytest.approx(math.atan(0.02), abs=2e-4)
    assert tube.slope[0] == pytest.approx(-0.03, abs=2e-4)
    np.testing.assert_allclose(tube.middle[0], [998.0, 2100.0, 2920.0], atol=3)
    assert flank[0] == 12 - 23


def test_a_weak_conductor_is_kept_and_noise_is_not() -> None:
    rng, turned = np.random.default_rng(8), 2.2
    wires = [conductor(rng, 0.55, 140.0, y, 20.0) for y in (28.0, 32.0)]
    xyz = np.concatenate([*wires, noise(rng, 0.12, 140.0, 60.0, 40.0)])
    turn = np.array([[np.cos(turned), -np.sin(turned)], [np.sin(turned), np.cos(turned)]])
    plane = np.rint(xyz[:, :2] @ turn.T).astype(np.int64)
    xyz = np.column_stack([plane, xyz[:, 2]])
    truth = np.arange(len(xyz)) < sum(map(len, wires))
    found = scan(made_cloud(xyz, 0.12), SETTINGS)
    assert found.signal[truth].mean() > 0.85
    assert found.signal[~truth].mean() < 0.002
    assert found.wire[~truth].sum() < 0.1 * found.wire.sum()
    assert (found.p_value[found.signal] <= SETTINGS.alpha * 1.001).all()
    assert np.isnan(found.p_value[~found.signal]).all()


def test_pure_noise_makes_no_lines() -> None:
    rng, density = np.random.default_rng(3), 0.16
    side = (40_000 / density / 40.0) ** 0.5
    xyz = noise(rng, density, side, side, 40.0)
    found = scan(made_cloud(xyz, density), SETTINGS)
    assert found.signal.mean() < 2 * SETTINGS.alpha + 5 / len(xyz)
    assert not found.wire.any()


def test_neither_order_nor_tiling_nor_anchor_matters() -> None:
    rng = np.random.default_rng(6)
    wires = [conductor(rng, 0.7, 240.0, y, 12.0) for y in (14.0, 17.0)]
    xyz = np.concatenate([*wires, noise(rng, 0.1, 240.0, 30.0, 24.0)])
    xyz = np.unique(xyz, axis=0)
    whole = scan(made_cloud(xyz, 0.1), SETTINGS)
    assert whole.signal.sum() > 200

    order = rng.permutation(len(xyz))
    mixed = scan(made_cloud(xyz[order], 0.1), SETTINGS)
    for name in ("signal", "wire", "p_value"):
        np.testing.assert_array_equal(getattr(mixed, name), getattr(whole, name)[order])

    asked = (xyz[:, 0] >= 100_000) & (xyz[:, 0] < 130_000)
    reach = int(reach_m(SETTINGS) * 1000)
    near = (xyz[:, 0] >= 100_000 - reach) & (xyz[:, 0] < 130_000 + reach)
    assert not near.all()
    part = scan(made_cloud(xyz[near], 0.1, asked[near]), SETTINGS)
    for name in ("signal", "wire", "p_value"):
        np.testing.assert_array_equal(getattr(part, name), getattr(whole, name)[asked])


def test_nothing_is_asked_or_there() -> None:
    rng = np.random.default_rng(7)
    xyz = noise(rng, 0.1, 20.0, 20.0, 20.0)
    off = scan(made_cloud(xyz, 0.1), WireSettings(enabled=False))
    assert not off.signal.any()
    assert reach_m(WireSettings(enabled=False)) == 0.0
    none = scan(made_cloud(xyz, 0.1, np.zeros(len(xyz), np.bool_)), SETTINGS)
    assert len(none.signal) == 0


def test_the_filter_keeps_what_the_scan_finds() -> None:
    rng = np.random.default_rng(9)
    wire = conductor(rng, 0.6, 120.0, 15.0, 20.0)
    xyz = np.concatenate([wire, noise(rng, 0.12, 120.0, 30.0, 40.0)])
    table, every = as_table(xyz), np.ones(len(xyz), np.bool_)
    density = np.full(len(xyz), 0.12)
    alone = denoise(table, density, every, FilterSettings(wires=WireSettings(enabled=False)))
    both = denoise(table, density, every, FilterSettings(wires=SETTINGS))
    found = scan(made_cloud(xyz, 0.12), SETTINGS)
    kept = both["noise_class"] == NOISE_SIGNAL
    assert kept[found.signal].all()
    # what the scan gets of alpha the test does not, so it alone keeps a few more
    by_test = alone["noise_class"] == NOISE_SIGNAL
    assert not (kept & ~found.signal & ~by_test).any()
    assert kept[by_test].mean() > 0.8
    np.testing.assert_array_equal(both["wire"], found.wire)
    assert both["wire"].any()
    assert not alone["wire"].any()
    signal = both["noise_class"][: len(wire)] == NOISE_SIGNAL
    assert signal.mean() > (alone["noise_class"][: len(wire)] == NOISE_SIGNAL).mean() + 0.2
    assert filter_reach_m(FilterSettings()) > reach_m(SETTINGS)


def test_sure_conductors_get_their_class_above_the_ground_only() -> None:
    dtm = np.full((2, 2), 50.0, np.float32)
    n = 4
    table = PointTable({
        "x": np.full(n, 500), "y": np.full(n, 500),
        "z": np.array([60_000, 51_000, 60_000, 60_000], dtype=np.int32),
        "flags": np.zeros(n, np.uint8), "input_class": np.ones(n, np.uint8),
        "noise_class": np.array([0, 0, 0, 1], np.uint8), "ground": np.zeros(n, np.uint8),
        "wire": np.array([1, 1, 0, 0], np.uint8),
    })  # fmt: skip
    cell = Bounds(0, 0, 2000, 2000)
    assert list(classify(table, cell, dtm)) == [CLASS_WIRE, 1, 1, CLASS_HIGH_NOISE]
