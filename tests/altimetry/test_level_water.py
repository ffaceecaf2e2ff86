"""Water by night and by day: gate, noise by depth, floors, and what must stay as it was."""

import itertools
import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pyarrow.csv
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import optimize
from scipy.optimize import isotonic_regression

from benchmarks.altimetry.hard_scenes import wood
from benchmarks.altimetry.photon_beams import Beam
from spl_batch.altimetry.filter import peer_filters
from spl_batch.altimetry.filter import signal as signals
from spl_batch.altimetry.noise import noise_rate as rates
from spl_batch.altimetry.noise.neighbourhoods import aspects, neighbours
from spl_batch.altimetry.photon_table import Cells
from spl_batch.altimetry.report.beam_warnings import _odd_layers, _second_surface
from spl_batch.altimetry.settings import RateSettings, SignalSettings
from spl_batch.altimetry.simulate import scene, simulate_track
from spl_batch.altimetry.water.column_noise import falling_density
from spl_batch.altimetry.water.emptiest import emptiest_band
from spl_batch.altimetry.water.level_water import NO_WATER
from spl_batch.altimetry.water.odd_layers import Layers
from spl_batch.altimetry.water.refraction import AIR, WATER, refracted
from spl_batch.altimetry.water.rolling_floor import emptier_boxes, standing_out
from spl_batch.altimetry.water.surface_height import upper_peak
from spl_batch.constants import QUANTA_PER_M
from spl_batch.errors import WorkflowError
from tests import surveys
from tests.altimetry.tracks import (
    assert_cut_matters_nowhere,
    labels,
    lattice,
    quanta,
    write_workflow,
)

RATE = RateSettings()
SIGNAL = SignalSettings()
NIGHT, DAY = 2e-4, 0.015
GATE_M = (-70.0, 30.0)
NOISE, SURFACE, FLOOR = 1, 2, 3


class WaterTrack(NamedTuple):
    """Photons along the track, their heights [m], and what they are."""

    x: np.ndarray
    z: np.ndarray
    kind: np.ndarray


def sentences(report: dict) -> list[str]:
    """What a report warns of."""
    return [f"{one['subject']}: {one['sentence']}" for one in report["findings"]]


def water_track(
    noise_per_m2: float,
    seed: int = 1,
    length_m: float = 4000.0,
    surface_per_m: float = 1.2,
    floor_per_m: float = 0.35,
    column: tuple[float, float] = (0.1, 4.0),
    depth_m: Callable[[np.ndarray], np.ndarray] = lambda x: 10.0 - 7.0 * np.sin(x / 400.0),
) -> WaterTrack:
    """Level water at 0 over a floor, by default 3 to 17 m deep, and the light that it scatters.

    That is ``column``: photons per metre, and the depth in which they fade by e [m].
    """
    rng = np.random.default_rng(seed)
    rates_per_m = (surface_per_m, floor_per_m, column[0], noise_per_m2 * 100.0)
    n = [rng.poisson(rate * length_m) for rate in rates_per_m]
    x = [rng.uniform(0.0, length_m, count) for count in n]
    z = [
        rng.normal(0.0, 0.12, n[0]),
        rng.normal(0.0, 0.2, n[1]) - depth_m(x[1]),
        -rng.exponential(column[1], n[2]),
        rng.uniform(*GATE_M, n[3]),
    ]
    kind = np.repeat([SURFACE, FLOOR, NOISE, NOISE], n)
    order = np.argsort(np.concatenate(x), kind="stable")
    return WaterTrack(*(np.concatenate(v)[order] for v in (x, z)), kind[order])


def photons(track: WaterTrack) -> tuple[np.ndarray, np.ndarray]:
    return quanta(np.stack([track.x, track.z], axis=1))


@pytest.mark.parametrize("noise", [NIGHT, DAY])
def test_the_gate_is_seen_where_a_cell_holds_hardly_any_noise(noise: float) -> None:
    cells = rates.observe(*photons(water_track(noise)), RATE)
    assert np.median(cells.gate_m) == pytest.approx(100.0, rel=0.15)
    found = rates.density_from_window(cells, RATE)
    # By night some ten photons tell of it.
    assert abs(np.log(np.median(found) / noise)) < np.log(2.0)
    assert (found > 0).all()


