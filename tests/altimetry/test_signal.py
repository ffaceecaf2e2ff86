"""Noise along the track, scores, thresholds, mDBSCAN: right, and the same however it is cut."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.altimetry.photon_beams import Beam
from spl_batch.altimetry.filter import signal as signals
from spl_batch.altimetry.noise import noise_rate as rates
from spl_batch.altimetry.noise.planes import planes
from spl_batch.altimetry.photon_table import Cells
from spl_batch.altimetry.settings import BaselineSettings, RateSettings, SignalSettings
from spl_batch.altimetry.simulate import scene, simulate_track
from spl_batch.altimetry.water.level_water import NO_WATER
from tests.altimetry.tracks import lattice, small_track

RATE = RateSettings()
SIGNAL = SignalSettings()


def test_the_empty_window_gives_the_noise_density() -> None:
    ratios = []
    for seed in range(1, 5):
        track = simulate_track(scene("mountain", "green", seed, length_m=1200.0))
        cells = rates.observe(*lattice(track), RATE)
        true = np.interp((cells.index + 0.5) * 20.0, *_rate(track))
        found = rates.density_from_window(cells, RATE)
        ratios.append(found.sum() / true.sum())
        assert np.abs(cells.gate_m - 1200.0).max() < 120.0
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.02)


def _rate(track: object) -> tuple[np.ndarray, np.ndarray]:
    background = track.background  # type: ignore[attr-defined]
    return background.along_m, background.per_m2


def test_a_biased_product_is_put_at_the_level_of_the_window() -> None:
    track = small_track(noise_per_m2=0.2)
    cells = rates.observe(*lattice(track), RATE)
    stated = track.background
    twice = type(stated)(stated.along_m, 2.0 * stated.per_m2)
    both = rates.density_from_both(cells, twice, RATE, SIGNAL.window_m)
    alone = rates.density_from_product(cells, twice, RATE)
    ratio = both / alone
    assert ratio.max() - ratio.min() < 1e-9, "its variation stays"
    assert ratio.mean() == pytest.approx(0.5, abs=0.02)


def test_noise_is_equally_dense_on_the_scaled_axis() -> None:
    track = simulate_track(
        scene("flat", "green", 2, length_m=2000.0, patch=6.0, patch_share=0.3, signal_per_m=0.01)
    )
    along, height = lattice(track)
    cells = rates.observe(along, height, RATE)
    density = rates.density_from_product(cells, track.background, RATE)
    scale = rates.scale(cells, density, RATE, SIGNAL)
    raw = np.histogram(along, 20)[0]
    assert raw.std() / raw.mean() > 0.5
    seen = []
    photons = signals.in_cells(along, height, scale, RATE)
    for plane in planes(scale, np.arange(len(scale.index)), RATE, SIGNAL):
        here = signals.placed(photons, plane, scale, RATE)
        assert np.all(np.diff(here.uv[:, 0]) >= 0), "the order along the track stays"
        gate = cells.gate_m[plane.rows] / plane.unit_m
        units2 = gate * plane.per_m * RATE.cell_m
        count = np.bincount(here.at, minlength=len(plane.rows))
        seen.append((count[plane.own].sum(), units2[plane.own].sum()))
    assert sum(count for count, _ in seen) == len(along)
    for count, units2 in seen:
        # A unit is longer than the reach allows nowhere here.
        assert count / units2 == pytest.approx(1.0, abs=0.06 + 3.0 / np.sqrt(count))


def beside(parts: list[tuple[np.ndarray, np.ndarray]]) -> tuple[tuple[np.ndarray, np.ndarray], int]:
    """Tracks in one, and where the photons of the first of them begin."""
    along, height = (np.concatenate(v) for v in zip(*parts, strict=True))
    order = np.lexsort((height, along))
    return (along[order], height[order]), int(np.count_nonzero(along < parts[0][0].min()))


@settings(max_examples=6, deadline=None)
@given(
    st.sampled_from([-1, 1]), st.sampled_from([0.0002, 0.02, 0.2]), st.integers(1, 4),
    st.sampled_from([0.0, 300.0]),
)  # fmt: skip
def test_labels_depend_on_nothing_far_away(
    side: int, noise_per_m2: float, seed: int, step_m: float
) -> None:
    first, _ = beside([lattice(small_track(seed))])
    other = lattice(small_track(seed + 9, length_m=1200.0, noise_per_m2=noise_per_m2))
    other = other[0] + side * 20_000_000, (other[1] + step_m * 1000.0).astype(np.int32)
    alone = Beam(first, None)
    photons, start = beside([first, other])
    together = Beam(photons, None)
    mine = slice(start, start + len(first[0]))
    scores = alone.score(), together.score()
    np.testing.assert_array_equal(scores[0], scores[1][mine])
    kept = alone.keep(scores[0]), together.keep(scores[1])
    np.testing.assert_array_equal(kept[0], kept[1][mine])


def test_labels_far_from_a_join_do_not_depend_on_what_is_joined() -> None:
    rng = np.random.default_rng(4)
    x = np.sort(rng.uniform(0.0, 20_000.0, 8000))
    z = np.where(rng.random(8000) < 0.7, 20.0 * np.sin(x / 200.0), rng.uniform(-60.0, 60.0, 8000))
    first = np.rint(x * 1000.0).astype(np.int64), np.rint(z * 1000.0).astype(np.int32)
    day = lattice(small_track(2, noise_per_m2=0.2))
    near, alone = first[0] < 2_000_000, Beam(first, None)
    joined = Beam(beside([first, (day[0] + 20_000_000, day[1])])[0], None)
    scores = alone.score(), joined.score()
    kept = alone.keep(scores[0]), joined.keep(scores[1])
    for one, other in (scores, kept):
        np.testing.assert_array_equal(one[near], other[: len(first[0])][near])
    assert 0.5 < kept[0].mean() < 1.0


@pytest.mark.parametrize("scaling", [True, False])
def test_a_product_may_say_that_there_is_no_noise(scaling: bool) -> None:  # noqa: FBT001
    along, height = lattice(small_track(2, noise_per_m2=1e-4))
    cells = rates.observe(along, height, RATE)
    for none in (slice(None), slice(0, 10)):
        density = np.full(len(cells.index), 1e-4)
        density[none] = 0.0
        chosen = SIGNAL.model_copy(update={"scaling": scaling})
        scale = rates.scale(cells, density, RATE, chosen)
        prior = signals.log_prior(cells, scale, RATE, chosen.window_m)
        every = np.ones(len(along), np.bool_)
        score = signals.score(along, height, every, scale, prior, RATE, chosen)
        assert np.isfinite(score).all()
        assert np.isfinite(scale.stretched_m).all()


@pytest.mark.parametrize("night_m", [1.0, 20_000.0])
def test_a_night_behind_a_day_spoils_no_labels(night_m: float) -> None:
    day = simulate_track(scene("mountain", "infrared", 3, length_m=2000.0))
    night = simulate_track(
        scene("mountain", "infrared", 4, length_m=6000.0, noise_per_m2=1e-6, patch=1.0)
    )
    photons, _ = beside(
        [lattice(day), (lattice(night)[0] + 2_000_000 + int(night_m * 1000.0), lattice(night)[1])]
    )
    beam = Beam(photons, None)
    kept, truth = beam.keep(beam.score())[: len(day.truth)], day.truth > 0
    both = np.count_nonzero(kept & truth)
    assert 2.0 * both / (kept.sum() + truth.sum()) > (0.9 if night_m < 100.0 else 0.95)


def pieces(along: np.ndarray, cuts: list[int], reach: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Rows of each piece with its halo, and which of them it owns."""
    edges = [-(10**12), *sorted(cuts), 10**12]
    found = []
    for low, high in pairwise(edges):
        rows = np.flatnonzero((along >= low - reach) & (along < high + reach))
        found.append((rows, (along[rows] >= low) & (along[rows] < high)))
    return found


