"""Bad input: one clear line each, never a traceback, the exit status of the contract."""

import shutil
import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import shapely

from spl_batch import api
from spl_batch.airborne.simulate.file_writers import write_polygons
from spl_batch.errors import grouped
from tests import surveys
from tests.io_files import patch
from tests.surveys import Ended

TINY = 40
"""Shots of the flightlines here."""


@pytest.fixture
def survey(tmp_path: Path) -> Path:
    """A good survey of one file, to be spoilt."""
    surveys.write_cloud(tmp_path / "lines/good.laz", surveys.flightline(shots=TINY))
    return surveys.write_workflow(tmp_path)


def run(workflow: Path, *options: str) -> Ended:
    return surveys.command("run", workflow, "--workers", 0, *options)


def planned(workflow: Path, *options: object) -> Ended:
    """A plan, which prepares as a run does."""
    return surveys.command("plan", workflow, *options)


def refused(ended: Ended, *words: str) -> None:
    """Nothing was started, and one line on standard error gives the reason."""
    assert ended.status == 2, ended.text
    whole = ended.err.replace("\n  ", " ")  # what is too long for the screen goes on below
    lines = [x for x in whole.splitlines() if x.startswith("spl-batch: ")]
    assert len(lines) == 1, ended.err
    for word in words:
        assert word in lines[0], lines[0]


def failed(ended: Ended, workflow: Path, *words: str) -> str:
    """Something failed, is named on the screen and in the report; the rest is finished."""
    assert ended.status == 1, ended.text
    report = (workflow.parent / "out/report.json").read_text()
    for word in words:
        assert word in report
    flat = " ".join(ended.text.split())
    assert words[0] in flat
    assert (workflow.parent / "out/laz/lines/good.laz").exists()
    assert (workflow.parent / "out/dtm.tif").exists()
    return report


def many_vlrs(path: Path) -> None:
    patch(path, 100, "I", 1_069_128_089)


def cut_in_half(path: Path) -> None:
    content = path.read_bytes()
    path.write_bytes(content[: len(content) * 2 // 3])


@pytest.mark.parametrize("spoil", [many_vlrs, cut_in_half])
def test_a_broken_file_among_good_ones_is_named_and_mended(
    survey: Path, spoil: Callable[[Path], None]
) -> None:
    bad = survey.parent / "lines/bad.laz"
    shutil.copy(survey.parent / "lines/good.laz", bad)
    spoil(bad)
    promised = 0 if spoil is not cut_in_half else len(surveys.cloud(bad.parent / "good.laz")["X"])
    ended = run(survey)
    failed(ended, survey, "bad.laz")
    assert f"unusable: {bad}: " in ended.err
    report = surveys.report(survey.parent / "out")
    assert report["counts"]["not_read"] == promised, "what a sound header counts is missed"
    ended = surveys.command("plan", survey)
    assert ended.status == 1
    assert f"unusable: {bad}: " in ended.out
    bad.unlink()
    assert run(survey).status == 0


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ("survey.flightlines=none/*.laz", ["none/*.laz"]),
        ("survey.flightlines=none.laz", ["none.laz"]),
        ("output=/no/such/out", ["output", "/no/such"]),
        ("survey.trajectory=none.csv", ["survey.trajectory"]),
        ("reference.points=none.laz", ["reference.points"]),
        ("water=none.gpkg", ["water: "]),
        ("filter.alhpa=0.1", ["filter.alhpa", "alpha"]),
        ("nonsense", ["key.path=value"]),
        ("survey.flightlines=*.laz", ["quote it"]),
        ("products.cell_m=0.3", ["ground.cell_m"]),
        ("output=s3://bucket/x", ["s3://bucket/x", "outputs.store"]),
        ("survey.channel_dimension=userdata", ["survey.channel_dimension", "'user_data'"]),
        ("survey.crs=EPSG:nonsense", ["survey.crs"]),
    ],
)
def test_a_setting_that_cannot_be_is_named(survey: Path, setting: str, words: list[str]) -> None:
    if setting.startswith("survey.crs"):
        line = surveys.flightline(shots=TINY)
        surveys.write_cloud(survey.parent / "lines/good.laz", line, crs=None)
    refused(planned(survey, "--set", setting), *words)
    assert not (survey.parent / "s3:").exists(), "it had become a folder"


def test_all_that_is_wrong_is_named_at_once(survey: Path) -> None:
    settings = ("aoi=none.gpkg", "water=no.gpkg", "survey.trajectory=t")
    options = [word for one in settings for word in ("--set", one)]
    refused(planned(survey, *options), "aoi: ", "water: ", "survey.trajectory: ")


