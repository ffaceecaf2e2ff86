"""Returns that two files hold count once."""

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from spl_batch.airborne.tasks.stretches import TIME_ORDER, _once
from spl_batch.engine.plan.input_files import source_key
from spl_batch.engine.watch.events import Event, Note
from spl_batch.lattice.tables import COLUMNS, PointTable
from tests import surveys


def lines(survey: Path) -> list[Path]:
    return sorted((survey.parent / "lines").glob("*.laz"))


def assessed(output: Path) -> dict[str, np.ndarray]:
    clouds = surveys.delivered(output)
    return {name: columns["noise_class"] != 255 for name, columns in clouds.items()}


def test_a_file_that_is_delivered_twice_counts_once(small: Path, small_output: Path) -> None:
    path = lines(small)[0]
    twin = path.with_name("another.laz")
    shutil.copy(path, twin)
    result = surveys.run(small)
    assert result.exit_status == 0
    names = [f"lines/{path.name}", "lines/another.laz"]
    kept, copy = sorted(names, key=source_key)
    got, alone = surveys.labels(result.output), surveys.labels(small_output)
    wanted = alone[names[0]]
    for key, values in wanted.items():
        assert np.array_equal(got[kept][key], values, equal_nan=values.dtype.kind == "f"), key
    classes = surveys.delivered(result.output)
    assert np.array_equal(classes[copy]["classification"], classes[kept]["classification"])
    assert not assessed(result.output)[copy].any()
    assert assessed(result.output)[kept].sum() == assessed(small_output)[names[0]].sum() > 0
    for name, raster in surveys.rasters(small_output).items():
        assert np.array_equal(surveys.rasters(result.output)[name][0], raster[0]), name
    counts = result.report.counts
    size = len(surveys.cloud(path)["X"])
    assert counts.points_in == counts.points_out
    assert counts.not_assessed >= size
    (one,) = surveys.found(result.report.findings, "I03", "files")
    assert (one.subject, one.values["count"]) == (f"{copy} and {kept}", size)


def test_a_copy_whose_times_are_broken_is_not_the_original(small: Path, small_output: Path) -> None:
    path = lines(small)[0]
    columns = surveys.flightline(shots=120, psid=1, seed=1)
    assert len(columns["x"]) == len(surveys.cloud(path)["X"]), "the survey's first line"
    columns["gps_time"][::10] = np.nan
    name = f"lines/{path.name}"
    # Of two equal ones the key decides: the copy has the lower one.
    tried = (f"lines/copy_{k}.laz" for k in range(100))
    copy = next(other for other in tried if source_key(other) < source_key(name))
    surveys.write_cloud(small.parent / copy, columns)
    result = surveys.run(small, until="deliver")
    assert np.array_equal(assessed(result.output)[name], assessed(small_output)[name])
    assert not assessed(result.output)[copy].any()


def test_points_that_a_file_holds_twice_count_once(small: Path, small_output: Path) -> None:
    path = lines(small)[0]
    columns = surveys.flightline(shots=120, psid=1, seed=1)
    size = len(columns["x"])
    assert size == len(surveys.cloud(path)["X"]), "the survey's first line"
    columns["classification"] = np.full(size, 2, np.uint8)
    some = surveys.take(columns, slice(40, 60))
    surveys.write_cloud(path, surveys.join(columns, some, some))
    result = surveys.run(small)
    name = f"lines/{path.name}"
    cloud = surveys.delivered(result.output)[name]
    assert np.all(cloud["input_classification"] == 2)
    of_originals = np.tile(cloud["classification"][40:60], 2)
    assert np.array_equal(cloud["classification"][size:], of_originals)
    found = assessed(result.output)[name]
    alone = assessed(small_output)[name]
    assert np.array_equal(found[:size], alone)
    assert not found[size:].any()
    for raster_name, raster in surveys.rasters(small_output).items():
        assert np.array_equal(surveys.rasters(result.output)[raster_name][0], raster[0])
    (one,) = surveys.found(result.report.findings, "I03", "repeated")
    more = 2 * int(np.count_nonzero(alone[40:60]))
    assert (one.subject, one.values["count"]) == (name, more)
    assert one.values["points"] == size + 40


