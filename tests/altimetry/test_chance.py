"""Noise that passes for signal: what places without photons tell of it, and what is made of it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from benchmarks.altimetry.photon_beams import Beam
from spl_batch.altimetry.filter import chance
from spl_batch.altimetry.filter import signal as signals
from spl_batch.altimetry.filter.likelihood import ratios
from spl_batch.altimetry.noise import noise_rate as rates
from spl_batch.altimetry.photon_table import Cells, Scale
from spl_batch.altimetry.settings import BaselineSettings, RateSettings, SignalSettings
from spl_batch.altimetry.simulate import Track, scene, simulate_track
from tests.altimetry.tracks import lattice, small_track

RATE, SIGNAL = RateSettings(), SignalSettings()
TABLE = ratios(SIGNAL.neighbours, SIGNAL.contrast_max)


def prepared(track: Track) -> tuple[Cells, Scale, np.ndarray]:
    """Cells of a track, its scaled axis, and the prior of each cell."""
    cells = rates.observe(*lattice(track), RATE)
    density = rates.density_from_both(cells, track.background, RATE, SIGNAL.window_m)
    scale = rates.scale(cells, density, RATE, SIGNAL)
    return cells, scale, signals.log_prior(cells, scale, RATE, SIGNAL.window_m)


def test_a_place_has_the_score_of_a_photon_there() -> None:
    along, height = lattice(small_track(5, canopy=0.4))
    _, scale, prior = prepared(small_track(5, canopy=0.4))
    for row in range(0, len(along), len(along) // 25):
        query = np.arange(len(along)) == row
        (expected,) = signals.score(along, height, query, scale, prior, RATE, SIGNAL)
        others = along[~query], height[~query]
        at = along[query], height[query]
        (found,) = chance.score_places(at, others, scale, prior, (RATE, SIGNAL), TABLE)
        assert found == pytest.approx(expected, rel=1e-5)


def test_nothing_is_scored_without_photons_or_places() -> None:
    _, scale, prior = prepared(small_track(5))
    none, some = lattice(small_track(5)), lattice(small_track(5))
    none = none[0][:0], none[1][:0]
    assert len(chance.score_places(none, some, scale, prior, (RATE, SIGNAL), TABLE)) == 0
    assert (chance.score_places(some, none, scale, prior, (RATE, SIGNAL), TABLE) == 0).all()


@given(cut=st.integers(0, 30))
def test_places_lie_evenly_in_their_cells_wherever_the_track_is_cut(cut: int) -> None:
    cells, scale, _ = prepared(small_track(2))
    first = np.arange(len(cells.index)) < cut
    every = chance.places(cells, scale, np.ones(len(first), np.bool_), RATE)
    parts = [chance.places(cells, scale, owned, RATE) for owned in (first, ~first)]
    for whole, pieces in zip(every, zip(*parts, strict=True), strict=True):
        np.testing.assert_array_equal(whole, np.concatenate(pieces))
    along, height, noise, told = every
    cell = np.searchsorted(cells.index, along // 20_000)
    off = np.abs(height - scale.level[cell].astype(np.int64)) > 1000
    np.testing.assert_array_equal(told[off], noise[off])
    np.testing.assert_array_equal(cells.index[cell] * 20_000 + along % 20_000, along)
    assert ((height >= cells.low[cell]) & (height <= cells.high[cell])).all()
    share = np.bincount(cell, noise) / chance.SHARE_QUANTA
    # By depth below a level surface noise is not the same everywhere.
    np.testing.assert_allclose(share, scale.noise, rtol=0.1)
    assert share.sum() == pytest.approx(scale.noise.sum(), rel=0.03)
    level = (height - cells.low[cell]) / (cells.high - cells.low)[cell]
    for values in (level, along % 20_000 / 20_000):
        assert np.abs(np.sort(values) - np.linspace(0, 1, len(values))).max() < 0.02


@pytest.mark.parametrize(("colour", "canopy"), [("green", 0.4), ("infrared", 0.0)])
def test_places_tell_how_much_noise_passes(colour: str, canopy: float) -> None:
    expected, found = [], []
    for seed in (21, 22, 23):
        track = simulate_track(scene("flat", colour, seed, length_m=2000.0, canopy=canopy))  # type: ignore[arg-type]
        along, height = lattice(track)
        cells, scale, prior = prepared(track)
        every = np.ones(len(along), np.bool_)
        bins = signals.score_bins(signals.score(along, height, every, scale, prior, RATE, SIGNAL))
        *at, noise, _ = chance.places(cells, scale, np.ones(len(cells.index), np.bool_), RATE)
        score = chance.score_places(
            (at[0], at[1]), (along, height), scale, prior, (RATE, SIGNAL), TABLE
        )
        for least in (850, 950, 1050, 1150):
            passed = signals.score_bins(score) >= least
            expected.append(noise[passed].sum() / chance.SHARE_QUANTA)
            found.append(np.count_nonzero((bins >= least) & (track.truth == 0)))
    sums = np.array(expected).reshape(3, 4).sum(0), np.array(found).reshape(3, 4).sum(0)
    assert (sums[1] > 30).all()
    assert np.abs(sums[0] - sums[1]).max() < 0.1 * sums[1].max()


def test_noise_is_what_the_photons_least_like_signal_show() -> None:
    noise = np.tile(np.r_[np.full(20, 100.0), np.full(10, 1.0)], (5, 1))
    counts = 0.95 * noise
    # Signal among the rest changes nothing.
    counts[1, 20:] += 500.0
    noise[3], counts[3] = 0.0, 7.0
    counts[4] = 0.5 * noise[4]
    seen = chance.noise_seen(counts, noise, np.array([0.0, 0.0, 3.0, 0.0, 0.0]))
    assert seen[0] == seen[1] == pytest.approx(0.95)
    assert seen[2] == seen[3] == 1.0
    # No further than chance may have misled: three of the square root of 2010.
    assert seen[4] == pytest.approx(1.0 - 3.0 / 2010.0**0.5)


COUNTS = arrays(np.int64, (2, 30), elements=st.integers(0, 40))


@given(
    counts=COUNTS, noise=COUNTS, far=COUNTS, strays=COUNTS, wanted=st.floats(0, 900),
    share=st.floats(0, 0.5),
)  # fmt: skip
def test_the_threshold_is_that_of_the_largest_f1(
    counts: np.ndarray, noise: np.ndarray, far: np.ndarray, strays: np.ndarray, wanted: float,
    share: float,
) -> None:  # fmt: skip
    noise, far = np.minimum(noise, counts), np.minimum(far, counts)
    strays = np.minimum(strays // 8, far)
    tables = (t.astype(float) for t in (counts, noise, far, strays))
    least = chance.best_thresholds(*tables, np.full(2, wanted), share)
    for i in range(2):
        f1, signal, fine = {}, {}, {}
        sure = wanted > 3.0 * max(counts[i].sum() - wanted, 1.0) ** 0.5
        for b in range(counts.shape[1] - 1, -1, -1):
            above, below = counts[i, b:].sum(), noise[i, b:].sum()
            signal[b] = min(above - below, wanted)
            f1[b] = 2.0 * signal[b] / max(above + wanted, 1.0)
            fine[b] = far[i, b:].sum() <= max(share * above, sure)
        # The first of equals is the one that takes fewest.
        free = max(f1, key=lambda b: f1[b])
        held = max(f1, key=lambda b: f1[b] if fine[b] else 0.0)
        gained = f1[held] if fine[held] else 0.0
        costly = sure and gained < 0.95 * f1[free]
        away, chanced = far[i, free:].sum(), strays[i, free:].sum()
        each = 8.0 * noise[i].sum() / max(counts[i].sum(), 1)
        layered = away > chanced + each + 3.0 * ((1.0 + each) * chanced) ** 0.5
        near = {}
        for b in f1:
            above = counts[i, b:].sum() - far[i, b:].sum()
            below = noise[i, b:].sum() - strays[i, b:].sum()
            near[b] = 2.0 * np.clip(above - below, 0.0, wanted) / max(above + wanted, 1.0)
        if costly and not layered:
            f1 = near
        best = max(f1, key=lambda b: f1[b]) if costly else held
        gained = f1[best] if costly else gained
        assert least[i] == (max(best, 1) if gained > 0.0 else counts.shape[1])


def test_far_noise_costs_a_twentieth_of_f1_at_most() -> None:
    counts, far = np.zeros((1, 50)), np.zeros((1, 50))
    counts[0, 40], counts[0, 30], counts[0, 0] = 50.0, 50.0, 900.0
    far[0, 35] = counts[0, 35] = 5.0
    least = chance.best_thresholds(counts, far, far, far, np.array([105.0]), 0.0005)
    assert least[0] == 30


@pytest.mark.parametrize("colour", ["green", "infrared"])
def test_what_is_taken_under_trees_agrees_better_with_the_truth(colour: str) -> None:
    """Better than as many as the noise rate leaves over [W17], and than mDBSCAN."""
    found: dict[str, list[float]] = {"f1": [], "number": [], "mdbscan": []}
    for seed in (21, 22, 23):
        track = simulate_track(scene("flat", colour, seed, length_m=2000.0, canopy=0.4))  # type: ignore[arg-type]
        kept = {}
        for selection in ("f1", "number"):
            chosen = SIGNAL.model_copy(update={"selection": selection})
            beam = Beam(lattice(track), track.background, chosen)
            kept[selection] = beam.keep(beam.score())
        kept["mdbscan"] = beam.mdbscan(BaselineSettings())
        for name, mask in kept.items():
            both = np.count_nonzero(mask & (track.truth > 0))
            found[name].append(2 * both / (mask.sum() + np.count_nonzero(track.truth)))
    mean_f1 = {name: np.mean(values) for name, values in found.items()}
    assert mean_f1["f1"] > mean_f1["number"] + 0.001
    assert mean_f1["f1"] > mean_f1["mdbscan"]


def test_noise_in_clumps_gives_no_more_than_is_told() -> None:
    rng = np.random.default_rng(3)
    clumps = rng.poisson(3.0, 4000) * 20.0
    alone = np.array([chance.noise_alone(taken, 60.0, 0.0, 20) for taken in clumps])
    for level in (0.5, 0.2, 0.05, 0.01):
        assert np.mean(alone <= level) <= level + 3.0 * np.sqrt(level / len(alone))
    assert chance.noise_alone(0.0, 0.0, 0.0, 20) == 1.0
    assert chance.noise_alone(1200.0, 990.0, 0.9, 20) > chance.LIKE_NOISE
    assert chance.noise_alone(1393.0, 102.0, 0.8, 20) < chance.LIKE_NOISE
    few, many = (chance.noise_alone(17.0, 0.0, share, 20) for share in (0.0, 1.0))
    assert few == 0.0
    assert many > chance.LIKE_NOISE
