"""Ground and canopy top of simple and of simulated tracks."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.altimetry.photon_beams import Kind, lattice, scene, workflow
from spl_batch.altimetry.ground import over_water
from spl_batch.altimetry.ground.cell_ground import fit_ground, lowest_layers, with_bends
from spl_batch.altimetry.ground.profile import (
    Layers,
    agree,
    layers_of,
    not_beside,
    photons_in_layers,
    profile,
)
from spl_batch.altimetry.settings import ProfileSettings
from spl_batch.altimetry.simulate import Track, simulate_track
from spl_batch.altimetry.tasks.heights import REFERENCE_GAP_M, _where, between
from spl_batch.altimetry.water.surface import AIR, NO_WATER, WATER
from spl_batch.formats.verified.parquet_npz import write_arrays

SETTINGS = ProfileSettings()
LAYERS = Layers(SETTINGS)
EVERYTHING = (-(10**9), 10**9)


def photons_of(x: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Photons in order on the lattice, all of them signal."""
    along, height = lattice(x, z)
    rows = np.lexsort((height, along))
    return along[rows], height[rows], np.ones(len(rows), np.bool_)


def signal_of(track: Track) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Signal of a track by its truth."""
    some = track.truth > 0
    return photons_of(track.along_m[some], track.height_m[some])


@settings(max_examples=20, deadline=None)
@given(st.floats(-0.6, 0.6), st.floats(0.0, 0.8), st.integers(0, 10_000))
def test_a_slope_under_trees_is_found(slope: float, cover: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    x = rng.uniform(0.0, 400.0, 2400)
    leaf = rng.uniform(size=len(x)) < cover
    z = 500.0 + slope * x + rng.normal(0.0, 0.15, len(x))
    z += np.where(leaf, rng.uniform(6.0, 15.0, len(x)), 0.0)
    columns = profile(*photons_of(x, z), EVERYTHING, LAYERS)
    inner = slice(1, -1)
    error = np.abs(columns["ground"] - 500.0 - slope * columns["along_track"])
    lean = np.abs(columns["slope"] - slope)
    assert np.nanmedian(error[inner]) < 0.2
    assert np.nanmedian(lean[inner]) < 0.05
    found = error < 0.5
    if cover <= 0.6:  # beneath denser leaves a column may hold too few photons of the ground
        assert found[inner].all()
        assert lean[inner].max() < 0.05
    wooded = (columns["canopy_photons"] > 30) & found
    tops = columns["canopy_height"][wooded]
    assert ((tops > 12.0) & (tops < 15.7)).all()
    if not cover:
        assert not columns["canopy_photons"].any()


def test_stray_photons_do_not_pull_the_ground_down_and_are_no_canopy() -> None:
    rng = np.random.default_rng(4)
    below, above = rng.uniform(20.0, 49.0, 40), rng.uniform(55.0, 60.0, 400)
    z = np.concatenate([rng.normal(50.0, 0.1, 800), below, above])
    along, height, sure = photons_of(rng.uniform(0.0, 400.0, len(z)), z)
    for signal, wooded in ((sure, True), (height < 52_000, False)):
        columns = profile(along, height, signal, EVERYTHING, LAYERS)
        assert np.abs(columns["ground"] - 50.0).max() < 0.15
        assert columns["canopy_photons"].any() == wooded


def test_a_cell_that_its_neighbours_contradict_is_put_right() -> None:
    index = np.arange(9)
    found = np.stack([10.0 + 2.0 * index, np.full(9, 0.1)], axis=1)
    found[4, 0] -= 30.0
    found[7] = np.nan
    out, asked = agree(index, found, SETTINGS, np.full(9, 1.5))
    assert out[4, 0] == pytest.approx(18.0)
    assert np.isnan(out[7]).all()
    assert asked.tolist() == [3, 4, 5, 6, 5, 5, 4, 0, 2]
    kept = [0, 1, 2, 3, 5, 6, 8]
    np.testing.assert_array_equal(out[kept], found[kept])


def test_a_lonely_clump_needs_photons_that_are_labelled_signal() -> None:
    rng = np.random.default_rng(5)
    along, height, _ = photons_of(rng.uniform(105.0, 115.0, 12), rng.normal(30.0, 0.2, 12))
    for sure, there in ((12, True), (9, True), (8, False), (0, False)):
        columns = profile(along, height, np.arange(12) < sure, EVERYTHING, LAYERS)
        assert np.isfinite(columns["ground"]).any() == there


def test_ground_that_rises_and_falls_within_a_cell_is_followed() -> None:
    """Ridges of 3 m every 25 m, as of crevassed ice: no line of 60 m follows them."""
    rng = np.random.default_rng(6)

    def land(x: np.ndarray) -> np.ndarray:
        return 1.5 * np.sin(x / 4.0) + 3.0 * np.sin(x / 22.0)

    x = rng.uniform(0.0, 1000.0, 8000)
    photons = photons_of(x, land(x) + rng.normal(0.0, 0.15, len(x)))
    columns = profile(*photons, EVERYTHING, Layers(SETTINGS, 0.75))
    off = np.abs(columns["ground"] - land(columns["along_track"]))
    assert np.count_nonzero(np.isfinite(off)) >= 48
    assert np.nanmedian(off) < 1.1  # 1.4 m by layers of three cells alone


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000), st.integers(0, 60))
def test_photons_in_a_layer_are_counted_as_by_hand(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    along, height, _ = photons_of(rng.uniform(0.0, 80.0, n), rng.normal(0.0, 2.0, n))
    x, z = along / 1000.0, height / 1000.0
    index, layers = np.array([0, 1, 3]), rng.uniform(-1.0, 1.0, (3, 2))
    layers[1] = np.nan
    for beside in (-1, 0, 1):
        found = photons_in_layers(along, z, (index, 20_000), layers, np.full(3, 0.7), beside)
        expected = []
        for cell, (level, slope) in zip(index, layers, strict=True):
            off = np.abs(z - level - slope * (x - 20.0 * cell - 10.0))
            expected.append(np.count_nonzero((off <= 0.7) & (x // 20.0 == cell - beside)))
        assert found.tolist() == expected


def test_a_cell_leaves_the_layer_beside_it_if_it_holds_no_part_of_it() -> None:
    found = np.array([[0.0, 0.1], [0.0, 0.1], [0.0, 0.1], [np.nan, np.nan]])
    own = np.full((4, 2), 5.0)
    # A hollow beside the cell; sparse ground under dense leaves; too few photons; no layer.
    in_found, in_own = np.array([0, 8, 0, 0]), np.array([40, 40, 6, 40])
    out = not_beside(found, own, in_found, in_own, 3)
    np.testing.assert_array_equal(out[0], own[0])
    np.testing.assert_array_equal(out[1:], found[1:])


def slow_layer(x: np.ndarray, z: np.ndarray, layer_m: float) -> tuple[float, int]:
    """Slope and count of the fullest layer of three bins, the gentlest of equals."""
    best = (0.0, 0)
    for tenth in sorted(range(-10, 11), key=lambda t: (abs(t), -t)):
        bins = np.floor((z - 0.1 * tenth * x) / (layer_m / 3.0))
        middles = np.arange(bins.min(), bins.max() + 1)
        most = max(np.count_nonzero(np.abs(bins - b) <= 1) for b in middles)
        if most > best[1]:
            best = (0.1 * tenth, most)
    return best


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 60))
def test_the_layer_is_what_counting_by_hand_gives(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    along, height, _ = photons_of(
        rng.uniform(-30.0, 30.0, n), rng.normal(0.0, rng.uniform(0.2, 10.0), n)
    )
    x, z, zero = along / 1000.0, height / 1000.0, np.zeros(1, np.int64)
    form = np.full(1, 1.5), np.full(1, 0.3), np.full(1, 10)
    (out,) = lowest_layers(along, z, zero, np.array([n]), zero, *form, 1.0, 3)
    slope, most = slow_layer(x, z, 1.5)
    if most < 3:
        assert np.isnan(out).all()
        return
    assert out[1] == pytest.approx(slope)
    bins = np.floor((z - slope * x) / 0.5)
    middle = np.floor(out[0] / 0.5)
    inside = np.count_nonzero(np.abs(bins - middle) <= 1)
    assert inside >= max(0.3 * most, 3)
    lower = [np.count_nonzero(np.abs(bins - b) <= 1) for b in np.arange(bins.min(), middle - 2)]
    assert all(count < max(0.3 * most, 3) for count in lower)


@pytest.mark.parametrize("bend", [0.0, 0.001])
def test_it_is_fitted_as_by_least_squares_where_nothing_strays(bend: float) -> None:
    """A line, and a parabola; that one is taken where the ground is curved."""
    rng = np.random.default_rng(2)
    x = np.sort(rng.uniform(-20.0, 30.0, 300))
    z = 3.0 + 0.2 * x + bend * x**2 + rng.normal(0.0, 0.1, 300)
    along, zero = np.rint(x * 1000).astype(np.int64), np.zeros(1, np.int64)
    layer = np.array([[3.2, 0.2]]), np.full(1, 1.5)
    out = fit_ground(along, z, zero, np.array([300]), zero, *layer, 10.0, 3)
    for degree, fit in ((1, out[0, :3]), (2, out[0, 4:7])):
        *_, slope, level = np.polyfit(x, z, degree)
        assert fit[0] == pytest.approx(level, abs=0.02)
        assert fit[1] == pytest.approx(slope, abs=0.002)
        if degree == 2 or not bend:
            design = np.vander(x, degree + 1)
            error = 0.1 * np.sqrt(np.linalg.inv(design.T @ design)[-1, -1])
            assert fit[2] == pytest.approx(error, rel=0.3)
    assert out[0, 3] == 300
    near = np.abs(x) <= 10.0
    assert out[0, 7] == pytest.approx(np.polyfit(x[near], z[near], 1)[1], abs=0.02)
    chosen = with_bends(np.zeros(1, np.int64), out, 3)
    np.testing.assert_array_equal(chosen[0, :3], out[0, 4:7] if bend else out[0, :3])


def test_ground_bends_where_the_cells_around_do() -> None:
    """A parabola that contradicts the line by three errors is chance in one cell, not in seven."""
    fits = np.tile([0.0, 0.0, 0.03, 90.0, 0.05, 0.0, 0.05, np.nan, np.nan], (40, 1))
    bent = 0.04 * 3.0
    fits[5, 4] = fits[20:27, 4] = bent
    fits[33, 4] = 0.04 * 6.0
    ground = with_bends(np.arange(40), fits, 3)[:, 0]
    assert ground[5] == 0.0
    assert (ground[21:26] == bent).all()
    assert ground[33] == 0.04 * 6.0


@pytest.mark.parametrize(("relief_m", "falls"), [(5.0, 2.0), (40.0, 2.0), (40.0, 1.5)])
def test_the_error_of_ground_covers_what_it_states(relief_m: float, falls: float) -> None:
    """Smooth and rough terrain: nine tenths or more within twice the error, and not for nothing."""
    rng = np.random.default_rng(7)
    number = np.arange(1, 200)
    high, phase = rng.rayleigh(1.0, 199) / number**falls, rng.uniform(0.0, 2.0 * np.pi, 199)

    def land(x: np.ndarray) -> np.ndarray:
        z: np.ndarray = (high * np.sin(2.0 * np.pi * number * x[:, None] / 4000.0 + phase)).sum(1)
        return z * relief_m / 3.0

    x = np.sort(rng.uniform(0.0, 4000.0, 7000))
    photons = photons_of(x, land(x) + rng.normal(0.0, 0.3, len(x)))
    found = profile(*photons, EVERYTHING, LAYERS)
    error = np.abs(found["ground"] - land(found["along_track"]))
    assert np.mean(error < 2.0 * found["ground_error"]) > 0.9
    assert np.sqrt(np.mean(found["ground_error"] ** 2)) < 2.75 * np.sqrt(np.mean(error**2))


@pytest.mark.parametrize(("kind", "gain"), [("mountain", 0.7), ("flat", 1.0)])
def test_layers_of_steep_tracks_are_thicker_and_of_flat_ones_as_before(
    kind: Kind, gain: float
) -> None:
    track = simulate_track(scene(kind, "infrared", 11, length_m=1500.0, canopy=0.4))
    layers, error = layers_of(SETTINGS, "atl03"), []
    for spread_m in (0.0, layers.spread_m):
        found = profile(*signal_of(track), EVERYTHING, layers._replace(spread_m=spread_m))
        off = found["ground"] - np.interp(found["along_track"], *track.reference_m.T)
        error.append(float(np.sqrt(np.nanmean(off**2))))
    assert error[1] < gain * error[0] if gain < 1.0 else error[1] == error[0]


def test_a_thickness_that_is_set_goes_before_that_of_a_layout() -> None:
    assert layers_of(SETTINGS, "csv") == LAYERS
    chosen = ProfileSettings(layer_m=1.0)
    assert layers_of(chosen, "atl03") == Layers(chosen, 1.0, 0.0)


@settings(max_examples=8, deadline=None)
@given(st.integers(1, 4), st.integers(2, 45), st.sampled_from([0.0, 6.6]))
def test_heights_do_not_depend_on_where_the_track_is_cut(
    seed: int, cut: int, spread: float
) -> None:
    track = simulate_track(scene("mountain", "infrared", seed, length_m=1000.0, canopy=0.4))
    along, height, _ = signal_of(track)
    sure = np.arange(len(along)) % 7 > 0
    layers = Layers(SETTINGS, spread_m=spread)
    whole = profile(along, height, sure, EVERYTHING, layers)
    reach, size = layers.reach_cells, 20_000
    parts = []
    for owned in ((EVERYTHING[0], cut), (cut, EVERYTHING[1])):
        rows = (along >= (owned[0] - reach) * size) & (along < (owned[1] + reach) * size)
        parts.append(profile(along[rows], height[rows], sure[rows], owned, layers))
    for name, values in whole.items():
        joined = np.concatenate([p[name] for p in parts])
        np.testing.assert_array_equal(values, joined, err_msg=name)


def test_a_reference_has_no_heights_in_its_wide_gaps() -> None:
    known = np.array([[0.0, 1.0], [100.0, 3.0], [101.0 + REFERENCE_GAP_M, 9.0]])
    at = np.array([-1.0, 0.0, 50.0, 100.0, 200.0, 101.0 + REFERENCE_GAP_M, 400.0])
    np.testing.assert_equal(between(at, known), [np.nan, 1.0, 2.0, 3.0, np.nan, 9.0, np.nan])
    np.testing.assert_equal(between(at[1:3], known[:1]), [1.0, np.nan])
    assert np.isnan(between(at, known[:0])).all()


def test_cells_are_placed_across_the_date_line(tmp_path: Path) -> None:
    where = {"latitude": np.arange(3.0), "longitude": np.array([179.9, -179.9, -179.7])}
    write_arrays(tmp_path / "places.npz", {"index": np.arange(3), **where})
    store: Any = SimpleNamespace(path=lambda *_: tmp_path / "places.npz")
    context: Any = SimpleNamespace(store=store, workflow=workflow())
    found = _where("beam", np.array([10.0, 30.0]), context)
    np.testing.assert_allclose(found["longitude"], [-180.0, -179.8])
    np.testing.assert_allclose(found["latitude"], [0.5, 1.5])


def test_a_profile_across_a_shore_has_one_line_and_the_floor_apart() -> None:
    rng = np.random.default_rng(5)
    x = rng.uniform(0.0, 2000.0, 8000)
    shore, kind = x < 1010.0, rng.random(8000)
    z = np.where(shore, 0.0, (x - 1010.0) / 50.0) + rng.normal(0.0, 0.1, 8000)
    z[shore & (kind < 0.5)] -= 8.0
    z[~shore & (kind < 0.5)] += rng.uniform(5.0, 15.0, np.count_nonzero(~shore & (kind < 0.5)))
    photons = photons_of(x, z)
    along = photons[0]
    level = np.where(along < 1_020_000, 0, NO_WATER).astype(np.int64)
    whole = over_water.profile(photons, level, (0, 100), LAYERS, 0.0)
    wet = whole["water"] == 1
    np.testing.assert_array_equal(wet, whole["cell"] < 51)
    truth = np.maximum(whole["along_track"] - 1010.0, 0.0) / 50.0
    assert np.abs(whole["ground"] - truth).max() < 0.5
    assert np.abs(whole["floor"][wet][:-2] + 8.0).max() < 0.2
    assert np.isnan(whole["floor"][~wet]).all()
    assert not whole["canopy_photons"][wet].any()
    assert np.isnan(whole["canopy_height"][wet]).all()
    assert (whole["canopy_height"][~wet] > 10.0).mean() > 0.9


def test_water_whose_surface_is_lost_keeps_its_floor() -> None:
    rng = np.random.default_rng(6)
    photons = photons_of(rng.uniform(0.0, 400.0, 1500), rng.normal(-5.0, 0.1, 1500))
    found = over_water.profile(photons, np.zeros(1500, np.int64), (0, 20), LAYERS, 0.0)
    assert np.isnan(found["ground"]).all()
    assert np.abs(found["floor"] + 5.0).max() < 0.1
    np.testing.assert_allclose(found["floor_refracted"], found["floor"] * AIR / WATER, atol=0.01)