@pytest.mark.parametrize("noise", [NIGHT, DAY])
def test_a_floor_is_kept_and_noise_is_not(noise: float) -> None:
    track = water_track(noise)
    beam = Beam(photons(track), None)
    kept = beam.keep(beam.score())
    share = {kind: kept[track.kind == kind].mean() for kind in (NOISE, SURFACE, FLOOR)}
    assert share[SURFACE] > 0.98
    assert share[FLOOR] > 0.93
    assert (share[SURFACE] + 1.0 - share[NOISE]) / 2.0 > 0.85
    false = np.count_nonzero(kept & (track.kind == NOISE))
    assert beam.told == pytest.approx(false, rel=0.3)


@pytest.mark.parametrize("noise", [NIGHT, DAY])
def test_water_is_seen_where_the_gate_ends_low_above_it(noise: float) -> None:
    track = water_track(noise)
    near = track.z < 20.0
    cells = rates.observe(*quanta(np.stack([track.x[near], track.z[near]], axis=1)), RATE)
    assert (cells.level != NO_WATER).mean() > 0.95


def test_noise_is_seen_in_a_gate_of_a_few_bins() -> None:
    track = water_track(DAY)
    near = (track.z > -22.0) & (track.z < 8.0)
    cells = rates.observe(*quanta(np.stack([track.x[near], track.z[near]], axis=1)), RATE)
    found = rates.density_from_window(cells, RATE)
    assert np.median(found) == pytest.approx(DAY, rel=0.2)


def test_water_over_a_brighter_floor_is_seen() -> None:
    track = water_track(DAY, surface_per_m=0.5)
    cells = rates.observe(*photons(track), RATE)
    assert (np.abs(cells.level.astype(np.int64)) < 500).mean() > 0.85


class Coast(NamedTuple):
    """Photons of water and of a mountain beside it, and which of them lie over land."""

    track: WaterTrack
    land: np.ndarray


def coast(noise_per_m2: float, seed: int = 1) -> Coast:
    """Four kilometres of water, then a cliff and four of wooded mountain."""
    water = water_track(noise_per_m2, seed)
    changes = {"length_m": 4000.0, "relief_m": 300.0, "above_m": 100.0, "below_m": 100.0}
    changes |= {"noise_per_m2": noise_per_m2, "signal_per_m": 4.0, "patch": 1.0, "canopy": 0.4}
    hills = simulate_track(scene("mountain", "green", seed, **changes))
    kind = np.where(hills.truth > 0, SURFACE, NOISE)
    parts = (hills.along_m + 4000.0, hills.height_m, kind)
    track = WaterTrack(*(np.concatenate(both) for both in zip(water, parts, strict=True)))
    return Coast(track, np.repeat([False, True], [len(water.x), len(kind)]))


@pytest.mark.parametrize("noise", [NIGHT, DAY])
def test_a_cliff_takes_no_water_away(noise: float) -> None:
    found = coast(noise)
    beam = Beam(photons(found.track), None)
    kept, signal = beam.keep(beam.score()), found.track.kind != NOISE
    for place in (found.land, ~found.land):
        both = np.count_nonzero(kept & signal & place)
        assert both / np.count_nonzero(signal & place) > 0.95
        assert both / np.count_nonzero(kept & place) > 0.9
    false = np.count_nonzero(kept & ~signal)
    assert beam.told == pytest.approx(false, rel=0.3)


def test_neighbourhoods_are_as_long_as_the_slope_allows() -> None:
    x = np.repeat(np.arange(0.0, 2000.0, 0.7), 2)
    for slope, expected in ((0.0, 20.0), (0.1, 10.0), (0.6, 3.0)):
        along, height = quanta(np.stack([x, slope * x], axis=1))
        cells = rates.observe(along, height, RATE)
        assert np.median(aspects(cells, SIGNAL)) == pytest.approx(expected, rel=0.05)


@pytest.mark.parametrize(
    ("per_m", "slope", "expected"), [(0.4, 0.25, 10), (0.4, 0.0, 20), (2.0, 0.16, 20)]
)
def test_sparse_ground_has_as_many_neighbours_as_its_slope_allows(
    per_m: float, slope: float, expected: int
) -> None:
    x = np.arange(0.0, 2000.0, 1.0 / per_m)
    z = slope * np.abs(x % 400.0 - 200.0) + 40.0 * (x > 1000.0)
    cells = rates.observe(*quanta(np.stack([x, z], axis=1)), RATE)
    dry = Cells(**(cells.to_arrays() | {"level": np.full(len(cells.index), NO_WATER, np.int32)}))
    found = neighbours(dry, np.zeros(len(cells.index)), RATE, SIGNAL)
    assert np.median(found) == expected


