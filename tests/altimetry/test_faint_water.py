"""Water that is seen by few photons, shallow floors below it, and land that is none."""

from collections.abc import Callable

import numpy as np
import pytest

from benchmarks.altimetry.hard_scenes import dry
from benchmarks.altimetry.labelled_tracks import LAND
from benchmarks.altimetry.odd_tracks import SCENES, Scene, make
from benchmarks.altimetry.photon_beams import RATE, Beam, Photons
from benchmarks.altimetry.unseen_tracks import Country, taiga
from spl_batch.altimetry.noise import noise_rate as rates
from spl_batch.altimetry.photon_table import along_track
from spl_batch.altimetry.report.beam_warnings import _dark_water, _maybe_river
from spl_batch.altimetry.water.between_banks import above_rivers, between_banks
from spl_batch.altimetry.water.emptiest import Photons as Cloud
from spl_batch.altimetry.water.level_water import NO_WATER, find_layers
from spl_batch.altimetry.water.levelness import is_water
from spl_batch.altimetry.water.trees_over import grown_over
from tests.altimetry.test_level_water import (
    DAY,
    FLOOR,
    NIGHT,
    NOISE,
    SURFACE,
    WaterTrack,
    photons,
    water_track,
)
from tests.altimetry.tracks import assert_cut_matters_nowhere, quanta

Depth = Callable[[np.ndarray], np.ndarray]


def lagoon(x: np.ndarray) -> np.ndarray:
    """Depths of 1 to 6 m."""
    return 3.5 + 2.5 * np.sin(x / 300.0)


def reef(x: np.ndarray) -> np.ndarray:
    """A floor 1.3 m below the surface all along."""
    return np.full(len(x), 1.3)


@pytest.mark.parametrize("noise", [NIGHT, DAY])
@pytest.mark.parametrize("surface_per_m", [0.1, 0.3])
def test_a_faint_surface_over_a_bright_floor_is_seen(noise: float, surface_per_m: float) -> None:
    track = water_track(
        noise, surface_per_m=surface_per_m, floor_per_m=1.4, depth_m=lagoon, column=(0.02, 4.0)
    )
    beam = Beam(photons(track), None)
    wet = beam.cells.level != NO_WATER
    assert beam.cells.calm.mean() > 0.9
    assert np.median(np.abs(beam.cells.level[wet].astype(np.int64))) < 200
    kept, signal = beam.keep(beam.score()), track.kind != NOISE
    assert kept[track.kind == SURFACE].mean() > (0.9 if noise == NIGHT else 0.6)
    assert kept[track.kind == FLOOR].mean() > 0.97
    assert kept[signal].mean() + 1.0 - kept[~signal].mean() > (1.6 if noise == NIGHT else 1.9)


def test_water_below_a_thin_cloud_is_no_plain_with_trees() -> None:
    track = make("cloud", SCENES["cloud in the gate"], 1)
    cells = rates.observe(*track.photons, RATE)
    x = (cells.index + 0.5) * RATE.cell_m
    # The cloud hides the water along 450 of 1500 m; elsewhere it is thin.
    assert (cells.level[x % 1500.0 > 470.0] != NO_WATER).mean() > 0.95


@pytest.mark.parametrize("depth_m", [lagoon, reef])
def test_a_floor_near_the_surface_draws_it_nowhere(depth_m: Depth) -> None:
    track = water_track(NIGHT, surface_per_m=0.9, floor_per_m=1.8, depth_m=depth_m)
    beam = Beam(photons(track), None)
    calm = beam.cells.calm
    assert calm.mean() > 0.75
    assert np.quantile(np.abs(beam.cells.level[calm].astype(np.int64)), 0.9) < 250
    depth = beam.depth_m(*photons(track))
    floor = track.kind == FLOOR
    assert (depth[floor] > 1.0).mean() > 0.75


