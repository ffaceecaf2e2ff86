"""What a later run may trust: a file that no longer fits its receipt is made again."""

import json
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
import shapely.geometry

from spl_batch import api
from spl_batch.airborne.tasks import index, surfaces
from spl_batch.airborne.tasks import reference as reference_squares
from spl_batch.engine.store.working_store import Store, read_receipts
from spl_batch.engine.watch.events import Note
from spl_batch.errors import InputError, SplBatchError
from spl_batch.lattice.tables import PointTable
from tests import surveys


@pytest.fixture
def survey(tmp_path: Path) -> Path:
    for psid in (1, 2):
        line = surveys.flightline(shots=60, psid=psid, seed=psid)
        surveys.write_cloud(tmp_path / "lines" / f"{psid}.laz", line)
    return surveys.write_workflow(tmp_path)


def rasters(output: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(output.glob("*.tif"))}


def test_a_task_stopped_half_way_leaves_no_receipt_that_speaks_for_it(
    survey: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    output = api.run(survey, workers=0, until="deliver").output
    first = rasters(output)
    receipts = set((output / "store" / "receipts" / "surface").glob("*.json"))

    write_cell = surfaces.write_cell

    def killed(*args: Any) -> None:
        write_cell(*args)
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(surfaces, "write_cell", killed)
        with pytest.raises(KeyboardInterrupt):
            api.run(survey, workers=0, until="deliver", overrides=["products.void_max_m=1"])
    left = set((output / "store" / "receipts" / "surface").glob("*.json"))
    assert len(receipts - left) == 1, "the task that was stopped, and no other"
    (output / "dtm.tif").unlink()
    assert rasters(api.run(survey, workers=0, until="deliver").output) == first


def test_lost_raster_cells_are_made_again(survey: Path) -> None:
    output = api.run(survey, workers=0, until="deliver").output
    first = rasters(output)
    for folder in (output / "store").glob("rasters_*.zarr"):
        shutil.rmtree(folder)
    (output / "dsm.tif").unlink()
    assert rasters(api.run(survey, workers=0, until="deliver").output) == first


def test_what_an_input_left_behind_goes_with_it(survey: Path) -> None:
    output = api.run(survey, workers=0, until="deliver").output
    assert (output / "laz" / "lines" / "2.laz").exists()
    (survey.parent / "lines" / "2.laz").unlink()
    api.run(survey, workers=0, until="deliver")
    assert (output / "laz" / "lines" / "1.laz").exists()
    assert not (output / "laz" / "lines" / "2.laz").exists()


def test_points_of_a_file_that_breaks_off_are_counted(
    survey: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    read = index.iter_points

    def broken(path: Path, **options: Any) -> Iterator[PointTable]:
        if path.name == "2.laz":
            raise InputError(str(path), "point 17 cannot be decoded: copy the file again")
        yield from read(path, **options)

    monkeypatch.setattr(index, "iter_points", broken)
    result = api.run(survey, workers=0)
    assert result.exit_status == 1
    assert result.report is not None
    assert [f.stage for f in result.report.failures] == ["index"]
    lost = len(surveys.flightline(shots=60, psid=2, seed=2)["x"])
    assert result.report.counts.not_read == lost


@pytest.mark.parametrize(
    ("setting", "said"),
    [("products.cell_m=0.0003", "millimetres"), ("products.cell_m=3", "multiple")],
)
def test_cells_that_cannot_be_are_refused(survey: Path, setting: str, said: str) -> None:
    with pytest.raises(SplBatchError, match=said):
        api.run(survey, workers=0, overrides=[setting])


def test_status_tells_of_the_latest_run_alone(survey: Path) -> None:
    output = api.run(survey, workers=0, until="shots").output
    first = {s.stage: s.total for s in api.status(output).stages.values()}
    api.run(survey, workers=0, until="shots")
    assert {s.stage: s.total for s in api.status(output).stages.values()} == first


def test_polygons_edited_in_place_are_noticed(survey: Path) -> None:
    west, south = surveys.ORIGIN_M
    found = []
    for radius_m in (0.5, 500.0):
        circle = shapely.Point(west, south).buffer(radius_m)
        water = {"type": "Feature", "properties": {}, "geometry": shapely.geometry.mapping(circle)}
        crs = {"type": "name", "properties": {"name": "urn:ogc:def:crs:EPSG::32615"}}
        content = {"type": "FeatureCollection", "crs": crs, "features": [water]}
        (survey.parent / "water.geojson").write_text(json.dumps(content))
        overrides = ["water=water.geojson"]
        result = api.run(survey, workers=0, until="deliver", overrides=overrides)
        labels = surveys.labels(result.output).values()
        found.append(sum(np.count_nonzero(c["classification"] == 9) for c in labels))
    assert found[1] > 10 * found[0]


def test_a_damaged_reference_costs_neither_the_report_nor_the_rest(survey: Path) -> None:
    reference = survey.parent / "reference.laz"
    surveys.write_cloud(reference, surveys.flightline(shots=60))
    intact = api.run(survey, workers=0, overrides=["reference.points=reference.laz"])
    assert intact.exit_status == 0
    os.utime(reference, (0, 0))  # what is as it was is not read again

    def broken(path: Path, **_: Any) -> None:
        raise InputError(str(path), "point 17 cannot be decoded: copy the file again")

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(reference_squares, "iter_points", broken)
        result = api.run(survey, workers=0, overrides=["reference.points=reference.laz"])
    assert result.exit_status == 1
    assert result.report is not None
    (failure,) = result.report.failures
    assert (failure.stage, failure.place) == ("report", str(reference))
    assert "point 17" in failure.reason
    assert (result.output / "report.html").exists()


def test_a_survey_that_grows_and_shrinks_ends_as_if_it_never_had(survey: Path) -> None:
    """A line south of the others makes a cell of what was a strip, and a strip of the cell."""

    def cells(output: Path) -> dict[str, list[int]]:
        found = read_receipts(Store(output), "surface")
        return {receipt.name: receipt.facts["core"] for receipt in found}

    first = surveys.run(survey, until="deliver")
    before, results = cells(first.output), surveys.results(first.output)
    south = surveys.ORIGIN_M[0], surveys.ORIGIN_M[1] - 30.0
    added = survey.parent / "lines" / "3.laz"
    surveys.write_cloud(added, surveys.flightline(shots=60, psid=3, seed=3, origin_m=south))
    grown = surveys.run(survey, until="deliver")
    alone = surveys.run(surveys.copy_of(survey, survey.parent / "alone"), until="deliver")
    assert surveys.results(grown.output) == surveys.results(alone.output)
    assert cells(grown.output) == cells(alone.output), "no receipt of another shape is left"
    assert before.keys() != cells(grown.output).keys()
    added.unlink()
    shrunk = surveys.run(survey, until="deliver")
    assert surveys.results(shrunk.output) == results
    assert cells(shrunk.output) == before


def test_a_plan_counts_what_is_finished_and_writes_nothing(survey: Path) -> None:
    assert api.plan(survey).finished == 0
    surveys.run(survey, until="denoise")
    out = survey.parent / "out"
    before = sorted(out.rglob("*"))
    receipts = [path for path in before if path.parent.parent.name == "receipts"]
    assert api.plan(survey).finished == len(receipts) > 0
    assert sorted(out.rglob("*")) == before


def test_a_plan_warns_of_what_has_no_effect(survey: Path) -> None:
    wanted = ["filter.method=aes", "filter.wires.classify=true"]
    assert len(surveys.found(api.plan(survey, overrides=wanted).findings, "I06")) == 1
    assert not surveys.found(api.plan(survey, overrides=wanted[1:]).findings, "I06")


def test_a_plan_looks_at_the_place_of_the_output(
    survey: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    usage = shutil.disk_usage(survey.parent)._replace(free=2**16)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage)
    (note,) = api.plan(survey).findings
    assert (note.code, note.values["kind"], note.values["free"]) == ("E01", "disk", "64 KiB")


def test_a_pulse_rate_that_times_contradict_is_told(survey: Path) -> None:
    def warned(hz: int) -> list[str]:
        events: list[Any] = []
        rate = f"acquisition.prf_hz={hz}"
        surveys.run(survey, rate, until="index", listener=events.append)
        return [e.text for e in events if isinstance(e, Note) and "pulse rate" in e.text]

    assert warned(round(surveys.PRF_HZ * 1.03)) == []
    (text,) = warned(50_000)
    assert text.startswith("T01 ")
    assert "1000 Hz" in text
    assert "50000 Hz" in text
    assert "00001_" in text
    assert "00002_" in text