def line_without_time() -> surveys.Columns:
    line = surveys.flightline(shots=TINY, psid=2, seed=4)
    line["gps_time"] = np.zeros(len(line["x"]))
    return line


def test_all_times_zero(survey: Path) -> None:
    surveys.write_cloud(survey.parent / "lines/zero.laz", line_without_time())
    ended = run(survey, "--until", "deliver")
    assert ended.status == 0, ended.text
    assert "zero.laz" in ended.err
    got = surveys.delivered(survey.parent / "out")
    assert np.all(got["lines/zero.laz"]["noise_class"] == 255)
    assert np.all(got["lines/good.laz"]["noise_class"] != 255)
    (survey.parent / "lines/good.laz").unlink()
    refused(run(survey, "--until", "deliver"), "zero.laz", "filter.method: none")
    settings = ["--set", "filter.method=none", "--set", "afterpulse.enabled=false"]
    assert planned(survey, *settings).status == 0


def test_the_trajectory_misses_a_part(survey: Path) -> None:
    line = surveys.flightline(shots=TINY)
    path = survey.parent / "trajectory.csv"
    middle = surveys.START_S + TINY / surveys.PRF_HZ / 2
    surveys.write_trajectory(path, start_s=middle - 1.0, stop_s=middle + 0.05)
    with path.open() as stream:
        last = float(list(stream)[-1].split(",")[0])
    surveys.write_workflow(survey.parent)
    uncovered = line["gps_time"] > last
    assert 0 < np.count_nonzero(uncovered) < len(uncovered)
    ended = run(survey)
    assert ended.status == 0, ended.text
    report = (survey.parent / "out/report.json").read_text()
    n = int(np.count_nonzero(uncovered))
    assert f"does not cover {grouped(n)} returns" in report
    assert f'"no_beam": {n}' in report
    (columns,) = surveys.delivered(survey.parent / "out").values()
    assert np.array_equal(columns["noise_class"] == 255, uncovered)


def test_a_cloud_in_another_crs_is_named(survey: Path) -> None:
    other = surveys.flightline(shots=TINY, psid=2, seed=4)
    surveys.write_cloud(survey.parent / "lines/other.laz", other, crs="EPSG:32616")
    surveys.write_cloud(survey.parent / "lines/third.laz", surveys.flightline(shots=10, psid=3))
    (fault,) = api.plan(survey).faults
    assert "other.laz" in fault
    assert "-87 degree against -93 degree" in fault
    assert "--writers.las.a_srs" in fault
    surveys.write_cloud(survey.parent / "reference.laz", other, crs="EPSG:25832")
    refused(planned(survey, "--set", "reference.points=reference.laz"), "reference.laz")


@pytest.mark.parametrize(
    ("crs", "word"),
    [("+proj=utm +zone=15 +datum=WGS84 +units=km", "kilometre"), ("EPSG:4326", "degree")],
)
def test_crs_in_other_units(survey: Path, crs: str, word: str) -> None:
    path = survey.parent / "lines/good.laz"
    surveys.write_cloud(path, surveys.flightline(shots=TINY), crs=crs)
    refused(planned(survey), "good.laz", word)


def test_missing_channel_dimension(survey: Path) -> None:
    path = survey.parent / "lines/good.laz"
    line = surveys.flightline(shots=TINY)
    surveys.write_cloud(path.with_stem("more"), line, channel=False)
    (fault,) = api.plan(survey).faults
    assert "more.laz" in fault
    surveys.write_cloud(path, line, channel=False)
    refused(planned(survey), "good.laz, ", "more.laz", "'channel'")
    assert planned(survey, "--set", "survey.channel_dimension=null").status == 0


@pytest.mark.parametrize("key", ["aoi", "water", "breaklines"])
def test_polygons_that_are_none_or_damaged_start_nothing(survey: Path, key: str) -> None:
    path = survey.parent / "area.gpkg"
    write_polygons(path, [shapely.box(0, 0, 9, 9)], surveys.CRS_NAME)
    rings = bytearray(path.read_bytes())
    polygon_of_one_ring = rings.index(struct.pack("<II", 3, 1))
    struct.pack_into("<I", rings, polygon_of_one_ring + 4, 2**32 - 1)
    for content, message in (
        (b"no polygons", "cannot be read as shapes"),
        (bytes(rings), "feature 1: has no geometry that can be decoded: mend or delete it"),
    ):
        path.write_bytes(content)
        refused(planned(survey, "--set", f"{key}=area.gpkg"), f"{key}: {path}: ", message)
    assert not (survey.parent / "out").exists()


def test_status_and_report_of_nothing(tmp_path: Path) -> None:
    for name in ("status", "report"):
        ended = surveys.command(name, tmp_path)
        assert ended.status == 2
        assert str(tmp_path) in ended.err