@pytest.mark.parametrize("roofs", [False, True])
def test_a_plain_below_roofs_and_crests_is_no_floor(roofs: bool) -> None:  # noqa: FBT001
    rng = np.random.default_rng(6)
    x = np.sort(rng.uniform(0.0, 4000.0, 5000))
    block = (x // 35.0).astype(np.int64)
    built = roofs & (x % 35.0 < 20.0)
    z = 2.0 * np.sin(x / 90.0) * (not roofs) + built * (6.0 + 6.0 * (block * 7919 % 4))
    z += rng.normal(0.0, 0.3, len(x))
    cells = rates.observe(*quanta(np.stack([x, z], axis=1)), RATE)
    assert (cells.calm & (cells.level > 3000)).mean() < 0.02
    assert roofs or not cells.calm.any()


@pytest.mark.parametrize("noise", [NIGHT, DAY])
@pytest.mark.parametrize("relief_m", [12.0, 30.0])
def test_dry_hills_are_no_water(noise: float, relief_m: float) -> None:
    number = np.arange(1, 80)
    for seed in range(3):
        rng = np.random.default_rng(seed)
        high, phase = rng.rayleigh(1.0, 79) / number**2.0, rng.uniform(0.0, 2.0 * np.pi, 79)

        def land(x: np.ndarray, high: np.ndarray = high, phase: np.ndarray = phase) -> np.ndarray:
            waves = high * np.sin(2.0 * np.pi * number * x[:, None] / 4000.0 + phase)
            z: np.ndarray = waves.sum(axis=1)
            return z * relief_m / 2.5

        scene = Scene(noise, land=((0.0, 4000.0),), land_m=land, gate_m=(-100.0, 150.0))
        track = make("hills", scene, seed)
        assert (track.label == LAND).any()
        cells = rates.observe(*track.photons, RATE)
        assert cells.calm.mean() < 0.03


def test_swell_averages_out_along_the_track_and_ground_does_not() -> None:
    index = np.arange(200)
    swell = 0.3 * np.sin(2.0 * np.pi * index / 9.0)
    slow = 0.3 * np.sin(2.0 * np.pi * index / 60.0)
    none = np.zeros(200, np.bool_)
    assert is_water(index, swell, none, none, 20.0, 25)[5:-5].all()
    assert not is_water(index, slow, none, ~none, 20.0, 25).any()
    assert not is_water(index, 0.003 * 20.0 * index, none, ~none, 20.0, 25).any()
    # A layer below a surface is a floor, however the surface runs.
    assert is_water(index, slow, ~none, none, 20.0, 25).all()
    assert not is_water(index, np.full(200, np.nan), ~none, none, 20.0, 25).any()
    # Without light from below it has to be twice as level.
    tilted = 0.0008 * 20.0 * index
    assert is_water(index, tilted, none, ~none, 20.0, 25).all()
    assert not is_water(index, tilted, none, none, 20.0, 25).any()


def test_where_two_floors_meet_the_water_is_no_denser() -> None:
    steps = lambda x: 2.0 + 4.0 * ((x // 250.0) % 2)  # noqa: E731
    track = water_track(NIGHT, floor_per_m=1.3, depth_m=steps, column=(0.07, 4.0))
    cells = rates.observe(*photons(track), RATE)
    found = np.median(cells.column[cells.level != NO_WATER, :2], axis=0)
    true = NIGHT + 0.07 * (np.exp(-np.array([1, 2]) / 4.0) - np.exp(-np.array([2, 3]) / 4.0))
    assert np.abs(np.log(found / true)).max() < np.log(2.5)


@pytest.mark.parametrize("cut", [61, 333])
def test_a_lagoon_does_not_depend_on_where_the_track_is_cut(cut: int) -> None:
    track = water_track(NIGHT, length_m=13_000.0, surface_per_m=0.2, depth_m=lagoon)
    assert_cut_matters_nowhere(*photons(track), cut)


def test_a_dry_flat_is_no_water() -> None:
    """Relief of 3 m along 4 km: a third of it had been called water."""
    cells = rates.observe(*dry(3.0, 1.5, DAY, 5).photons, RATE)
    assert (cells.level != NO_WATER).mean() > 0.9
    assert not cells.calm.any()


def river(
    wide_m: float, noise: float, seed: int = 1, under: float = 0.35
) -> tuple[WaterTrack, np.ndarray]:
    """Water between banks of 4 m that roll, with a floor 3 m deep; and where it is (n,) bool."""
    rng = np.random.default_rng(seed)
    shot = np.arange(0.0, 3000.0, 0.7)
    off = np.abs(shot - 1500.0) - wide_m / 2.0
    land = np.clip(0.3 * off, 0.0, 4.0) + np.clip(off / 40.0, 0.0, 1.0) * np.sin(shot / 37.0)
    layers = (
        (1.0 * (off >= 0.0), land, 0.15, 4), (1.0 * (off < 0.0), 0.0, 0.1, SURFACE),
        (under * (off < 0.0), -3.0, 0.2, FLOOR),
    )  # fmt: skip
    parts = []
    for rate, height, spread, kind in layers:
        at = np.repeat(np.arange(len(shot)), rng.poisson(np.broadcast_to(rate, shot.shape)))
        z = np.broadcast_to(height, shot.shape)[at] + rng.normal(0.0, spread, len(at))
        parts.append(np.stack([shot[at], z, np.full(len(at), kind)]))
    sky = rng.uniform((0.0, -50.0), (3000.0, 50.0), (rng.poisson(noise * 3e5), 2)).T
    x, z, kind = np.concatenate([*parts, [*sky, np.full(sky.shape[1], NOISE)]], axis=1)
    order = np.argsort(x, kind="stable")
    return WaterTrack(x[order], z[order], kind[order]), np.abs(x[order] - 1500.0) < wide_m / 2.0


@pytest.mark.parametrize("noise", [NIGHT, DAY])
@pytest.mark.parametrize("wide_m", [160.0, 500.0])
def test_a_river_between_banks_has_a_surface_and_a_floor(wide_m: float, noise: float) -> None:
    track, inside = river(wide_m, noise)
    along, height = photons(track)
    cells = rates.observe(along, height, RATE)
    calm = cells.calm[np.searchsorted(cells.index, along // 20_000)]
    assert calm[inside].mean() > 0.9
    assert calm[~inside].mean() < 0.02
    level = cells.level[cells.calm] / 1000.0
    assert np.abs(level).max() < 0.2


def test_dark_level_cells_between_banks_are_land_that_may_be_a_river() -> None:
    track, inside = river(300.0, DAY, under=0.0)
    along, height = photons(track)
    cells = rates.observe(along, height, RATE)
    at = np.searchsorted(cells.index, along // 20_000)
    assert not cells.calm.any()
    assert cells.maybe[at][inside].mean() > 0.9
    assert cells.maybe[at][~inside].mean() < 0.05
    told = along_track(cells.index[cells.maybe], 20.0)
    (text,) = _maybe_river(told)
    assert "0.3 km of track between 1.34 and 1.64 km are level between higher banks" in text
    (text,) = _maybe_river(along_track(np.array([3, 4, 9]), 20.0))
    assert "0.06 km of track in 2 pieces between 0.06 and 0.2 km are level" in text
    assert not list(_maybe_river({}))


@pytest.mark.parametrize("noise", [NIGHT, DAY])
def test_water_of_which_nothing_shows_but_its_level_may_be_a_plain(noise: float) -> None:
    plain = Scene(
        noise,
        land=((0.0, 4000.0),),
        land_m=lambda x: 0.02 * np.sin(x / 200.0),
        gate_m=(-60.0, 99.0),
    )
    dark = [
        rates.observe(*make("plain", one, 0).photons, RATE).dark.mean()
        for one in (plain, Scene(noise))
    ]
    assert dark[0] > 0.9
    assert dark[1] == 0.0
    (text,) = _dark_water(along_track(np.arange(200), 20.0))
    assert "water or a flat plain" in text
    assert not list(_dark_water({}))
    assert not list(_dark_water(along_track(np.arange(24), 20.0)))


def test_a_level_bank_is_no_water_of_its_river() -> None:
    index = np.arange(60)
    river_m = np.where(index < 20, 5.0, np.nan)
    level_m = np.where(index < 20, 5.0, 6.5)
    found = above_rivers(index, level_m, river_m, 25)
    np.testing.assert_array_equal(found, (index >= 20) & (index < 45))


def hedges() -> tuple[np.ndarray, np.ndarray]:
    """Level fields of 200 m, 3 m below others, full of hedges of 1 to 2.4 m."""
    rng = np.random.default_rng(3)
    x = np.sort(rng.uniform(0.0, 3000.0, 4000))
    low = x % 600.0 < 200.0
    z = np.where(low, 0.0, 3.0) + rng.normal(0.0, 0.05, 4000)
    tops = np.where(low, rng.uniform(1.0, 2.4, 4000), z)[::2]
    track = np.stack([np.r_[x, x[::2]], np.r_[z, tops]], axis=1)
    return quanta(track[np.argsort(track[:, 0], kind="stable")])


def spruces() -> tuple[np.ndarray, np.ndarray]:
    """Sparse spruces on hills, by night."""
    country = Country(0)
    taiga(country)
    return country.labelled("taiga").photons


def glass() -> tuple[np.ndarray, np.ndarray]:
    """Glass 4.5 m above level land amid woods, whose crowns stand higher."""
    country = Country(2)
    inside = np.abs(country.x - 2000.0) < 200.0
    hills = 2.0 * np.sin(country.x / 150.0) * ~inside
    country.ground(np.where(inside, 0.3, 0.5), hills, 0.1)
    country.layer(0.6 * inside, 4.5, LAND, lambda n: country.rng.normal(0.0, 0.12, n))
    country.trees(0.6 * ~inside, hills, 15.0)
    country.sky(NIGHT, (-50.0, 60.0))
    return country.labelled("glass").photons


@pytest.mark.parametrize("land", [hedges, spruces, glass])
def test_what_stands_level_above_land_by_chance_is_no_river(land: Callable[[], Photons]) -> None:
    along, height = land()
    index, cell = np.unique(along // 20_000, return_inverse=True)
    found = between_banks(index, cell, height, find_layers(index, cell, height)[2], 20.0)
    assert not np.isfinite(found.level_m).any()


@pytest.mark.parametrize("cut", [70, 78])
def test_a_river_does_not_depend_on_where_the_track_is_cut(cut: int) -> None:
    assert_cut_matters_nowhere(*photons(river(500.0, DAY)[0]), cut)


def test_land_beside_water_is_no_empty_sky() -> None:
    rng = np.random.default_rng(4)
    cell = np.repeat(np.arange(40), 26)
    height = rng.integers(-50_000, 60_000, len(cell)).astype(np.int32)
    level = np.where(np.arange(40) % 10 < 6, 0, NO_WATER).astype(np.int32)
    wet, gate = level != NO_WATER, (np.full(40, -50_000, np.int32), np.full(40, 60_000, np.int32))
    shown = wet, np.zeros(40, np.bool_)
    assert not grown_over(Cloud(np.arange(40), cell, height), gate, level, shown, 1000).any()
