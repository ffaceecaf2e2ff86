"""Bad input: one clear line each, never a traceback, the exit status of the contract."""

import json
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


def refused(ended: Ended, *words: str) -> None:
    """Nothing was started, and one line on standard error says why."""
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


def warned(ended: Ended, *words: str) -> str:
    """All was done, and a warning says what is odd."""
    assert ended.status == 0, ended.text
    flat = " ".join(ended.text.split())
    for word in words:
        assert word in flat, flat
    return flat


def not_las(path: Path) -> None:
    path.write_text("x,y,z\n1,2,3\n" * 200)


def empty_file(path: Path) -> None:
    path.write_bytes(b"")


def many_vlrs(path: Path) -> None:
    patch(path, 100, "I", 1_069_128_089)


def zero_scale(path: Path) -> None:
    patch(path, 131, "d", 0.0)


def wrong_version(path: Path) -> None:
    patch(path, 25, "B", 9)


def cut_header(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:120])


def cut_in_half(path: Path) -> None:
    content = path.read_bytes()
    path.write_bytes(content[: len(content) * 2 // 3])


def lost_chunk_table(path: Path) -> None:
    content = bytearray(path.read_bytes())
    start = struct.unpack_from("<I", content, 96)[0]
    struct.pack_into("<q", content, start, 2**40)
    path.write_bytes(content)


BROKEN = [
    not_las,
    empty_file,
    many_vlrs,
    zero_scale,
    wrong_version,
    cut_header,
    cut_in_half,
    lost_chunk_table,
]


@pytest.mark.parametrize("spoil", BROKEN)
def test_a_broken_file_alone_is_refused(survey: Path, spoil: Callable[[Path], None]) -> None:
    path = survey.parent / "lines/good.laz"
    spoil(path)
    refused(run(survey), "no input is usable", "good.laz")


@pytest.mark.parametrize("spoil", [not_las, many_vlrs, cut_in_half])
def test_a_broken_file_among_good_ones_is_named(
    survey: Path, spoil: Callable[[Path], None]
) -> None:
    bad = survey.parent / "lines/bad.laz"
    shutil.copy(survey.parent / "lines/good.laz", bad)
    spoil(bad)
    promised = 0 if spoil is not cut_in_half else len(surveys.cloud(bad.parent / "good.laz")["X"])
    ended = run(survey)
    failed(ended, survey, "bad.laz")
    assert f"unusable: {bad}: " in ended.err
    report = json.loads((survey.parent / "out/report.json").read_text(encoding="utf-8"))
    assert report["counts"]["not_read"] == promised, "what a sound header says is missed"
    ended = surveys.command("plan", survey)
    assert ended.status == 1
    assert f"unusable: {bad}: " in ended.out
    bad.unlink()
    assert run(survey).status == 0


def test_a_file_is_mended_and_only_that_is_done(survey: Path) -> None:
    bad = survey.parent / "lines/bad.laz"
    line = surveys.flightline(shots=TINY, psid=2, seed=4)
    surveys.write_cloud(bad, line)
    cut_in_half(bad)
    assert run(survey).status == 1
    surveys.write_cloud(bad, line)
    assert run(survey).status == 0
    assert (survey.parent / "out/laz/lines/bad.laz").exists()


def test_no_such_files(survey: Path) -> None:
    for name, words in (
        ("survey.flightlines=none/*.laz", "matches no file; check the path"),
        ("survey.flightlines=none.laz", "does not exist; check the path"),
        ("output=/no/such/out", "output: /no/such/out: there is no folder /no/such; check"),
        ("survey.trajectory=none.csv", "survey.trajectory"),
        ("reference.points=none.laz", "reference.points"),
        ("water=none.gpkg", "water: "),
        ("aoi=none.gpkg", "aoi: "),
    ):
        refused(run(survey, "--set", name), words)
    refused(run(survey.parent / "none.yaml"), "none.yaml", "No such file")
    everything = [
        "--set",
        "aoi=none.gpkg",
        "--set",
        "water=no.gpkg",
        "--set",
        "survey.trajectory=t",
    ]
    refused(run(survey, *everything), "aoi: ", "water: ", "survey.trajectory: ")


def test_unknown_keys_and_options(survey: Path) -> None:
    refused(run(survey, "--set", "filter.alhpa=0.1"), "filter.alhpa", "alpha")
    refused(run(survey, "--set", "nonsense"), "key.path=value")
    refused(run(survey, "--set", "survey.flightlines=*.laz"), "not valid YAML", "quote it")
    refused(run(survey, "--set", "products.cell_m=0.3"), "ground.cell_m", "whole multiple")
    refused(run(survey, "--memory", "lots"), "--memory lots")
    refused(run(survey, "--set", "output=s3://bucket/x"), "s3://bucket/x is a URL", "outputs.store")
    assert not (survey.parent / "s3:").exists(), "it had become a folder"
    assert run(survey, "--until", "nowhere").status == 2
    assert run(survey, "--no-such-option").status == 2
    assert surveys.command("run").status == 2
    for verb in ("plan", "run"):
        refused(surveys.command(verb, survey, "--workers", -1), "--workers -1")


def line_without_time() -> surveys.Columns:
    line = surveys.flightline(shots=TINY, psid=2, seed=4)
    line["gps_time"] = np.zeros(len(line["x"]))
    return line


def test_all_times_zero(survey: Path) -> None:
    surveys.write_cloud(survey.parent / "lines/zero.laz", line_without_time())
    text = warned(run(survey), "zero.laz", "no usable gps_time")
    assert "unfiltered" in text
    got = surveys.delivered(survey.parent / "out")
    assert np.all(got["lines/zero.laz"]["noise_class"] == 255)
    assert np.all(got["lines/good.laz"]["noise_class"] != 255)
    (survey.parent / "lines/good.laz").unlink()
    refused(run(survey), "zero.laz", "usable gps_time", "filter.method: none")
    settings = ["--set", "filter.method=none", "--set", "afterpulse.enabled=false"]
    warned(run(survey, *settings))
    assert (survey.parent / "out/dtm.tif").exists()


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


def test_crs_mismatch_between_clouds(survey: Path) -> None:
    other = surveys.flightline(shots=TINY, psid=2, seed=4)
    surveys.write_cloud(survey.parent / "lines/other.laz", other, crs="EPSG:32616")
    surveys.write_cloud(survey.parent / "lines/third.laz", surveys.flightline(shots=10, psid=3))
    failed(run(survey), survey, "other.laz", "reproject")


def test_crs_mismatch_of_the_reference(survey: Path) -> None:
    reference = surveys.flightline(shots=10)
    surveys.write_cloud(survey.parent / "reference.laz", reference, crs="EPSG:25832")
    ended = run(survey, "--set", "reference.points=reference.laz")
    refused(ended, "reference.points", "reference.laz", "reproject")


@pytest.mark.parametrize("crs", ["EPSG:2277", "EPSG:6588"])
def test_crs_in_feet(survey: Path, crs: str) -> None:
    path = survey.parent / "lines/good.laz"
    surveys.write_cloud(path, surveys.flightline(shots=TINY), crs=crs)
    refused(run(survey), "good.laz", "foot")


def test_crs_in_degrees(survey: Path) -> None:
    path = survey.parent / "lines/good.laz"
    surveys.write_cloud(path, surveys.flightline(shots=TINY), crs="EPSG:4326")
    refused(run(survey), "good.laz", "degree")
    surveys.write_cloud(path, surveys.flightline(shots=TINY), crs=None)
    refused(run(survey, "--set", "survey.crs=EPSG:4326"), "degree")
    refused(run(survey, "--set", "survey.crs=EPSG:nonsense"), "survey.crs", "not a known CRS")
    warned(run(survey), "no input file carries a CRS")


def test_missing_channel_dimension(survey: Path) -> None:
    path = survey.parent / "lines/good.laz"
    surveys.write_cloud(path, surveys.flightline(shots=TINY), channel=False)
    surveys.write_cloud(path.with_stem("more"), surveys.flightline(shots=TINY), channel=False)
    refused(run(survey), "good.laz, ", "more.laz; there are X, ", "no dimension 'channel'")
    ended = run(survey, "--set", "survey.channel_dimension=userdata")
    refused(ended, "survey.channel_dimension: no dimension 'userdata' in ", "more.laz; the nearest")
    assert ended.err.count("user_data") == 1
    assert ended.err.rstrip().endswith("the nearest is 'user_data'")
    surveys.write_cloud(path, surveys.flightline(shots=TINY))
    (fault,) = api.plan(survey).faults
    assert fault.endswith(
        "more.laz: no dimension 'channel' (survey.channel_dimension), which other files have; "
        "add it, or process the file apart"
    )
    path.with_stem("more").unlink()
    surveys.write_cloud(path, surveys.flightline(shots=TINY), channel=False)
    warned(run(survey, "--set", "survey.channel_dimension=null"))


def few(n: int) -> surveys.Columns:
    line = surveys.flightline(shots=TINY)
    return surveys.take(line, np.linspace(0, len(line["x"]) - 1, n).astype(int))


def test_no_points_at_all(survey: Path) -> None:
    surveys.write_cloud(survey.parent / "lines/good.laz", few(0))
    refused(run(survey), "no input is usable", "no points")


@pytest.mark.parametrize("key", ["aoi", "water", "breaklines"])
def test_polygons_that_are_none_or_damaged_start_nothing(survey: Path, key: str) -> None:
    path = survey.parent / "area.gpkg"
    write_polygons(path, [shapely.box(0, 0, 9, 9)], surveys.CRS_NAME)
    rings = bytearray(path.read_bytes())
    polygon_of_one_ring = rings.index(struct.pack("<II", 3, 1))
    struct.pack_into("<I", rings, polygon_of_one_ring + 4, 2**32 - 1)
    for content, said in (
        (b"no polygons", "cannot be read as shapes"),
        (bytes(rings), "feature 1: has no geometry that can be decoded: mend or delete it"),
    ):
        path.write_bytes(content)
        for verb in ("plan", "run"):
            ended = surveys.command(verb, survey, "--workers", 0, "--set", f"{key}=area.gpkg")
            refused(ended, f"{key}: {path}: ", said)
    assert not (survey.parent / "out").exists()


def test_status_and_report_of_nothing(tmp_path: Path) -> None:
    for name in ("status", "report"):
        ended = surveys.command(name, tmp_path)
        assert ended.status == 2
        assert str(tmp_path) in ended.err


@pytest.mark.parametrize(("dimension", "held"), [("user_data", "0"), ("return_number", "1")])
def test_a_dimension_that_holds_no_beamlet_numbers_is_refused(
    tmp_path: Path, dimension: str, held: str
) -> None:
    workflow = surveys.small_survey(tmp_path, survey={"channel_dimension": dimension})
    for path in (tmp_path / "lines").glob("*.laz"):
        columns = surveys.flightline(shots=120, psid=int(path.stem[-1]))
        surveys.write_cloud(path, columns | {"user_data": np.zeros(len(columns["x"]), np.uint8)})
    ended = surveys.command("run", workflow, "--workers", 0)
    assert ended.status == 2
    assert f"survey.channel_dimension: {dimension} holds only {held} in" in ended.err
    assert all(f"lines/{path.name}" in ended.err for path in (tmp_path / "lines").glob("*.laz"))
    assert "100 beamlets" in ended.err
    assert (
        surveys.command(
            "run",
            workflow,
            "--workers",
            0,
            "--set",
            "survey.channel_dimension=channel",
            "--until",
            "shots",
        ).status
        == 0
    )