@settings(max_examples=4, deadline=None)
@given(st.integers(1, 3), st.integers(150, 250))
def test_scores_along_a_coast_do_not_depend_on_where_it_is_cut(seed: int, cut: int) -> None:
    along, height = photons(coast(NIGHT, seed).track)
    cells = rates.observe(along, height, RATE)
    scale = rates.scale(cells, rates.density_from_window(cells, RATE), RATE, SIGNAL)
    prior = signals.log_prior(cells, scale, RATE, SIGNAL.window_m)
    rest = (scale, prior, RATE, SIGNAL)
    whole = signals.score(along, height, np.ones(len(along), np.bool_), *rest)
    reach = int((SIGNAL.reach_m + 1.0) * 1000)
    rows = np.flatnonzero(along < cut * 20_000 + reach)
    mine = along[rows] < cut * 20_000
    part = signals.score(along[rows], height[rows], mine, *rest)
    np.testing.assert_array_equal(part, whole[rows[mine]])


@pytest.mark.parametrize("noise", [NIGHT, DAY])
@pytest.mark.parametrize(
    "depth_m",
    [
        lambda x: 8.0 + 3.0 * np.sin(x / 32.0),
        lambda x: 15.0 + 13.0 * 2.0 / np.pi * np.arcsin(np.sin(x / 28.0)),
    ],
    ids=["waves of 200 m", "slope of 0.3"],
)
def test_a_floor_that_rolls_or_slopes_is_no_noise_of_the_water(
    noise: float, depth_m: Callable[[np.ndarray], np.ndarray]
) -> None:
    track = water_track(noise, length_m=3000.0, floor_per_m=0.45, depth_m=depth_m)
    beam = Beam(photons(track), None)
    kept = beam.keep(beam.score())
    floor = track.kind == FLOOR
    assert kept[floor].mean() > 0.85
    assert kept[track.kind == NOISE].mean() < 0.3


def test_the_emptier_boxes_tell_noise_and_no_floor_among_them() -> None:
    """Noise of a Poisson mean of 0.8, with a floor of 6 in a third of the boxes of two depths."""
    rng = np.random.default_rng(3)
    count = rng.poisson(0.8, (400, 16))
    count[:, 4:6] += np.where(rng.uniform(size=(400, 2)) < 0.33, 6, 0)
    full = np.ones(count.shape, np.bool_)
    mean = emptier_boxes(np.arange(400), count, full, 200)
    assert mean[200, :4] == pytest.approx(0.8, abs=0.15)
    # Its own noise of a depth is no more than that above.
    assert (np.diff(mean, axis=1) <= 0.0).all()
    assert (mean[:, 4:] > 0.3).all()
    # A cell that is full at every depth is no floor.
    count[7] = 8
    floor = standing_out(count, mean, full)
    assert not floor[7].any()
    assert floor[:, 4:6][count[:, 4:6] > 8].mean() > 0.7
    assert floor[:, :3].mean() < 0.05


def test_noise_below_a_surface_is_counted_by_depth_and_the_floor_left_out() -> None:
    cells = rates.observe(*photons(water_track(NIGHT)), RATE)
    wet = cells.level != NO_WATER
    assert wet.mean() > 0.95
    assert np.abs(cells.level[wet]).max() < 200
    column = cells.column[wet].mean(axis=0)
    assert (np.diff(cells.column[wet], axis=1) <= 0).all()
    depth = np.arange(1, 13)
    true = NIGHT + 0.1 * (np.exp(-depth / 4.0) - np.exp(-(depth + 1.0) / 4.0))
    assert np.abs(np.log(column[:12] / true)).max() < np.log(2.5)


@pytest.mark.parametrize("noise", [NIGHT, DAY])
def test_noise_of_the_first_metre_is_told_and_none_above_it(noise: float) -> None:
    beam = Beam(photons(water_track(noise)), None)
    beam.keep(beam.score())
    assert beam.scale.first.mean() == pytest.approx(noise + 0.1 * -np.expm1(-1.0 / 4.0), rel=0.3)
    along, height, each = beam.told_at
    depth = beam.depth_m(along, height)
    assert each[(depth < -0.3) & (depth >= -1.0)].sum() < 2.0 * noise * 4000.0