@pytest.mark.parametrize("name", TIME_ORDER[: TIME_ORDER.index("source")])
def test_points_that_differ_in_anything_are_no_copies(name: str) -> None:
    columns = {key: np.full(3, 5, COLUMNS[key].dtype) for key in TIME_ORDER}
    columns["index"] = np.arange(3, dtype=np.uint32)
    columns[name][2] += 1
    kept, copies = _once(PointTable(columns), [5])
    assert kept["index"].tolist() == [0, 2]
    assert copies.number.tolist() == [1]


def warned(survey: Path, until: str) -> list[str]:
    """Warnings of a run up to a stage."""
    events: list[Event] = []
    surveys.run(survey, until=until, listener=events.append)
    return [e.text for e in events if isinstance(e, Note) and e.level == "warning"]


def test_a_flightline_and_its_copy_of_another_number_are_told(small: Path) -> None:
    twin = surveys.flightline(shots=120, psid=7, seed=1)
    surveys.write_cloud(lines(small)[0].with_name("twin.laz"), twin)
    (text,) = [text for text in warned(small, "index") if "I03" in text]
    assert "00001_371000000, 00007_371000000" in text


def linear_mode(survey: Path) -> dict[str, Any]:
    """Delivered columns of a survey that is not filtered, and its density, by name."""
    result = surveys.run(survey, "filter.method=none", "afterpulse.enabled=false")
    assert result.exit_status == 0
    found = dict(surveys.delivered(result.output))
    return {
        "density": surveys.rasters(result.output)["density.tif"],
        "report": result.report,
        **found,
    }


def test_copies_in_linear_mode_count_once(tmp_path: Path) -> None:
    columns = surveys.flightline(shots=120, psid=1, seed=1, noise=0.0)
    size = len(columns["x"])
    for folder, times in (("once", 1), ("again", 2)):
        twice = surveys.join(*[{**columns, "classification": np.full(size, 5, np.uint8)}] * times)
        cloud = tmp_path / folder / "lines/a.laz"
        surveys.write_cloud(cloud, twice, point_format=0, channel=False)
        surveys.write_workflow(tmp_path / folder, survey={"channel_dimension": None})
    shutil.copy(cloud, cloud.with_name("b.laz"))
    once, again = (linear_mode(tmp_path / folder / "workflow.yaml") for folder in ("once", "again"))
    assert again["density"][0] == once["density"][0]
    assert again["report"].counts.ground == once["report"].counts.ground > 0
    assert again["report"].counts.not_assessed == again["report"].counts.copies == 3 * size
    assert again["report"].counts.no_beam == 0
    for name in ("lines/a.laz", "lines/b.laz"):
        got = again[name]["classification"].reshape(2, size)
        assert np.array_equal(got, np.tile(once["lines/a.laz"]["classification"], (2, 1)))


def test_intensity_tells_copies_apart_where_times_are_none(tmp_path: Path) -> None:
    columns = surveys.flightline(shots=20, psid=1, seed=1, noise=0.0)
    size = len(columns["x"])
    columns["gps_time"] = np.zeros(size)
    scaled = {**columns, "intensity": columns["intensity"] * np.uint16(128)}
    assert unfiltered_points(tmp_path, columns, scaled) == 2 * size


@pytest.mark.parametrize("timed", [True, False])
def test_copies_of_another_number_count_once_in_linear_mode(tmp_path: Path, *, timed: bool) -> None:
    columns = surveys.flightline(shots=20, psid=1, seed=1, noise=0.0)
    if not timed:
        columns["gps_time"] = np.zeros(len(columns["x"]))
    twin = {**columns, "point_source_id": columns["point_source_id"] + np.uint16(6)}
    assert unfiltered_points(tmp_path, columns, twin) == len(columns["x"])


def unfiltered_points(folder: Path, *clouds: surveys.Columns) -> int:
    """Points that count of a survey of these clouds that is not filtered."""
    for number, cloud in enumerate(clouds):
        surveys.write_cloud(folder / f"lines/{number}.laz", cloud, channel=False)
    survey = surveys.write_workflow(folder, survey={"channel_dimension": None})
    surveys.run(survey, "filter.method=none", "afterpulse.enabled=false", until="shuffle")
    tiles = (folder / "out/store/receipts/build_tile").glob("*.json")
    return sum(json.loads(path.read_text())["facts"]["points"] for path in tiles)
