"""Level water: its surface, its floor, refraction, and what is no water."""

from pathlib import Path
from typing import NamedTuple

import numpy as np
import pyarrow.csv
import pytest

from benchmarks.altimetry.photon_beams import labelled, lattice, scene, workflow
from spl_batch.altimetry.simulate import simulate_track
from spl_batch.altimetry.water.surface import AIR, NO_WATER, WATER, refracted, water_levels
from tests import surveys
from tests.altimetry.tracks import f1, labels, photons_of, write_workflow

NIGHT, DAY = 2e-4, 0.015
NOISE, SURFACE, FLOOR = 1, 2, 3


class WaterTrack(NamedTuple):
    """Photons along the track, their heights [m], and what they are."""

    x: np.ndarray
    z: np.ndarray
    kind: np.ndarray


def depth_m(x: np.ndarray) -> np.ndarray:
    """Of the floor: 3 to 17 m."""
    depth: np.ndarray = 10.0 - 7.0 * np.sin(x / 400.0)
    return depth


def water_track(noise_per_m2: float, length_m: float = 4000.0) -> WaterTrack:
    """Level water at 0 over a floor, light that it scatters within some 4 m, and noise."""
    rng = np.random.default_rng(1)
    rates_per_m = (1.2, 0.35, 0.1, noise_per_m2 * 100.0)
    n = [rng.poisson(rate * length_m) for rate in rates_per_m]
    x = [rng.uniform(0.0, length_m, count) for count in n]
    z = [
        rng.normal(0.0, 0.12, n[0]),
        rng.normal(0.0, 0.2, n[1]) - depth_m(x[1]),
        -rng.exponential(4.0, n[2]),
        rng.uniform(-70.0, 30.0, n[3]),
    ]
    kind = np.repeat([SURFACE, FLOOR, NOISE, NOISE], n)
    order = np.argsort(np.concatenate(x), kind="stable")
    return WaterTrack(*(np.concatenate(v)[order] for v in (x, z)), kind[order])


@pytest.mark.parametrize("noise", [NIGHT, DAY])
def test_surface_and_floor_are_kept_and_noise_is_not(noise: float) -> None:
    track = water_track(noise)
    beam = labelled(lattice(track.x, track.z), workflow())
    assert beam.kept[track.kind == SURFACE].mean() > 0.97
    assert beam.kept[track.kind == FLOOR].mean() > 0.9
    assert beam.kept[(track.kind == NOISE) & (track.z > 2.0)].mean() < 0.1
    false = np.count_nonzero(beam.kept & (track.kind == NOISE))
    assert 1 / 1.5 < beam.cells["false"].sum() / false < 1.5
    level = beam.columns["level"]
    assert (level != NO_WATER).mean() > 0.95
    assert np.abs(level[level != NO_WATER]).max() < 150


def test_the_surface_is_the_higher_of_two_level_layers() -> None:
    rng = np.random.default_rng(3)
    cell = np.sort(rng.integers(0, 100, 4000))
    height = np.rint(rng.normal(np.where(rng.random(4000) < 0.7, -3000, 0), 80.0))
    level = water_levels(cell, height.astype(np.int32), np.arange(100), 20.0)
    assert np.abs(level).max() < 60


@pytest.mark.parametrize(("relief_m", "canopy"), [(20.0, 0.0), (0.0, 0.8)])
def test_land_is_no_water(relief_m: float, canopy: float) -> None:
    wanted = scene("flat", "infrared", 2, length_m=3000.0, relief_m=relief_m, canopy=canopy)
    beam = labelled(photons_of(simulate_track(wanted)), workflow())
    assert (beam.columns["level"] != NO_WATER).mean() < 0.05


def test_clumps_of_noise_below_a_level_plain_are_no_floor() -> None:
    track = simulate_track(scene("flat", "infrared", 11, length_m=3000.0))
    beam = labelled(photons_of(track), workflow())
    assert f1(beam.kept, track.truth > 0) > 0.993  # 0.981 if they were


