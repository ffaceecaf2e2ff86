"""Gate, noise rate and neighbourhoods where floors or woods fill a gate, or signal is sparse."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.altimetry.photon_beams import SIGNAL, Beam
from spl_batch.altimetry.noise import noise_rate as rates
from spl_batch.altimetry.noise.crowding import _pairs
from spl_batch.altimetry.noise.gate import STRETCH_CELLS
from spl_batch.altimetry.noise.neighbourhoods import aspects
from spl_batch.altimetry.settings import RateSettings
from spl_batch.altimetry.simulate import scene, simulate_track
from spl_batch.altimetry.water.emptiest import Photons, emptiest
from spl_batch.altimetry.water.level_water import NO_WATER
from tests.altimetry.test_level_water import DAY, NIGHT, WaterTrack, photons, water_track
from tests.altimetry.tracks import assert_cut_matters_nowhere, lattice, quanta

RATE = RateSettings()
BRIGHT = 0.03


def only(track: WaterTrack, rows: np.ndarray) -> WaterTrack:
    return WaterTrack(track.x[rows], track.z[rows], track.kind[rows])


def test_a_bright_deep_floor_does_not_hide_the_upper_end_of_the_gate() -> None:
    track = water_track(NIGHT, floor_per_m=1.0, depth_m=lambda x: np.full(len(x), 17.0))
    cells = rates.observe(*photons(track), RATE)
    # Some eight photons of 2 km lie more than 10 m above the water, a thousand in its floor.
    assert np.median(cells.high) / 1000.0 > 22.0


def test_a_floor_brighter_than_the_surface_is_no_empty_window() -> None:
    noise = 0.002
    track = water_track(
        noise, floor_per_m=1.0, depth_m=lambda x: 27.0 + 3.0 * np.sin(x / 60.0), seed=1
    )
    cells = rates.observe(*photons(track), RATE)
    # The surface's own bin, not one between it and the floor.
    assert (np.abs(cells.peak / 1000.0) <= RATE.slice_m).all()
    found = rates.density_from_window(cells, RATE)
    assert np.median(found) == pytest.approx(noise, rel=0.4)


def test_noise_below_water_is_never_taken_for_the_sky_s() -> None:
    """No bin of 10 m fits between the water and the end of the gate; those below it do."""
    track = water_track(NIGHT, column=(1.0, 10.0))
    low = only(track, track.z < 3.0)
    found = rates.density_from_window(rates.observe(*photons(low), RATE), RATE)
    assert np.median(found) < 3.0 * NIGHT


def test_a_window_of_no_length_tells_of_no_rate() -> None:
    cells = rates.observe(*photons(water_track(NIGHT)), RATE)
    hardly = np.ones_like(cells.empty_length)
    cells = replace(cells, empty_count=np.zeros_like(hardly), empty_length=hardly)
    found = rates.density_from_window(cells, RATE)
    bound = rates.NOTHING_SEEN / ((STRETCH_CELLS + 1) * RATE.cell_m * rates.WINDOW_LEAST_M)
    assert found.max() <= bound * (1.0 + 1e-9)
    assert rates.unseen(cells, RATE) == 1.0


def wood(
    noise_per_m2: float, gate_m: tuple[float, float], crowns_m: tuple[float, float], seed: int = 1
) -> WaterTrack:
    """Woods on gentle ground, 3 km of them: half a photon per metre of ground, 0.8 of crowns."""
    rng = np.random.default_rng(seed)
    length_m = 3000.0
    n = [rng.poisson(rate * length_m) for rate in (0.5, 0.8, noise_per_m2 * np.diff(gate_m)[0])]
    x = [rng.uniform(0.0, length_m, count) for count in n]
    hill = [4.0 * np.sin(one / 400.0) for one in x]
    z = [
        hill[0] + rng.normal(0.0, 0.15, n[0]),
        hill[1] + crowns_m[0] + np.diff(crowns_m)[0] * rng.beta(3.0, 2.0, n[1]),
        rng.uniform(*gate_m, n[2]),
    ]
    track = WaterTrack(np.concatenate(x), np.concatenate(z), np.repeat([4, 4, 1], n))
    order = np.lexsort((track.z, track.x))
    inside = (track.z > gate_m[0]) & (track.z < gate_m[1])
    return only(track, order[inside[order]])


def test_a_bright_sky_shows_the_ends_of_each_cell_s_gate() -> None:
    track = simulate_track(
        scene(
            "mountain", "green", 2, length_m=600.0, noise_per_m2=0.3, signal_per_m=5.0, canopy=0.2
        )
    )
    cells = rates.observe(*lattice(track), RATE)
    assert np.median(cells.gate_m) == pytest.approx(1200.0, abs=6.0)


@pytest.mark.parametrize("gate_m", [(-60.0, 140.0), (-30.0, 60.0), (-15.0, 45.0)])
@pytest.mark.parametrize("crowns_m", [(18.0, 27.0), (2.0, 25.0)])
def test_woods_by_night_are_not_taken_for_their_gate(
    gate_m: tuple[float, float], crowns_m: tuple[float, float]
) -> None:
    track = wood(2e-5, gate_m, crowns_m)
    beam = Beam(photons(track), None)
    assert (beam.cells.level == NO_WATER).mean() > 0.9
    kept = beam.keep(beam.score())
    assert kept[track.kind == 4].mean() > 0.8


@pytest.mark.parametrize("crowns_m", [(18.0, 27.0), (2.0, 25.0)])
def test_noise_is_seen_between_and_around_crowns(crowns_m: tuple[float, float]) -> None:
    cells = rates.observe(*photons(wood(DAY, (-20.0, 40.0), crowns_m)), RATE)
    found = rates.density_from_window(cells, RATE)
    assert np.median(found) == pytest.approx(DAY, rel=0.25)


def test_what_is_emptiest_makes_noise_no_thinner() -> None:
    track = wood(DAY, (-60.0, 60.0), (0.0, 1.0))
    noise = only(track, track.kind == 1)
    index, cell = np.unique(noise.x // RATE.cell_m, return_inverse=True)
    height = np.rint(noise.z * 1000.0).astype(np.int32)
    low, high = (np.full(len(index), end) for end in (-60_000, 60_000))
    some, middle = np.ones(len(index), np.bool_), np.zeros(len(index), np.int64)
    seen = Photons(index.astype(np.int64), cell, height)
    count, length = emptiest(seen, (low, high), middle, some, 10)
    assert length.sum() == pytest.approx(30_000 * len(index), rel=0.1)
    found = count.sum() / (length.sum() / 1000.0 * RATE.cell_m)
    assert found == pytest.approx(DAY, rel=0.1)


@settings(max_examples=3, deadline=None)
@given(st.integers(1, 5), st.integers(30, 120))
def test_woods_do_not_depend_on_where_the_track_is_cut(seed: int, cut: int) -> None:
    assert_cut_matters_nowhere(*photons(wood(NIGHT, (-15.0, 45.0), (18.0, 27.0), seed)), cut)


def sparse(slope: float, seed: int = 1, length_m: float = 4000.0) -> tuple[np.ndarray, np.ndarray]:
    """Ground that goes up and down, 0.25 photons a metre: (n, 2) [m], and which are signal."""
    rng = np.random.default_rng(seed)
    x = rng.uniform(0.0, length_m, rng.poisson(0.25 * length_m))
    z = slope * np.abs(x % 800.0 - 400.0) + rng.normal(0.0, 0.15, len(x))
    sky = rng.uniform((0.0, -60.0), (length_m, 120.0), (rng.poisson(BRIGHT * 180.0 * length_m), 2))
    track = np.concatenate([np.stack([x, z], axis=1), sky])
    order = np.argsort(track[:, 0], kind="stable")
    return track[order], (np.arange(len(track)) < len(x))[order]


def test_pairs_are_counted_in_boxes_of_an_absolute_lattice() -> None:
    rng = np.random.default_rng(5)
    along = np.sort(rng.integers(-90_000, 90_000, 300))
    along[200:] += 500_000
    height = rng.integers(-9_000, 30_000, 300).astype(np.int32)
    index, cell = np.unique(along // 20_000, return_inverse=True)
    found = _pairs(index, along, cell, height, 20.0, (600.0, 6.0))
    expected = np.zeros(cell.max() + 1)
    for i in range(300):
        for shift in (0, 5_000):
            same = along // 60_000 == along[i] // 60_000
            same &= (height + shift) // 10_000 == (height[i] + shift) // 10_000
            expected[cell[i]] += (np.count_nonzero(same) - 1) / 2.0
    np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize(("slope", "low", "high"), [(0.0, 20.0, 20.0), (0.1, 8.0, 20.0),
    (0.6, 3.0, 5.0)])  # fmt: skip
def test_sparse_ground_under_a_bright_sky_has_neighbourhoods_of_its_slope(
    slope: float, low: float, high: float
) -> None:
    cells = rates.observe(*quanta(sparse(slope)[0]), RATE)
    assert low <= np.median(aspects(cells, SIGNAL)) <= high


def test_sparse_level_ground_is_found_by_day() -> None:
    """Four fifths of the F1 is found; with the shortest neighbourhoods a third was."""
    track, signal = sparse(0.004)
    beam = Beam(quanta(track), None)
    kept = beam.keep(beam.score())
    both = np.count_nonzero(kept & signal)
    assert 2 * both / (kept.sum() + signal.sum()) > 0.8
    assert beam.doubtful == 0


def test_it_does_not_depend_on_the_cut() -> None:
    along, height = quanta(sparse(0.05, length_m=3000.0)[0])
    assert_cut_matters_nowhere(along, height, 71)
