"""Clouds in the gate: found where they float, and never trees, hills or noise."""

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.altimetry.clouds import WOODED, woods
from benchmarks.altimetry.labelled_tracks import LAND, NOISE, Labelled, measured
from benchmarks.altimetry.odd_tracks import BRIGHT, DAY, NIGHT, SCENES, Scene, make, thin
from benchmarks.altimetry.photon_beams import Beam, Mask
from spl_batch.altimetry.noise import noise_rate as rates
from spl_batch.altimetry.noise.fog import BINS, Fog, find_fog, fog_at, fog_told
from spl_batch.altimetry.noise.layers_above import BIN_M, above, foot
from spl_batch.altimetry.photon_table import Cells
from spl_batch.altimetry.report.beam_warnings import _cloud
from spl_batch.altimetry.settings import RateSettings
from spl_batch.altimetry.water.layers_of_cells import fullest
from tests.altimetry.tracks import assert_cut_matters_nowhere, quanta

RATE = RateSettings()
WOODS = Scene(
    land=((0.0, 4000.0),),
    land_m=lambda x: 20.0 * np.sin(x / 150.0),
    trees=0.6,
    gate_m=(-120.0, 180.0),
    length_m=3000.0,
)
CLOUD_M = 90.0, 130.0


def cloudy(noise: float, light: float = 0.6, seed: int = 0) -> Labelled:
    """Wooded hills below a cloud over every other 750 m."""
    scene = replace(WOODS, clear=thin(1500.0, light), fog=(1.0, *CLOUD_M), noise_per_m2=noise)
    return make("cloud", scene, seed)


def in_cloud(track: Labelled) -> Mask:
    x, z = (values / 1000.0 for values in track.photons)
    inside: Mask = (x % 1500.0 < 750.0) & (z > CLOUD_M[0]) & (z < CLOUD_M[1])
    return inside