@settings(max_examples=8, deadline=None)
@given(st.integers(1, 5), st.lists(st.integers(0, 29), max_size=4, unique=True))
def test_scores_do_not_depend_on_where_the_track_is_cut(seed: int, cuts: list[int]) -> None:
    track = small_track(seed, canopy=0.3)
    along, height = lattice(track)
    cells = rates.observe(along, height, RATE)
    scale = rates.scale(cells, rates.density_from_window(cells, RATE), RATE, SIGNAL)
    prior = signals.log_prior(cells, scale, RATE, SIGNAL.window_m)
    mean = signals.mean_density(cells, scale, RATE, SIGNAL)
    every = np.ones(len(along), np.bool_)
    whole = signals.score(along, height, every, scale, prior, RATE, SIGNAL)
    base = signals.mdbscan(along, height, scale, mean, RATE, SIGNAL.mdbscan)
    marks = [20_000 * cut for cut in cuts]
    reach = int((SIGNAL.reach_m + 1.0) * 1000)
    for rows, mine in pieces(along, marks, reach):
        if mine.any():
            part = signals.score(along[rows], height[rows], mine, scale, prior, RATE, SIGNAL)
            np.testing.assert_array_equal(part, whole[rows[mine]])
    reach = int((signals.baseline_reach_m(scale, SIGNAL.mdbscan) + 1.0) * 1000)
    for rows, mine in pieces(along, marks, reach):
        part = signals.mdbscan(along[rows], height[rows], scale, mean, RATE, SIGNAL.mdbscan)
        np.testing.assert_array_equal(part[mine], base[rows[mine]])


