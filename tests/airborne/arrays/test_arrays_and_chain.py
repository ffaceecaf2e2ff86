"""Arrays in, labels out: the same labels and rasters as a run on the same points."""

from pathlib import Path
from typing import Any, NamedTuple

import laspy
import numpy as np
import pyogrio
import pytest
import rasterio
import shapely
from numpy.typing import NDArray

import spl_batch
from spl_batch.formats.trajectory.positions import read_slice
from spl_batch.lattice.tables import Trajectory
from tests import surveys

Columns = dict[str, NDArray[Any]]


class Survey(NamedTuple):
    """Points of all files of a survey, the arguments of a caller, and what a run said of them."""

    xyz: NDArray[np.float64]
    shots: Columns
    told: Columns


def survey(output: Path) -> Survey:
    clouds = [laspy.read(path) for path in sorted((output / "laz").rglob("*.laz"))]

    def joined(name: str) -> NDArray[Any]:
        return np.concatenate([np.asarray(las[name]) for las in clouds])

    names = ["classification", "input_classification", "noise_class", "withheld"]
    names += ["p_value"] if "p_value" in clouds[0].point_format.dimension_names else []
    names += ["noise_density"] if "p_value" in names else []
    told = {name: joined(name) for name in names}
    used = ~np.isin(told["input_classification"], (7, 18)) & (told["withheld"] == 0)
    shots = {
        "gps_time": joined("gps_time"), "channel": joined("channel"),
        "flightline": joined("point_source_id"), "return_number": joined("return_number"),
    }  # fmt: skip
    xyz = np.concatenate([np.asarray(las.xyz) for las in clouds])
    return Survey(xyz[used], surveys.take(shots, used), surveys.take(told, used))


@pytest.fixture(scope="module")
def tiny(tiny_output: Path) -> Survey:
    return survey(tiny_output)


@pytest.fixture(scope="module")
def water(tiny: Survey, tiny_survey: Path) -> NDArray[np.bool_]:
    _, _, shapes, _ = pyogrio.raw.read(tiny_survey.parent / "water.gpkg")
    inside: NDArray[np.bool_] = shapely.contains_xy(
        shapely.union_all(shapely.from_wkb(shapes)), tiny.xyz[:, 0], tiny.xyz[:, 1]
    )
    return inside


def origins(path: Path, time_s: NDArray[np.float64]) -> NDArray[np.float64]:
    """Where the sensor was, by the positions that the run has read."""
    held = read_slice(path, float(time_s.min()), float(time_s.max()))
    return Trajectory(held.time_s, held.xyz_m).position(time_s)[0]


SETTINGS = {"acquisition": {"prf_hz": 25_000.0, "gate_m": 100.0}}


@pytest.fixture(scope="module")
def labels(tiny: Survey, tiny_output: Path, water: NDArray[np.bool_]) -> spl_batch.Labels:
    place = origins(tiny_output / "store" / "trajectory.parquet", tiny.shots["gps_time"])
    return spl_batch.filter_points(
        tiny.xyz, **tiny.shots, beam_origin=place, water=water, settings=SETTINGS
    )


def test_labels_are_those_of_a_run(tiny: Survey, labels: spl_batch.Labels) -> None:
    assert labels.basis == "beams"
    assert {0, 1, 2} <= set(labels.noise_class.tolist())
    np.testing.assert_array_equal(labels.noise_class, tiny.told["noise_class"])
    np.testing.assert_array_equal(labels.p_value, tiny.told["p_value"])
    np.testing.assert_array_equal(labels.noise_density, tiny.told["noise_density"])


def test_the_order_of_points_does_not_matter(
    tiny: Survey, tiny_output: Path, water: NDArray[np.bool_], labels: spl_batch.Labels
) -> None:
    turn = np.random.default_rng(5).permutation(len(tiny.xyz))
    place = origins(tiny_output / "store" / "trajectory.parquet", tiny.shots["gps_time"])
    again = spl_batch.filter_points(
        tiny.xyz[turn], **surveys.take(tiny.shots, turn), beam_origin=place[turn],
        water=water[turn], settings=SETTINGS,
    )  # fmt: skip
    np.testing.assert_array_equal(again.noise_class, labels.noise_class[turn])


def test_returns_far_beyond_a_stated_gate_are_noise(tiny: Survey, tiny_output: Path) -> None:
    place = origins(tiny_output / "store" / "trajectory.parquet", tiny.shots["gps_time"])
    astray = np.arange(len(tiny.xyz)) % 40 == 0
    xyz = tiny.xyz + astray[:, np.newaxis] * [0.0, 0.0, -1000.0]
    found = spl_batch.filter_points(xyz, **tiny.shots, beam_origin=place, settings=SETTINGS)
    assert set(found.noise_class[astray].tolist()) <= {1, 2}
    assert (found.noise_class[astray] == 1).mean() > 0.9


def test_without_origins_labels_are_those_of_a_run_without_a_trajectory(
    small_output: Path,
) -> None:
    small = survey(small_output)
    settings = {"acquisition": {"prf_hz": surveys.PRF_HZ, "gate_m": surveys.GATE_M}}
    labels = spl_batch.filter_points(small.xyz, **small.shots, settings=settings)
    assert labels.basis in {"intersection", "vertical"}
    np.testing.assert_array_equal(labels.noise_class, small.told["noise_class"])


def test_ground_and_rasters_are_those_of_a_run(
    tiny: Survey, tiny_output: Path, water: NDArray[np.bool_], labels: spl_batch.Labels
) -> None:
    ground = spl_batch.ground_points(tiny.xyz, labels, water=water)
    # In water polygons the class of ground is water.
    told = tiny.told["classification"]
    np.testing.assert_array_equal(ground[~water], told[~water] == 2)
    made = spl_batch.rasterize(tiny.xyz, labels, ground, water=water)
    for name in ("dtm", "dsm", "chm", "density"):
        with rasterio.open(tiny_output / f"{name}.tif") as source:
            run = source.read(1, masked=True).filled(np.nan)
            assert made.transform == tuple(source.transform)[:6]
        np.testing.assert_array_equal(getattr(made, name), run, err_msg=name)


def test_a_whole_survey_agrees_with_its_empty_space(labels: spl_batch.Labels) -> None:
    assert not any("empty space" in text for text in labels.warnings)
