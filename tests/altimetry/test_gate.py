"""Gate and noise rate over water where floors are bright or deep, or nothing lies above."""

from dataclasses import replace

import numpy as np
import pytest

from spl_batch.altimetry.noise import noise_rate as rates
from spl_batch.altimetry.noise.gate import STRETCH_CELLS
from spl_batch.altimetry.settings import RateSettings
from tests.altimetry.test_level_water import NIGHT, WaterTrack, photons, water_track

RATE = RateSettings()


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