def found(track: Labelled) -> tuple[Cells, Mask]:
    """Cells, and photons that lie in what is found."""
    cells = rates.observe(*track.photons, RATE)
    cell = np.searchsorted(cells.index, track.photons[0] // 20_000)
    return cells, fog_at(cell, track.photons[1], cells.fog_low, cells.fog) > 0.0


@pytest.mark.parametrize(("noise", "light"), [(NIGHT, 0.6), (NIGHT, 0.05), (DAY, 0.6)])
def test_photons_of_a_cloud_are_noise_and_what_is_below_is_kept(noise: float, light: float) -> None:
    track = cloudy(noise, light)
    cloud = in_cloud(track)
    beam = Beam(track.photons, None)
    kept = beam.keep(beam.score())
    assert measured(kept, track.label)[0] > 0.93
    assert kept[track.label != NOISE].mean() > 0.9
    assert kept[cloud].mean() < 0.05


@pytest.mark.parametrize("relief_m", [0.0, 10.0])
def test_a_thin_bright_cloud_is_no_water_above_its_ground(relief_m: float) -> None:
    rng = np.random.default_rng(1)
    n = (1700, 4000, 12_000)
    x = np.concatenate([rng.uniform(0.0, 2000.0, count) for count in n])
    ground = relief_m * np.sin(x / 300.0)
    spread = (
        rng.normal(0.0, 0.15, n[0]),
        80.0 + rng.normal(0.0, 2.0, n[1]),
        rng.uniform(-70, 130, n[2]),
    )
    z = np.concatenate(spread)
    z[: n[0]] += ground[: n[0]]
    kind = np.repeat([LAND, NOISE, NOISE], n)
    order = np.argsort(x)
    beam = Beam(quanta(np.stack([x, z], axis=1)[order]), None)
    kept = beam.keep(beam.score())
    assert kept[kind[order] == LAND].mean() > 0.9
    assert kept[kind[order] == NOISE].mean() < 0.05


def test_a_cloud_is_found_where_it_is() -> None:
    track = cloudy(NIGHT)
    _, fog = found(track)
    cloud = in_cloud(track)
    assert fog[cloud].mean() > 0.95
    assert fog[~cloud].mean() < 0.01


@pytest.mark.parametrize("noise", [NIGHT, DAY, BRIGHT])
@pytest.mark.parametrize(
    "name",
    ["plain", "wooded island", "land alone, slope 0.5", "plain with trees", "nothing but noise"],
)
def test_trees_hills_and_noise_are_no_cloud(name: str, noise: float) -> None:
    cells, _ = found(make(name, replace(SCENES[name], noise_per_m2=noise), 1))
    assert not cells.fog.any()


@pytest.mark.parametrize("noise", [NIGHT, DAY])
@pytest.mark.parametrize("stem_m", [17.0, 32.0])
def test_tall_trees_without_lower_branches_are_no_cloud(stem_m: float, noise: float) -> None:
    track = make("woods", replace(WOODS, trees=0.9, noise_per_m2=noise), 2)
    x, z = (values.copy() for values in track.photons)
    ground = 20.0 * np.sin(x / 1000.0 / 150.0)
    crown = (track.label != NOISE) & (z / 1000.0 - ground > 3.0)
    z[crown] += round(stem_m * 1000.0)
    cells = rates.observe(x, z, RATE)
    assert not cells.fog.any()


@pytest.mark.parametrize("noise", [NIGHT, DAY])
@pytest.mark.parametrize("ground_per_shot", [0.04, 0.2])
@pytest.mark.parametrize("name", [name for name in WOODED if "45" not in name])
def test_woods_that_hide_the_ground_on_slopes_are_no_cloud(
    name: str, ground_per_shot: float, noise: float
) -> None:
    track = woods(WOODED[name], ground_per_shot, noise, 3)
    _, fog = found(track)
    assert fog[track.label != NOISE].mean() < 0.02


def test_steep_woods_under_a_bright_sky_are_no_cloud() -> None:
    track = woods(WOODED["mountains"], 0.2, BRIGHT, 0)
    _, fog = found(track)
    assert fog[track.label != NOISE].mean() < 0.02


class Box(NamedTuple):
    """Where a made-up layer lies: cells from to, heights from to [m], photons a square metre."""

    cells: tuple[int, int]
    heights_m: tuple[float, float]
    density: float


def layered(rng: np.random.Generator, boxes: list[Box]) -> tuple[np.ndarray, ...]:
    """Rows of cells and heights [quanta]: ground at 0 in 40 cells, and layers above it."""
    cell = [np.repeat(np.arange(40), 30)]
    height = [rng.normal(0.0, 0.1, 1200)]
    for box in boxes:
        n = rng.poisson(box.density * np.ptp(box.cells) * 20.0 * np.ptp(box.heights_m))
        cell.append(rng.integers(*box.cells, n))
        height.append(rng.uniform(*box.heights_m, n))
    return np.concatenate(cell), np.rint(np.concatenate(height) * 1000.0).astype(np.int32)


def test_a_bridge_a_bird_and_a_slope_are_no_cloud_and_a_layer_is() -> None:
    index, noise = np.arange(40), np.zeros(40)
    gate = np.full(40, -10_000, np.int32), np.full(40, 150_000, np.int32)

    def fog(*boxes: Box) -> Fog:
        cell, height = layered(np.random.default_rng(1), list(boxes))
        mode, *_ = fullest(cell, height, len(index))
        ground = foot(index, cell, height, mode, noise)
        seen = above(index, cell, height, (ground.quanta, ground.known), gate, 20.0)
        return find_fog(seen, ground)

    layer = fog(Box((10, 30), (70.0, 82.0), 0.05))
    assert layer.density[12:28].any(axis=1).all()
    assert np.median(layer.density[15:25][layer.density[15:25] > 0]) == pytest.approx(0.05, rel=0.3)
    assert not layer.density[:5].any()
    # Thin, in one place, from the ground up, too low.
    assert not fog(Box((10, 30), (70.0, 70.5), 1.0)).density.any()
    assert not fog(Box((20, 21), (70.0, 82.0), 0.5)).density.any()
    assert not fog(Box((10, 30), (0.0, 82.0), 0.05)).density.any()
    assert not fog(Box((10, 30), (10.0, 22.0), 0.05)).density.any()
    climbing = [Box((i, i + 1), (55.0 + 2 * i, 57.0 + 2 * i), 0.6) for i in range(40)]
    assert not fog(*climbing).density.any()
    # Two layers, each by its own density; the one above another counts as well.
    both = fog(Box((5, 35), (70.0, 82.0), 0.05), Box((5, 35), (110.0, 130.0), 0.1))
    cell, at = np.full(3, 20), np.array([76_000, 120_000, 96_000], np.int32)
    found_at = fog_at(cell, at, both.low, both.density)
    assert found_at[0] == pytest.approx(0.05, rel=0.4)
    assert found_at[1] == pytest.approx(0.1, rel=0.4)
    assert found_at[2] == 0.0


@settings(max_examples=3, deadline=None)
@given(st.integers(0, 5), st.integers(30, 120))
def test_clouds_do_not_depend_on_where_the_track_is_cut(seed: int, cut: int) -> None:
    along, height = cloudy(NIGHT, seed=seed).photons
    assert rates.observe(along, height, RATE).fog.any()
    assert_cut_matters_nowhere(along, height, cut)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10_000))
def test_the_density_of_a_place_is_that_of_its_bin(seed: int) -> None:
    rng = np.random.default_rng(seed)
    low = rng.integers(-50_000, 50_000, 4).astype(np.int32)
    density = np.where(rng.uniform(size=(4, BINS)) < 0.5, 0.0, 1.0 + rng.uniform(size=(4, BINS)))
    cell, height = rng.integers(0, 4, 50), rng.integers(-60_000, 300_000, 50).astype(np.int32)
    values = fog_at(cell, height, low, density.astype(np.float32))
    for i, c, h in zip(range(50), cell.tolist(), height.tolist(), strict=True):
        row = (h - int(low[c])) // (BIN_M * 1000)
        expected = density[c, row] if 0 <= row < BINS else 0.0
        assert values[i] == np.float32(expected)


def test_a_reader_is_told_of_a_cloud() -> None:
    track = cloudy(NIGHT)
    cells, _ = found(track)
    told: Mapping[str, float] = fog_told(cells.index, Fog(cells.fog_low, cells.fog), RATE.cell_m)
    assert told["low_m"] == pytest.approx(CLOUD_M[0], abs=8.0)
    assert told["high_m"] == pytest.approx(CLOUD_M[1], abs=8.0)
    assert told["length_m"] == pytest.approx(1500.0, rel=0.2)
    assert told["photons"] == pytest.approx(np.count_nonzero(in_cloud(track)), rel=0.1)
    (text,) = _cloud(told)
    assert "floats as a cloud does" in text
    assert not list(_cloud({}))
