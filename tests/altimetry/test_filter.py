"""Signal of windows: neighbourhoods, noise, thresholds, and the filters of the source."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.altimetry.photon_beams import Kind, labelled, lattice, scene, workflow
from spl_batch.altimetry.filter.neighbours import LAYER_M, SLOPES, columns, leaning, log_areas
from spl_batch.altimetry.filter.noise_field import Boxes, below_water, density, gate
from spl_batch.altimetry.filter.track import COLUMNS, label, mdbscan
from spl_batch.altimetry.filter.window import _threshold, assess
from spl_batch.altimetry.simulate import Track, simulate_track
from spl_batch.altimetry.water.surface import NO_WATER
from tests.altimetry.tracks import f1, photons_of, small_track

WORKFLOW = workflow()


def in_order(track: Track) -> tuple[np.ndarray, np.ndarray]:
    """Photons of a track in order along it."""
    along, height = photons_of(track)
    order = np.lexsort((height, along))
    return along[order], height[order]


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 120), st.floats(0.5, 40.0))
def test_areas_are_those_of_sorting_all_distances(seed: int, n: int, aspect: float) -> None:
    rng = np.random.default_rng(seed)
    x, z = rng.uniform(0.0, 150.0, n), rng.uniform(-20.0, 20.0, n)
    slope = rng.choice(SLOPES, n)
    for own, off_m in ((True, 0.0), (False, 1.0)):
        at = x + off_m, z - off_m
        found = np.exp(log_areas(columns(x, z), at, slope, (5, aspect, 60.0), own=own))
        for q in range(n):
            dx = x - at[0][q]
            squared = (dx / aspect) ** 2 + (z - at[1][q] - slope[q] * dx) ** 2
            squared = np.sort(np.delete(squared, q) if own else squared)
            squared = np.maximum(squared[squared < (60.0 / aspect) ** 2][:5], 1e-6)
            np.testing.assert_allclose(found[q, : len(squared)], np.pi * aspect * squared)
            assert np.isinf(found[q, len(squared) :]).all()


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 10_000))
def test_a_layer_leans_as_most_pairs_do(seed: int) -> None:
    rng = np.random.default_rng(seed)
    slope = rng.choice(SLOPES)
    x = np.sort(rng.uniform(0.0, 100.0, 600))
    z = 55.0 + slope * (x - 50.0) + rng.normal(0.0, 0.15, 600)
    z = np.maximum(z, 0.0)
    found = leaning(x, z, np.searchsorted(x, np.arange(0.0, 101.0, 20.0)), 20.0)
    pairs = []
    for one in SLOPES:
        bins = np.floor((z - one * (x - 50.0)) / 0.75)
        inside = (bins + 0.5) * 0.75 // LAYER_M == 5
        _, count = np.unique(bins[inside], return_counts=True)
        pairs.append((count * (count - 1)).sum())
    assert pairs[found[2, 5]] >= 0.7 * max(pairs)


def test_noise_is_photons_over_area_and_smooth() -> None:
    rng = np.random.default_rng(1)
    cells = 200
    area = np.full((cells, 60), 40.0)
    true = 0.02 * np.exp(0.4 * np.sin(np.arange(cells) / 30.0))[:, None]
    found = density(rng.poisson(true * area).astype(float), area, np.full(cells, -1))
    assert found.mean() == pytest.approx(true.mean(), rel=0.03)
    assert np.abs(found / true - 1.0).max() < 0.25
    boxes = Boxes(np.array([3.0, 12.9]), 2)
    assert boxes.table(boxes.of(np.array([0, 1, 1]), np.array([3.0, 12.9, 99.0]))).sum() == 3


def test_noise_below_water_falls_with_depth_and_stays_as_it_is_above() -> None:
    rng = np.random.default_rng(2)
    cells, heights, top = 150, 40, 25
    surface = np.where(np.arange(cells) < 100, top, -1)
    area = np.full((cells, heights), 40.0)
    depth = top - np.arange(heights)
    true = np.full((cells, heights), 0.002)
    true[:100] += np.where(depth >= 0, 0.03 * np.exp(-np.maximum(depth, 0) / 4.0), 0.0)
    counts = rng.poisson(true * area).astype(float)
    smooth = density(counts, area, surface)
    assert smooth[20:80, top + 3 :].mean() == pytest.approx(0.002, rel=0.2)
    found = below_water(smooth, counts, area, surface)
    np.testing.assert_array_equal(found[100:], smooth[100:])
    np.testing.assert_array_equal(found[:100, top + 1 :], smooth[:100, top + 1 :])
    middle = found[20:80, : top + 1]
    assert (np.diff(middle, axis=1) >= 0.0).all(), "upwards it grows"
    np.testing.assert_allclose(middle.mean(axis=0), true[0, : top + 1], rtol=0.2, atol=1e-3)


@pytest.mark.parametrize(
    ("kind", "noise", "off_m"),
    [("flat", 0.0005, 8.0), ("flat", 0.02, 8.0), ("mountain", 0.2, 40.0)],
)
def test_the_gate_is_seen_by_night_and_day(kind: Kind, noise: float, off_m: float) -> None:
    track = simulate_track(
        scene(kind, "green", 1, length_m=3000.0, above_m=60.0, below_m=90.0, noise_per_m2=noise)
    )
    cell = (track.along_m // 20.0).astype(np.int64)
    low_m, high_m = gate(cell, track.height_m, int(cell.max()) + 1)
    assert np.median(high_m - low_m) == pytest.approx(150.0, abs=off_m)


@pytest.mark.parametrize(("kind", "canopy", "least"), [("mountain", 0.4, 0.8), ("flat", 0.0, 0.9)])
def test_noise_among_the_signal_is_estimated(kind: Kind, canopy: float, least: float) -> None:
    track = simulate_track(scene(kind, "green", 3, length_m=3000.0, canopy=canopy))
    beam = labelled(photons_of(track), WORKFLOW)
    signal = track.truth > 0
    assert f1(beam.kept, signal) > least
    false = np.count_nonzero(beam.kept & ~signal)
    assert 1 / 1.5 < beam.cells["false"].sum() / false < 1.5
    assert beam.cells["expected"].sum() == pytest.approx(np.count_nonzero(~signal), rel=0.1)


def test_labels_are_the_same_however_the_track_is_cut() -> None:
    track = simulate_track(scene("flat", "green", 2, length_m=2600.0, above_m=60.0, below_m=60.0))
    settings = workflow(signal={"window_m": 1000.0})
    along, height = in_order(track)
    whole, cells = label(along, height, (0, 3_000_000), settings)
    parts = []
    for span in ((0, 1_000_000), (1_000_000, 3_000_000)):
        rows = (along >= span[0] - 1_000_000) & (along < span[1] + 1_000_000)
        parts.append(label(along[rows], height[rows], span, settings))
    for name in COLUMNS:
        joined = np.concatenate([photons[name] for photons, _ in parts])
        np.testing.assert_array_equal(whole[name], joined, err_msg=name)
    for name, values in cells.items():
        np.testing.assert_array_equal(values, np.concatenate([c[name] for _, c in parts]))
    own = along >= 1_000_000
    alone, _ = label(along[own], height[own], (1_000_000, 3_000_000), settings)
    assert (alone["score"] != whole["score"][own]).any(), "the margin decides with it"


def test_a_window_of_two_photons_and_one_of_none() -> None:
    far = np.array([5, 1_000_005]), np.array([7, 7], np.int32)
    two, cells = label(*far, (0, 4_000_000), WORKFLOW)
    assert len(two["signal"]) == 2
    assert cells["index"].tolist() == [0, 50], "those that hold photons"
    none = label(np.empty(0, np.int64), np.empty(0, np.int32), (0, 4_000_000), WORKFLOW)
    assert not any(len(values) for part in none for values in part.values())


def test_the_threshold_is_that_of_the_largest_f1() -> None:
    rng = np.random.default_rng(2)
    photons = np.r_[rng.normal(2.0, 0.7, 400), rng.normal(-2.0, 1.0, 1600)]
    strewn, each = rng.normal(-2.0, 1.0, 800), np.full(800, 2.0)
    expected, least, ground = _threshold(photons, strewn, each, 1.5)
    signal = np.arange(2000) < 400
    best = max(f1(photons >= limit, signal) for limit in np.linspace(-3.0, 3.0, 200))
    assert f1(photons >= least, signal) > best - 0.01
    assert expected == pytest.approx(best, abs=0.03)
    assert ground <= least
    assert np.count_nonzero(photons >= ground) <= 1.5 * np.count_nonzero(photons >= least)


def test_mdbscan_is_counting_by_hand() -> None:
    along, height = in_order(small_track(5))
    known = assess(along, height, 20.0, WORKFLOW.signal, 1.5)
    chosen = WORKFLOW.signal.mdbscan.model_copy(update={"scaled": False})
    found = mdbscan(along, height, known, 20.0, chosen)
    x, z = along / 1e3, height / 1e3
    inside = ((x[:, None] - x) / 12.0) ** 2 + ((z[:, None] - z) / 4.0) ** 2 <= 1.0
    own = inside.sum(axis=1)
    mean = len(x) / (known.gate_m.sum() * 20.0) * np.pi * 48.0
    # random ellipses hold the mean density, but for chance
    least = [(inside & (own >= 4.0 * mean * part)).any(axis=1) for part in (0.7, 1.3)]
    assert (found <= least[0]).all()
    assert (found >= least[1]).all()
    assert np.array_equal(found, mdbscan(along, height, known, 20.0, chosen))


@pytest.mark.parametrize("method", ["published", "mdbscan"])
def test_filters_of_the_source_keep_signal(method: str) -> None:
    track = small_track(4)
    beam = labelled(photons_of(track), workflow(signal={"method": method}))
    assert f1(beam.kept, track.truth > 0) > 0.8
    if method == "published":
        left = len(beam.kept) - beam.cells["expected"].sum()
        assert beam.kept.sum() == pytest.approx(left, abs=1.0), "as many as the rate leaves"


def test_the_published_filter_has_no_rules_for_water() -> None:
    rng = np.random.default_rng(3)
    surface = rng.uniform(0, 3000, 6000), rng.normal(0.0, 0.1, 6000)
    noise = rng.uniform(0, 3000, 3000), rng.uniform(-60, 60, 3000)
    photons = lattice(*np.concatenate([surface, noise], axis=1))
    levels = {
        method: np.unique(labelled(photons, workflow(signal={"method": method})).columns["level"])
        for method in ("likelihood", "published")
    }
    assert (levels["likelihood"] != NO_WATER).any()
    assert levels["published"].tolist() == [NO_WATER]
