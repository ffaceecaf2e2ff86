"""Users are warned of what is wrong, once, in words that say what to do."""

import shutil
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pytest
import shapely
import yaml

from spl_batch import api
from spl_batch.airborne.plan.inputs.channel_dimension import are_beamlets, unnamed_channels
from spl_batch.airborne.sensors.sensor import load_preset
from spl_batch.engine.watch.events import Note
from spl_batch.formats.las.reader import Numbers
from tests import surveys

SENSOR = load_preset("spl100")


def notes_of(workflow: Path) -> list[str]:
    """Warnings that a run gives, in order."""
    told: list[Any] = []
    api.run(workflow, workers=0, until="shots", listener=told.append)
    return [e.text for e in told if isinstance(e, Note) and e.level == "warning"]


def survey_without_channels(folder: Path) -> Path:
    """Two flightlines whose 25 beamlets are numbered in user_data, and no word of that."""
    for k in (1, 2):
        line = surveys.flightline(shots=100 + 25 * k, psid=k, start_s=surveys.START_S + 3 * k)
        line["user_data"] = (line["channel"] - 1).astype(np.uint8)
        surveys.write_cloud(folder / "lines" / f"line_{k}.laz", line, channel=False)
    unnamed = {"channel_dimension": None, "sensor": {"beamlets": 25, "array_columns": 5}}
    # So few shots that an interval holds few of them, if each counts as one beamlet.
    return surveys.write_workflow(folder, survey=unnamed, noise={"interval_shots": 12})


def test_beamlet_numbers_that_are_not_named_are_proposed_once(tmp_path: Path) -> None:
    survey = survey_without_channels(tmp_path)
    told = notes_of(survey)
    (proposed,) = (text for text in told if "I04" in text)
    assert "user_data holds 0 to 24 in lines/line_1.laz, lines/line_2.laz" in proposed
    assert not [text for text in told if "N01" in text], "it explains what follows from it"


def test_intervals_with_few_returns_are_told_where_no_beamlets_explain_it(tmp_path: Path) -> None:
    survey = survey_without_channels(tmp_path)
    for path in (tmp_path / "lines").iterdir():
        with laspy.open(path) as reader:
            las = reader.read()
        las["user_data"] = np.zeros(len(las), np.uint8)
        las.write(path)
    told = [text for text in notes_of(survey) if "N01" in text and "interval_shots" in text]
    assert len(told) == 1, "two flightlines, one warning"


def test_extra_bytes_may_hold_beamlet_numbers(small: Path) -> None:
    content = yaml.safe_load(small.read_text())
    del content["survey"]["channel_dimension"]
    content["survey"]["sensor"] = {"beamlets": 25, "array_columns": 5}
    small.write_text(yaml.safe_dump(content))
    assert any("`channel_dimension: channel`" in text for text in notes_of(small))


@pytest.mark.parametrize(
    ("numbers", "yes"),
    [
        (Numbers(1, 100, 100, 8192, 120), True),
        (Numbers(0, 99, 100, 8192, 120), True),
        (Numbers(1, 100, 96, 8192, 120), True),  # four dead channels
        (Numbers(0, 100, 101, 8192, 120), False),  # a percentage
        (Numbers(1, 100, 90, 8192, 120), False),
        (Numbers(1, 100, 100, 1999, 30), False),  # too few points to say
        (Numbers(0, 99, 100, 8192, 2000), False),  # intensities crowd
        (Numbers(0, 255, 256, 8192, 50), False),
    ],
)
def test_which_numbers_are_those_of_beamlets(numbers: Numbers, yes: bool) -> None:  # noqa: FBT001
    assert are_beamlets(numbers, SENSOR) is yes


def test_files_that_count_from_0_and_from_1_are_told_together() -> None:
    held = {
        "a.laz": {"user_data": Numbers(1, 100, 100, 8192, 120)},
        "b.laz": {"user_data": Numbers(0, 99, 100, 8192, 120)},
        "c.laz": {"user_data": Numbers(0, 0, 1, 8192, 8192)},
    }
    (one,) = unnamed_channels(held, SENSOR)
    assert one.values["ranges"] == "1 to 100 in a.laz and 0 to 99 in b.laz"
    assert unnamed_channels({"c.laz": held["c.laz"]}, SENSOR) == ()


@pytest.mark.parametrize(
    ("outputs", "per_m2"),
    [
        # seven in the store, seven mosaics; six again, six as tiles
        ({}, 14 / 0.2**2),
        ({"crs": "EPSG:32614"}, 20 / 0.2**2),
        ({"units": "us-ft", "cell": 3}, 14 / 0.2**2 + 6 / (3 * 1200 / 3937) ** 2),
        ({"client_tiles": {"polygons": "tiles.gpkg"}}, 20 / 0.2**2),
        ({"client_tiles": {"polygons": "tiles.gpkg"}, "cell": 0.5}, 14 / 0.2**2 + 12 / 0.5**2),
        (
            {"client_tiles": {"polygons": "tiles.gpkg"}, "cell": 0.5, "crs": "EPSG:32614"},
            20 / 0.2**2 + 6 / 0.5**2,
        ),
    ],
)
def test_a_disk_with_room_for_points_and_none_for_rasters_is_named(
    small: Path, monkeypatch: pytest.MonkeyPatch, outputs: dict[str, Any], per_m2: float
) -> None:
    x, y = surveys.ORIGIN_M
    tile = shapely.box(x, y, x + 9, y + 9)
    surveys.write_shapes(small.parent / "tiles.gpkg", [tile], name=["A"])
    content = yaml.safe_load(small.read_text())
    plans = []
    for cell_m in (50.0, 0.2):
        content |= {"products": {"cell_m": cell_m}, "outputs": {**outputs}}
        if cell_m == 50.0 and "cell" in outputs:
            content["outputs"]["cell"] = 50.0
        small.write_text(yaml.safe_dump(content))
        plans.append(api.plan(small))
        usage = shutil.disk_usage(small.parent)._replace(free=plans[0].cost.disk_bytes + 2**20)
        monkeypatch.setattr(shutil, "disk_usage", lambda _, usage=usage: usage)
    assert [len(surveys.found(plan.findings, "E01")) for plan in plans] == [0, 1]
    coarse, fine = (plan.cost for plan in plans)
    area_m2 = fine.tiles * 100.0**2
    rasters = fine.disk_bytes - coarse.disk_bytes
    assert rasters == pytest.approx(4 * per_m2 * area_m2, rel=1e-2)