@pytest.mark.parametrize(("slope", "water"), [(0.0004, True), (0.002, False)])
def test_smooth_plains_that_lean_are_no_water(slope: float, *, water: bool) -> None:
    rng = np.random.default_rng(5)
    cell = np.sort(rng.integers(0, 100, 4000))
    height = np.rint(1000.0 * slope * 20.0 * cell + rng.normal(0.0, 60.0, 4000)).astype(np.int32)
    level = water_levels(cell, height, np.arange(100), 20.0)
    assert (level != NO_WATER).all() == (level != NO_WATER).any() == water


def test_no_photons_are_no_water() -> None:
    none = np.empty(0, np.int64)
    assert (water_levels(none, none.astype(np.int32), np.arange(20), 20.0) == NO_WATER).all()


@pytest.mark.parametrize("angle_deg", [0.0, 1.0, 15.0, 40.0])
def test_refraction_is_that_of_the_paper(angle_deg: float) -> None:
    """The triangle of C. Parrish et al. (2019), Eq. 1 to 9, where the product adds vectors."""
    depth = np.array([0.1, 2.0, 10.0, 38.0])
    one = np.radians(angle_deg)
    two = np.arcsin(1.00029 * np.sin(one) / 1.34116)
    s = depth / np.cos(one)
    r = s * 1.00029 / 1.34116
    p = np.sqrt(r**2 + s**2 - 2.0 * r * s * np.cos(one - two))
    beta = np.pi / 2.0 - one - np.arcsin(r * np.sin(one - two) / p)
    np.testing.assert_allclose(refracted(depth, angle_deg), p * np.sin(beta), rtol=1e-9)
    assert not refracted(np.array([-1.0, 0.0]), angle_deg).any(), "nothing moves above water"


def test_a_run_separates_surface_floor_and_column(tmp_path: Path) -> None:
    track = water_track(NIGHT, length_m=2500.0)
    rows = [f"{x:.3f},{z:.3f}" for x, z in zip(track.x, track.z, strict=True)]
    (tmp_path / "photons.csv").write_text("\n".join(["along_track,height", *rows]) + "\n")
    given = write_workflow(tmp_path, "photons.csv", outputs={"refraction": True})
    ended = surveys.command("run", given, "--workers", 0)
    assert ended.status == 0, ended.text
    table = labels(tmp_path / "out", "photons/track")
    assert (table["water"][track.kind == SURFACE] == 41).mean() > 0.95
    assert (table["water"][track.kind == FLOOR] == 40).mean() > 0.9
    assert set(np.unique(table["water"])) == {0, 40, 41, 45}
    lifted = table["height_refracted"] - table["height"]
    floor = table["water"] == 40
    expected = -table["height"][floor] * (1.0 - AIR / WATER)
    np.testing.assert_allclose(lifted[floor], expected, atol=0.1)
    assert (lifted[table["water"] == 41] == 0).all()
    path = tmp_path / "out/profiles/photons/track.csv"
    assert "nan" not in path.read_text()
    profile = pyarrow.csv.read_csv(path).to_pydict()
    columns = {name: np.array(values, float) for name, values in profile.items()}
    assert (columns["water"] == 1).all()
    # One line: the surface, never the floor, whose depth is no height of a canopy either.
    assert np.nanmax(np.abs(columns["ground"])) < 0.3
    assert np.isfinite(columns["ground"]).mean() > 0.95
    assert np.isnan(columns["canopy_height"]).all()
    seen = np.isfinite(columns["floor"])
    off = np.abs(columns["floor"] + depth_m(columns["along_track"]))[seen]
    assert seen.mean() > 0.9
    assert np.median(off) < 0.1
    assert (off < 1.0).mean() > 0.95
    lifted = columns["floor_refracted"][seen]
    np.testing.assert_allclose(lifted, columns["floor"][seen] * AIR / WATER, atol=0.1)