@settings(max_examples=8, deadline=None)
@given(st.integers(1, 5), st.integers(3, 26))
def test_cells_do_not_depend_on_where_the_track_is_cut(seed: int, cut: int) -> None:
    along, height = lattice(small_track(seed))
    whole = rates.observe(along, height, RATE)
    parts: list[Cells] = []
    for rows, _ in pieces(along, [20_000 * cut], rates.HALO_CELLS * 20_000):
        seen = rates.observe(along[rows], height[rows], RATE)
        first = (seen.index < cut) if not parts else (seen.index >= cut)
        parts.append(Cells(**{k: v[first] for k, v in seen.to_arrays().items()}))
    joined = rates.join(parts)
    for name, values in whole.to_arrays().items():
        np.testing.assert_array_equal(values, joined.to_arrays()[name], err_msg=name)


def test_a_beam_without_photons_has_no_cells() -> None:
    cells = rates.observe(np.empty(0, np.int64), np.empty(0, np.int32), RATE)
    scale = rates.scale(cells, rates.density_from_window(cells, RATE), RATE, SIGNAL)
    assert len(scale.index) == 0


def test_mdbscan_is_counting_by_hand() -> None:
    track = small_track(3)
    along, height = lattice(track)
    few = slice(0, 1200)
    along, height = along[few], height[few]
    cells = rates.observe(along, height, RATE)
    scale = rates.scale(cells, rates.density_from_window(cells, RATE), RATE, SIGNAL)
    ellipse = BaselineSettings(scaled=False, along_m=9.0, height_m=3.0)
    unscaled = SIGNAL.model_copy(update={"mdbscan": ellipse})
    mean = signals.mean_density(cells, scale, RATE, unscaled)
    found = signals.mdbscan(along, height, scale, mean, RATE, ellipse)
    x, z = along / 1000 / 9.0, height / 1000 / 3.0
    near = (x[:, None] - x) ** 2 + (z[:, None] - z) ** 2 <= 1.0
    cell = np.searchsorted(cells.index, along // 20_000)
    core = near.sum(axis=1) >= 4.0 * mean[cell] * np.pi * 27.0
    np.testing.assert_array_equal(found, (near & core).any(axis=1))
    assert 0 < core.sum() < found.sum() < len(found)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000), st.floats(0.0, 400.0), st.floats(0.0005, 0.2))
def test_no_more_is_taken_than_is_estimated_or_allowed(
    seed: int, wanted: float, share: float
) -> None:
    rng = np.random.default_rng(seed)
    counts = rng.poisson(rng.uniform(0.0, 1.0, (3, 200)) ** 4 * 5)
    far = rng.binomial(counts, 0.02)
    least = signals.thresholds(counts, far, np.full(3, wanted), share)
    for i in range(3):
        sure = wanted > 3.0 * max(counts[i].sum() - wanted, 1.0) ** 0.5
        taken = counts[i, least[i] :].sum()
        false = far[i, least[i] :].sum()
        assert taken <= wanted
        assert false <= max(share * taken, sure)
        more = least[i] - 1
        if more >= 1:
            grown = counts[i, more:].sum()
            worse = far[i, more:].sum()
            assert grown > wanted or worse > max(share * grown, sure) or grown == taken


@pytest.mark.parametrize("kind", ["mountain", "flat"])
@pytest.mark.parametrize("colour", ["green", "infrared"])
def test_kept_photons_lie_nearer_to_the_ground_than_mdbscan_s(kind: str, colour: str) -> None:
    """W17 Fig. 4-9 and 4-11: RMSE of what is kept, on bare ground."""
    track = simulate_track(scene(kind, colour, 22, length_m=2000.0))  # type: ignore[arg-type]
    beam = Beam(lattice(track), track.background)
    off = track.height_m - track.ground_m

    def rmse(kept: np.ndarray) -> float:
        return float(np.sqrt(np.mean(off[kept] ** 2)))

    ours = rmse(beam.keep(beam.score()))
    for scaled in (True, False):
        assert ours < rmse(beam.mdbscan(BaselineSettings(scaled=scaled)))
    assert ours < 2.0


def test_a_segment_of_few_photons_fits_the_lattice() -> None:
    index = np.arange(40_000, dtype=np.int64) * 13
    one = np.ones(len(index), np.int64)
    ends = (one.astype(np.int32) * 0, one.astype(np.int32) * 100_000)
    none = np.full(len(index), NO_WATER, np.int32)
    column = np.zeros((len(index), 60), np.float32)
    steep = np.ones(len(index), np.float32)
    fog = np.zeros((len(index), 64), np.float32)
    sparse = Cells(
        index, one, *ends, ends[0], one, one, none, column, steep, none, one > 0, one > 0, one > 0,
        steep, none, fog, fog[:, :3], np.full((len(index), 2), np.nan, np.float32),
    )  # fmt: skip
    scaled = rates.scale(sparse, np.full(len(index), 1e-6), RATE, SIGNAL)
    cells = signals.most_cells(scaled, RATE, SIGNAL)
    (plane,) = planes(scaled, np.arange(len(index)), RATE, SIGNAL)
    assert plane.start[-1] - plane.start[0] > 2**30
    assert 10_000 < cells < len(index)
    assert plane.start[cells] - plane.start[0] < 2**30