def test_a_rough_surface_is_no_turbid_water_and_rough_land_no_water() -> None:
    rng = np.random.default_rng(1)
    x = rng.uniform(0.0, 3000.0, 3000)

    def seen(rough_m: float, *others: np.ndarray) -> tuple[float, float]:
        track = water_track(DAY, length_m=3000.0, surface_per_m=0.0, floor_per_m=0.0, column=(0, 1))
        parts = [rng.normal(0.0, rough_m, len(x)), *others]
        along = np.concatenate([track.x, np.tile(x, len(parts))])
        places = np.stack([along, np.concatenate([track.z, *parts])], axis=1)
        cells = rates.observe(*quanta(places), RATE)
        wet = float((cells.level != NO_WATER).mean())
        return wet, float(np.median(cells.column[:, 0]))

    wet, noise = seen(0.5)
    assert wet > 0.9
    assert noise == pytest.approx(DAY, rel=0.4)
    assert seen(0.8)[0] < 0.1
    assert seen(0.8, -3.0 - rng.exponential(6.0, len(x)))[0] > 0.9
    turbid = -rng.exponential(1.5, len(x))
    reeds = np.where(
        x % 20.0 < 5.0, 2.5 * rng.beta(2.0, 2.0, len(x)), rng.normal(0.0, 0.06, len(x))
    )
    (_, alone), (_, beside) = seen(0.06, turbid), seen(0.06, turbid, reeds)
    assert alone > 10.0 * DAY
    assert beside == pytest.approx(alone, rel=0.1)


def test_crowns_by_day_are_no_water_though_light_comes_from_below() -> None:
    for seed in (0, 2):
        cells = rates.observe(*wood(0.1, DAY, seed, even=False).photons, RATE)
        assert (cells.level != NO_WATER).mean() < 0.02


@pytest.mark.parametrize("deep_m", [12.0, 26.0])
def test_a_level_floor_is_no_surface_though_it_is_brighter(deep_m: float) -> None:
    level = lambda x: np.full(len(x), deep_m)  # noqa: E731
    track = water_track(NIGHT, surface_per_m=0.9, floor_per_m=1.3, depth_m=level)
    cells = rates.observe(*photons(track), RATE)
    assert (np.abs(cells.level.astype(np.int64)) < 500).mean() > 0.9


def test_mdbscan_by_night_keeps_the_length_of_the_track() -> None:
    track = water_track(NIGHT, column=(0.0, 4.0))
    beam = Beam(photons(track), None)
    assert beam.scale.stretch.max() == pytest.approx(1.0)
    kept = beam.mdbscan(SIGNAL.mdbscan)
    assert kept[track.kind == NOISE].mean() < 0.3
    assert kept[track.kind == SURFACE].mean() > 0.95


def test_turbid_water_is_no_floor() -> None:
    track = water_track(NIGHT, floor_per_m=0.0, column=(0.7, 1.5))
    cells = rates.observe(*photons(track), RATE)
    depth = np.arange(1, 6)
    true = NIGHT + 0.7 * (np.exp(-depth / 1.5) - np.exp(-(depth + 1.0) / 1.5))
    found = cells.column[cells.level != NO_WATER].mean(axis=0)[:5]
    assert np.abs(np.log(found / true)).max() < np.log(1.3)
    beam = Beam(photons(track), None)
    wet = beam.cells.level != NO_WATER
    # Scattered light lowers the mean of a surface, and is told of all the same.
    assert np.median(beam.cells.level[wet]) < -100
    assert np.median(beam.cells.top[wet]) > -50
    deep = track.z < -1.3
    assert beam.keep(beam.score())[deep].mean() < 0.2


