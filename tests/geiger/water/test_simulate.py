"""Simulated frames obey the law of detection, and their truth is that of the surface."""

import numpy as np
import pytest
from scipy.stats import exponnorm

from spl_batch.geiger.water.pixel_geometry import view_of
from spl_batch.geiger.water.ranges import first_photon
from spl_batch.geiger.water.settings import CameraSettings, MountSettings
from spl_batch.geiger.water.simulate import (
    Array,
    Instrument,
    Target,
    Wave,
    build_array,
    draw_frames,
    late_photon,
)

CAMERA = CameraSettings(rows=4, cols=4, last_rows_unused=0)
VIEW = view_of(CAMERA, MountSettings(position_m=(0.0, 0.0, -3.0)))


def drawn(n: float, noise_hz: float, actual_ns: float, **changes: float) -> np.ndarray:
    """Frames of even pixels."""
    shape = (4, 4)
    even = Array(np.full(shape, n), np.zeros(shape), np.zeros(shape, dtype=bool))
    actual = np.full((5000, *shape), actual_ns)
    instrument = Instrument(scale=1.0, offset_ns=80.0, noise_hz=noise_hz, **changes)
    return draw_frames(even, instrument, CAMERA, actual, 0.0, np.random.default_rng(1))


@pytest.mark.parametrize("n", [0.05, 0.7, 3.0])
def test_hits_are_as_many_and_as_early_as_poisson_says(n: float) -> None:
    frames = drawn(n, 0.001, 20.0, jitter_ns=0.0)
    hits = frames[frames > 0]
    share, total = -np.expm1(-n), frames.size
    assert len(hits) / total == pytest.approx(share, abs=5 * np.sqrt(share / total))
    # A bin holds the times from its number up: its middle is half a bin later.
    early = 100.0 - (hits + 0.5).mean() * CAMERA.bin_ns
    assert early == pytest.approx(first_photon(np.array([share]))[0], abs=5 / np.sqrt(len(hits)))


def test_noise_fires_first_and_is_cut_off_by_the_echo() -> None:
    frames, rate = drawn(2.0, 5e5, 920.0), 5e5
    early = (frames > 0) & (frames < 3900)
    assert early.mean() == pytest.approx(-np.expm1(-rate * 3900 * 0.25e-9), abs=0.01)
    dark = drawn(1e-9, rate, 920.0)
    assert (dark > 0).mean() == pytest.approx(-np.expm1(-rate * 2e-6), abs=0.015)
    assert dark.max() == CAMERA.bins, "a frame ends"


def test_without_noise_only_echoes_fire() -> None:
    assert not drawn(1e-12, 0.0, 920.0).any()
    lit, noisy = drawn(0.7, 0.0, 920.0, jitter_ns=0.0), drawn(0.7, 1e-3, 920.0, jitter_ns=0.0)
    np.testing.assert_array_equal(lit, noisy, "the same photons are drawn")


def test_light_from_below_the_surface_comes_later() -> None:
    share = np.linspace(0.01, 0.99, 25)
    later = exponnorm.ppf(share, 0.8, scale=1.0)
    np.testing.assert_allclose(late_photon(share, 0.8), later, atol=2e-3)
    np.testing.assert_allclose(late_photon(share, 0.05), late_photon(share, 0.0), atol=0.12)


def test_dead_pixels_are_those_of_the_instrument() -> None:
    camera, instrument = CameraSettings(), Instrument(dead=60)
    array, again = (build_array(i, camera) for i in (instrument, instrument.dimmed(0.1)))
    assert array.dead.sum() == 60
    assert array.dead[-3:].sum() == 54
    np.testing.assert_array_equal(again.dead, array.dead)
    smooth = build_array(Instrument(delay_ns=0.0), camera).delay_ns
    assert smooth.std() == pytest.approx(instrument.pattern_ns)
    assert np.abs(np.diff(smooth, axis=0)).max() < smooth.std()
    np.testing.assert_allclose(again.photoelectrons, 0.1 * array.photoelectrons)


def test_lines_of_sight_meet_the_waves() -> None:
    swell = Wave(amplitude_m=0.07, length_m=2.0, heading_deg=20.0)
    ripple = Wave(amplitude_m=0.01, length_m=0.5, heading_deg=-60.0, phase_deg=100.0)
    target = Target(down_m=0.8, waves=(swell, ripple))
    range_m, normals = target.meet(VIEW, 1.3)
    north, east, down = np.moveaxis(VIEW.points(range_m), -1, 0)
    np.testing.assert_allclose(down, target.surface(north, east, 1.3)[0], atol=1e-9)
    step = 1e-6
    by_north = (target.surface(north + step, east, 1.3)[0] - down) / step
    by_east = (target.surface(north, east + step, 1.3)[0] - down) / step
    np.testing.assert_allclose(normals[..., 0] / -normals[..., 2], by_north, atol=1e-5)
    np.testing.assert_allclose(normals[..., 1] / -normals[..., 2], by_east, atol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=-1), 1.0)
    many, _ = target.meet(VIEW, np.array([0.0, 1.3])[:, None, None])
    np.testing.assert_allclose(many[1], range_m, atol=1e-9)
    # Deep water: a crest moves one length in sqrt(2 pi L / g).
    period, one = np.sqrt(2 * np.pi * 2.0 / 9.81), Target(down_m=0.8, waves=(swell,))
    np.testing.assert_allclose(one.meet(VIEW, period)[0], one.meet(VIEW, 0.0)[0], atol=1e-9)
