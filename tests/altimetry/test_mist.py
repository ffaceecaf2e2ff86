"""Fog and low clouds that may be woods are told of; ground, water and gappy woods are not."""

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.altimetry.clouds import CLOUDS, metres
from benchmarks.altimetry.labelled_tracks import LAND, NOISE, Labelled, measured
from benchmarks.altimetry.odd_tracks import DAY, NIGHT, SCENES, make
from benchmarks.altimetry.photon_beams import RATE, Beam, lattice
from spl_batch.altimetry.noise import noise_rate as rates
from spl_batch.altimetry.noise.fog import told
from spl_batch.altimetry.noise.mist import in_mist
from spl_batch.altimetry.photon_table import Cells
from spl_batch.altimetry.report.beam_warnings import _mist
from tests.altimetry.tracks import assert_cut_matters_nowhere


def told_share(track: Labelled) -> tuple[Cells, float, float]:
    """Cells, and the parts of signal and of noise that a reader is told of."""
    cells = rates.observe(*track.photons, RATE)
    misty = in_mist(cells, *metres(track), RATE)
    noise = track.label == NOISE
    return cells, float(misty[~noise].mean()), float(misty[noise].mean())


@pytest.mark.parametrize("noise", [NIGHT, DAY])
@pytest.mark.parametrize(
    ("name", "share"), [("on a plain, 30 m thick", 0.5), ("at 22 to 45 m, hides 600 m", 0.2)]
)
def test_fog_near_the_ground_is_told_of(name: str, share: float, noise: float) -> None:
    track = make("fog", replace(CLOUDS[name], noise_per_m2=noise), 1)
    cells, _, fog = told_share(track)
    assert fog > share * (1.0 if noise == NIGHT else 0.2)
    assert (cells.mist[:, 2] > 0).mean() > 0.1


@pytest.mark.parametrize("noise", [NIGHT, DAY])
@pytest.mark.parametrize(("light", "level"), [(0.5, False), (0.2, True), (0.0, False)])
def test_fog_over_rolling_ground_is_told_of(noise: float, light: float, *, level: bool) -> None:
    """From 5 to 25 m above the ground or above its mean, along half of the track."""
    for seed in range(3):
        rng = np.random.default_rng(seed)
        shot = np.arange(0.0, 4000.0, 0.7)
        land = (12.0 + 2.0 * seed) * np.sin(shot / (180.0 + 40.0 * seed))
        let = np.where(shot % 1500.0 < 750.0, light, 1.0)
        ground = np.repeat(np.arange(len(shot)), rng.poisson(1.2 * let))
        fog = np.repeat(np.arange(len(shot)), rng.poisson(1.0 - let))
        foot = 0.0 if level else land[fog]
        high = foot + rng.uniform(5.0, 25.0, len(fog))
        fog, high = fog[high > land[fog]], high[high > land[fog]]
        n = rng.poisson(noise * 4000.0 * 200.0)
        x = np.concatenate([shot[ground], shot[fog], rng.uniform(0.0, 4000.0, n)])
        low = land[ground] + rng.normal(0.0, 0.3, len(ground))
        z = np.concatenate([low, high, rng.uniform(-80.0, 120.0, n)])
        order = np.argsort(x, kind="stable")
        cells = rates.observe(*lattice(x[order], z[order]), RATE)
        seen = in_mist(cells, x, z, RATE)[len(ground) : len(ground) + len(fog)]
        # A run names what holds 3 % of the signal.
        assert np.count_nonzero(seen) > 0.03 * (len(ground) + len(fog))


def test_bare_hills_are_no_fog() -> None:
    for seed in range(3):
        land = lambda x, s=seed: (10.0 + 20.0 * s) * np.sin(x / (90.0 + 60.0 * s))  # type: ignore[misc]  # noqa: E731
        scene = replace(SCENES["land alone, slope 0.5"], land_m=land, noise_per_m2=DAY)
        _, signal, _ = told_share(make("hills", scene, seed))
        assert signal < 0.01