@pytest.mark.parametrize("noise", [NIGHT, DAY])
@pytest.mark.parametrize(
    "depth_m",
    [
        lambda x: 0.8 + 5.0 * np.abs((x / 1000.0) % 2 - 1),
        lambda x: 1.5 + 2.0 * ((x // 500.0) % 2),
    ],
    ids=["beach", "steps"],
)
def test_a_shallow_floor_is_no_turbid_water(
    noise: float, depth_m: Callable[[np.ndarray], np.ndarray]
) -> None:
    track = water_track(noise, depth_m=depth_m)
    beam = Beam(photons(track), None)
    kept = beam.keep(beam.score())
    floor = (track.kind == FLOOR) & (track.z < -1.5)
    assert kept[floor & (track.z > -3.0)].mean() > 0.8
    assert kept[floor].mean() > 0.8


def test_a_plain_with_trees_is_no_water() -> None:
    track = simulate_track(scene("flat", "infrared", 4, length_m=1500.0, canopy=1.0))
    cells = rates.observe(*lattice(track), RATE)
    assert (cells.level != NO_WATER).mean() < 0.1


@pytest.mark.parametrize("noise", [NIGHT, DAY, 0.05])
def test_trees_that_fill_a_low_gate_are_no_sky_over_water(noise: float) -> None:
    rng = np.random.default_rng(5)
    n = rng.poisson((3400, 3400, noise * 4000.0 * 30.0))
    x = rng.uniform(0.0, 4000.0, n.sum())
    trees = 15.0 * rng.beta(4.0, 2.0, n[1])
    z = np.concatenate([rng.normal(0.0, 0.3, n[0]), trees, rng.uniform(-12.0, 18.0, n[2])])
    order = np.argsort(x, kind="stable")
    cells = rates.observe(*quanta(np.stack([x, z], axis=1)[order]), RATE)
    assert (cells.level != NO_WATER).mean() < 0.2
    if noise > NIGHT:
        found = rates.density_from_window(cells, RATE)
        assert np.median(found) == pytest.approx(noise, rel=0.3)


def test_a_surface_over_a_brighter_shallow_floor_is_no_wood() -> None:
    depth = lambda x: 1.5 + 0.5 * np.sin(x / 200.0)  # noqa: E731
    track = water_track(NIGHT, surface_per_m=0.85, floor_per_m=2.1, depth_m=depth)
    cells = rates.observe(*photons(track), RATE)
    assert (cells.level != NO_WATER).mean() > 0.5


def test_crests_beside_troughs_are_no_surface_over_a_floor() -> None:
    rng = np.random.default_rng(5)
    index, n = np.arange(3), 240
    cell, piece = rng.integers(0, 3, n), rng.integers(0, 2, n)
    none = np.full(n, 3600)
    for lower, seen in ((rng.uniform(size=n) < 0.4, True), (piece == 1, False)):
        height = np.where(lower, -500, 450) + rng.integers(-60, 60, n)
        before, behind = np.where(cell > 0, height, none), np.where(cell < 2, height, none)
        over = np.stack([before, height, behind], axis=1)
        found = upper_peak(index, cell, over, piece)
        assert np.isfinite(found[1]) == seen
        if seen:
            assert found[1] == pytest.approx(450, abs=60)


def test_the_emptiest_band_is_that_of_a_count_by_hand() -> None:
    rng = np.random.default_rng(3)
    index, reach = np.array([2, 3, 4, 7, 8, 20]), 2
    cell = rng.integers(0, len(index), 300)
    depth_m = rng.uniform(-1.2, 1.2, 300)
    found = emptiest_band(index, cell, depth_m, (0.3, 1.0), reach)
    for at, here in enumerate(index):
        near = np.abs(index[cell] - here) <= reach
        bands = np.linspace(0.3, 1.0, 8)
        more = [
            np.sum(near & (depth_m >= low) & (depth_m < high))
            - np.sum(near & (-depth_m >= low) & (-depth_m < high))
            for low, high in itertools.pairwise(bands)
        ]
        assert found[at] == pytest.approx(min(more) / 0.1)


@pytest.mark.parametrize("noise", [NIGHT, DAY], ids=["night", "day"])
@pytest.mark.parametrize("floor_per_m", [0.9, 1.4, 2.8])
def test_a_shallow_floor_draws_the_surface_down_by_little(floor_per_m: float, noise: float) -> None:
    track = water_track(
        noise, floor_per_m=floor_per_m, surface_per_m=1.4, depth_m=lambda x: 1.0 + 0.0 * x
    )
    cells = rates.observe(*photons(track), RATE)
    level = cells.level[cells.level != NO_WATER] / QUANTA_PER_M
    assert len(level) > 0.9 * len(cells.level)
    assert np.median(np.abs(level)) < 0.06


@settings(max_examples=4, deadline=None)
@given(st.integers(1, 3), st.integers(20, 180))
def test_water_does_not_depend_on_where_the_track_is_cut(seed: int, cut: int) -> None:
    assert_cut_matters_nowhere(*photons(water_track(NIGHT, seed)), cut)


def test_a_rough_surface_does_not_depend_on_where_the_track_is_cut() -> None:
    track = water_track(NIGHT, length_m=13_000.0, surface_per_m=0.6)
    rough = track._replace(z=np.where(track.kind == SURFACE, 5.0 * track.z, track.z))
    assert_cut_matters_nowhere(*photons(rough), 430)


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 30))
def test_falling_densities_are_isotonic_regression(seed: int, depths: int) -> None:
    rng = np.random.default_rng(seed)
    count = rng.poisson(3.0, (2, depths)).astype(float)
    area = rng.uniform(0.5, 4.0, (2, depths))
    out = np.empty((2, depths))
    falling_density(count, area, out)
    for r in range(2):
        expected = isotonic_regression(count[r] / area[r], weights=area[r], increasing=False).x
        np.testing.assert_allclose(out[r], expected, atol=1e-12)
    falling_density(count, np.zeros_like(area), out)
    assert (out == 0).all()


def test_a_single_stray_photon_does_not_take_a_stretch_away() -> None:
    counts, far = np.zeros((1, 50), np.int64), np.zeros((1, 50), np.int64)
    counts[0, 40], counts[0, 20:22] = 100, 50
    far[0, 41] = counts[0, 41] = 1
    least = signals.thresholds(counts, far, np.array([210.0]), 0.0005)
    assert least[0] <= 20
    far[0, 20] = counts[0, 20] = 20
    assert signals.thresholds(counts, far, np.array([210.0]), 0.0005)[0] > 20


def test_the_sky_s_noise_varies_below_a_surface_as_it_does_above() -> None:
    track = water_track(NIGHT, length_m=6000.0)
    rng = np.random.default_rng(7)
    x = rng.uniform(0.0, 6000.0, rng.poisson(2 * DAY * 100.0 * 6000.0))
    # Brighter and darker stretches of 300 m, which a kilometre of track averages.
    share = np.where((x // 300.0) % 2 == 0, 1.0, 0.2)
    x = x[rng.uniform(size=len(x)) < share]
    z = rng.uniform(*GATE_M, len(x))
    order = np.argsort(np.concatenate([track.x, x]), kind="stable")
    both = (np.concatenate(v)[order] for v in ((track.x, x), (track.z, z)))
    cells = rates.observe(*quanta(np.stack(list(both), axis=1)), RATE)
    scale = rates.scale(cells, rates.density_from_window(cells, RATE), RATE, SIGNAL)
    deep = scale.column[:, 40:60].mean(axis=1)
    middle = (cells.index % 15 >= 4) & (cells.index % 15 <= 10)
    bright = (cells.index // 15) % 2 == 0
    contrast = [
        np.median(found[middle & bright]) / np.median(found[middle & ~bright])
        for found in (scale.density, deep)
    ]
    assert contrast[0] > 1.5
    assert contrast[1] == pytest.approx(contrast[0], rel=0.15)
    assert deep.mean() == pytest.approx(cells.column[:, 40:60].mean(), rel=0.05)


@pytest.mark.parametrize("angle_deg", [0.0, 0.4, 1.0, 5.0, 15.0, 40.0])
def test_refraction_is_that_of_the_paper(angle_deg: float) -> None:
    """The triangle of C. Parrish et al. (2019), Eq. 1 to 9, where the product adds vectors."""
    depth = np.array([0.1, 0.5, 2.0, 10.0, 25.0, 38.0])
    one = np.radians(angle_deg)
    two = np.arcsin(1.00029 * np.sin(one) / 1.34116)
    s = depth / np.cos(one)
    r = s * 1.00029 / 1.34116
    p = np.sqrt(r**2 + s**2 - 2.0 * r * s * np.cos(one - two))
    alpha = np.arcsin(r * np.sin(one - two) / p)
    beta = np.pi / 2.0 - one - alpha
    across, up = refracted(depth, angle_deg)
    np.testing.assert_allclose(up, p * np.sin(beta), rtol=1e-9)
    np.testing.assert_allclose(across, p * np.cos(beta), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("angle_deg", [0.4, 5.0, 30.0])
def test_refraction_is_that_of_the_ray_that_takes_least_time(angle_deg: float) -> None:
    """Fermat's principle, without Snell's law: to a floor 10 m deep, from 400 m above the water."""
    high, deep = 400.0, 10.0
    floor = high * np.tan(np.radians(angle_deg)) + 2.0

    def time(at: float) -> float:
        return float(AIR * np.hypot(at, high) + WATER * np.hypot(floor - at, deep))

    at = optimize.minimize_scalar(time, bounds=(0.0, floor), options={"xatol": 1e-10}).x
    angle = np.arctan2(at, high)
    # The product goes on in air for as much time as the light takes in water.
    apparent = WATER / AIR * np.hypot(floor - at, deep)
    across, up = refracted(np.array([apparent * np.cos(angle)]), float(np.degrees(angle)))
    assert up[0] == pytest.approx(apparent * np.cos(angle) - deep, abs=1e-5)
    assert across[0] == pytest.approx(at + apparent * np.sin(angle) - floor, abs=1e-4)


def test_refraction_moves_nothing_above_water_and_a_quarter_of_the_depth_below() -> None:
    across, up = refracted(np.array([-1.0, 0.0, 8.0]), 0.0)
    np.testing.assert_allclose(up, [0.0, 0.0, 8.0 * (1.0 - AIR / WATER)])
    assert up[2] == pytest.approx(2.0, rel=0.02)
    assert (across == 0).all()


def test_a_run_tells_surface_floor_and_column_apart(tmp_path: Path) -> None:
    track = water_track(NIGHT, length_m=2500.0)
    rows = [f"{x:.3f},{z:.3f}" for x, z in zip(track.x, track.z, strict=True)]
    (tmp_path / "photons.csv").write_text("\n".join(["along_track,height", *rows]) + "\n")
    workflow = write_workflow(tmp_path, "photons.csv", outputs={"refraction": True})
    ended = surveys.command("run", workflow, "--workers", 0)
    assert ended.status == 0, ended.text
    table = labels(tmp_path / "out", "photons/track")
    assert (table["water"][track.kind == SURFACE] == 41).mean() > 0.95
    assert (table["water"][track.kind == FLOOR] == 40).mean() > 0.9
    assert set(np.unique(table["water"])) == {0, 40, 41, 45}
    lifted = table["height_refracted"] - table["height"]
    floor = table["water"] == 40
    np.testing.assert_allclose(
        lifted[floor], -table["height"][floor] * (1.0 - AIR / WATER), atol=0.1
    )
    assert (lifted[table["water"] == 41] == 0).all()
    path = tmp_path / "out/profiles/photons/track.csv"
    assert "nan" not in path.read_text()
    profile = pyarrow.csv.read_csv(path).to_pydict()
    columns = {name: np.array(values, float) for name, values in profile.items()}
    assert (columns["water"] == 1).all()
    # One line: the surface, never the floor, whose depth is no height of a canopy either.
    assert np.nanmax(np.abs(columns["ground"])) < 0.3
    assert np.isfinite(columns["ground"]).mean() > 0.95
    assert np.isnan(columns["canopy_height"]).all()
    depth = 10.0 - 7.0 * np.sin(columns["along_track"] / 400.0)
    seen = np.isfinite(columns["floor"])
    assert seen.mean() > 0.9
    assert np.median(np.abs(columns["floor"] + depth)[seen]) < 0.1
    assert (np.abs(columns["floor"] + depth)[seen] < 1.0).mean() > 0.95
    np.testing.assert_allclose(
        columns["floor_refracted"][seen], columns["floor"][seen] * AIR / WATER, atol=0.1
    )


def test_a_rate_that_is_not_seen_is_said(tmp_path: Path) -> None:
    track = water_track(0.0, length_m=1500.0)
    alone = track.kind == SURFACE
    rows = [f"{x:.3f},{z:.3f}" for x, z in zip(track.x[alone], track.z[alone], strict=True)]
    (tmp_path / "photons.csv").write_text("\n".join(["along_track,height", *rows]) + "\n")
    workflow = write_workflow(tmp_path, "photons.csv")
    assert surveys.command("run", workflow, "--workers", 0).status == 0
    said = " ".join(sentences(json.loads((tmp_path / "out/report.json").read_text())))
    assert "no noise is seen" in said
    assert "photons are signal; nothing is told apart" in said


def test_a_track_of_few_photons_far_apart_is_said(tmp_path: Path) -> None:
    rows = [f"{300 * i},{40 * (i % 3)}" for i in range(6)]
    (tmp_path / "photons.csv").write_text("\n".join(["along_track,height", *rows]) + "\n")
    workflow = write_workflow(tmp_path, "photons.csv")
    assert surveys.command("run", workflow, "--workers", 0).status == 0
    report = json.loads((tmp_path / "out/report.json").read_text())
    assert report["counts"]["signal"] == 0
    assert "no photon is signal: nothing but noise is seen" in " ".join(sentences(report))


def test_a_bright_cloud_over_water_is_said_and_hides_no_surface(tmp_path: Path) -> None:
    track = water_track(NIGHT, length_m=2500.0)
    rng = np.random.default_rng(2)
    cloud = np.stack([rng.uniform(500.0, 2000.0, 3000), rng.normal(90.0, 2.0, 3000)], axis=1)
    photons = np.concatenate([np.stack([track.x, track.z], axis=1), cloud])
    text = "\n".join(["along_track,height", *(f"{x:.3f},{z:.3f}" for x, z in photons)])
    (tmp_path / "photons.csv").write_text(text + "\n")
    workflow = write_workflow(tmp_path, "photons.csv")
    assert surveys.command("run", workflow, "--workers", 0).status == 0
    said = " ".join(sentences(json.loads((tmp_path / "out/report.json").read_text())))
    assert "a layer that floats as a cloud does" in said
    kept = labels(tmp_path / "out", "photons/track")["signal"] == 1
    assert kept[: len(track.x)][track.kind == SURFACE].mean() > 0.9
    assert kept[len(track.x) :].mean() < 0.1


def test_published_filters_keep_a_surface() -> None:
    pytest.importorskip("sklearn")
    track = water_track(DAY, length_m=600.0)
    for name in peer_filters.PEERS:
        kept = peer_filters.keep(name, track.x, track.z)
        assert kept[track.kind == SURFACE].mean() > 0.9, name
        assert kept[track.kind == NOISE].mean() < 0.6, name
        assert len(peer_filters.keep(name, track.x[:0], track.z[:0])) == 0


def test_a_missing_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "sklearn", None)
    with pytest.raises(WorkflowError, match=r"spl-batch\[peers\]"):
        peer_filters.keep("yapc", np.zeros(3), np.zeros(3))


def test_layers_that_may_be_neither_land_nor_floor_are_told() -> None:
    rng = np.random.default_rng(3)
    x = np.arange(0.0, 4000.0, 2.0)

    def told(floor: np.ndarray, beside: tuple[float, ...] = (0.0,)) -> list[str]:
        layers = Layers(0.0, 4000.0)
        water = rng.normal(0.0, 0.1, len(x)) + rng.choice(beside, len(x))
        layers.add(np.concatenate([x, x]), np.concatenate([water, floor]), 1.0)
        facts = {"layers": layers.facts(), "surface": int(layers.surface.sum())}
        return list(_odd_layers({**facts, "floor": int(layers.depths.sum())}))

    floor = 10.0 - 7.0 * np.sin(x / 400.0)
    assert told(floor) == []
    (echo,) = told(
        np.where(np.arange(len(x)) % 3 == 0, 2.5 + rng.uniform(-0.4, 0.4, len(x)), floor)
    )
    assert "2.5 m below the water surface" in echo
    (under,) = told(floor, (0.0, 0.0, 0.6))
    assert "photons more lie 0.3 to 1 m below the water surface than as far above it" in under
    (cloud,) = told(np.where((x >= 1000.0) & (x < 1400.0), -12.0, floor))
    assert "200 signal photons between 1 and 1.4 km lie more than 1 m above" in cloud


@pytest.mark.parametrize(
    ("far", "doubtful", "said"),
    [(300, 0, True), (9, 0, False), (900, 90_000, False), (90, 0, False)],
)
def test_a_second_surface_among_the_signal_is_said(far: int, doubtful: int, *, said: bool) -> None:
    chosen = {"far_signal": far, "doubtful": {"photons": doubtful}}
    found = list(_second_surface(chosen, 100_000, 5e-4))
    assert ["a second surface is among the signal" in text for text in found] == [True] * said