@pytest.mark.parametrize("noise", [NIGHT, DAY])
@pytest.mark.parametrize(
    "name", ["plain", "swell of 1 m", "wooded island", "land alone, slope 0.5"]
)
def test_water_ground_and_thin_woods_are_not(name: str, noise: float) -> None:
    cells, signal, _ = told_share(make(name, replace(SCENES[name], noise_per_m2=noise), 1))
    assert signal < 0.01
    assert not (cells.mist[:, 2] > 0).mean() > 0.02


@pytest.mark.parametrize("relief_m", [0.0, 150.0])
@pytest.mark.parametrize("noise", [NIGHT, DAY])
def test_woods_with_gaps_are_not(noise: float, relief_m: float) -> None:
    rng = np.random.default_rng(4)
    shot = np.arange(0.0, 4000.0, 0.7)
    slope = relief_m * np.sin(shot / 450.0)
    # Crowns 9 m wide, each as high as it grew.
    crown = shot // 9.0
    high = rng.uniform(6.0, 28.0, int(crown.max()) + 1)[crown.astype(int)]
    dense = rng.gamma(0.8, 1.0, int(crown.max()) + 1)[crown.astype(int)]
    tree = np.repeat(np.arange(len(shot)), rng.poisson(np.minimum(dense, 3.0)))
    ground = np.repeat(np.arange(len(shot)), rng.poisson(0.3, len(shot)))
    n = rng.poisson(noise * 4000.0 * (200.0 + 2.0 * relief_m))
    x = np.concatenate([shot[tree], shot[ground], rng.uniform(0.0, 4000.0, n)])
    z = np.concatenate(
        [
            slope[tree] + high[tree] * rng.beta(4.0, 2.0, len(tree)),
            slope[ground] + rng.normal(0.0, 0.2, len(ground)),
            rng.uniform(-80.0 - relief_m, 120.0 + relief_m, n),
        ]
    )
    label = np.repeat([LAND, NOISE], [len(tree) + len(ground), n])
    order = np.argsort(x, kind="stable")
    _, signal, _ = told_share(Labelled("woods", lattice(x[order], z[order]), label[order]))
    assert signal < 0.03


@pytest.mark.parametrize("noise", [NIGHT, DAY])
def test_a_cloud_that_hides_the_ground_for_long_is_noise_at_its_ends_and_told_of_between(
    noise: float,
) -> None:
    track = make("hidden", replace(CLOUDS["the same, hides 2.7 km"], noise_per_m2=noise), 1)
    x, z = metres(track)
    cloud = (x > 700.0) & (x < 3400.0) & (z > 90.0) & (z < 130.0)
    beam = Beam(track.photons, None)
    kept = beam.keep(beam.score())
    misty = in_mist(beam.cells, x, z, RATE)
    assert (kept & ~misty)[cloud].mean() < 0.15
    assert kept[track.label == LAND].mean() > 0.95
    assert measured(kept & ~misty, track.label)[0] > 0.9


@settings(max_examples=2, deadline=None)
@given(st.integers(0, 5), st.integers(30, 120))
def test_what_is_told_does_not_depend_on_where_the_track_is_cut(seed: int, cut: int) -> None:
    scene = replace(CLOUDS["at 22 to 45 m, hides 600 m"], length_m=3000.0)
    along, height = make("fog", scene, seed).photons
    assert rates.observe(along, height, RATE).mist.any()
    assert_cut_matters_nowhere(along, height, cut)


def test_a_reader_is_told_of_fog_by_the_signal_in_it() -> None:
    layer = np.array([[0.0, 30.0, 30.0], [0.0, 60.0, 66.0], [0.0, 40.0, 42.0]])
    mist: Mapping[str, float] = told(np.array([3, 4, 5]), layer, 20.0)
    assert (mist["from_m"], mist["to_m"], mist["low_m"], mist["high_m"]) == (80, 120, 30, 63)
    (text,) = _mist(mist, 70, 1000)
    assert text.startswith("70 of the 1 000 signal photons lie in a layer as even as fog")
    silent: list[Callable[[], object]] = [
        lambda: list(_mist({}, 70, 1000)),
        lambda: list(_mist(mist, 20, 1000)),
        lambda: list(_mist(mist, 9, 100)),
    ]
    assert not any(one() for one in silent)
