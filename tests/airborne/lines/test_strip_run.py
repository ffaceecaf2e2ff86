"""Flightlines that do not fit together, from files to report, without a noise filter."""

import json
from pathlib import Path

import numpy as np
import pytest

from tests import surveys
from tests.airborne.lines.two_strips import Returns, Shift, ground

LINEAR = {"filter": {"method": "none"}, "afterpulse": {"enabled": False}}
FINE = {"ground": {"cell_m": 25, "buffer_m": 20}, "tiling": {"tile_m": 30}}


def survey(folder: Path, shift: Shift, *, timed: bool = True, **sections: object) -> Path:
    """Two flightlines in linear mode, each in a file."""
    for line in (ground(1, Shift()), ground(2, shift)):
        write(folder / "lines" / f"{line.psid}.laz", line, timed=timed)
    return surveys.write_workflow(folder, **{**LINEAR, **sections})


def write(path: Path, line: Returns, *, timed: bool) -> None:
    count = len(line.xyz)
    time = np.linspace(0, 1, count) + 1000.0 * line.psid
    columns = dict(zip("xyz", line.xyz.T, strict=True))
    columns["gps_time"] = surveys.START_S + time if timed else np.zeros(count)
    columns["point_source_id"] = np.full(count, line.psid, np.uint16)
    surveys.write_cloud(path, columns)


@pytest.mark.pictures
def test_an_offset_is_in_findings_report_and_page(tmp_path: Path) -> None:
    result = surveys.run(survey(tmp_path, Shift(0.3, -0.2, 0.2)))
    (pair,) = surveys.report(result.output)["strips"]
    assert pair["up_m"] == pytest.approx(0.2, abs=0.01)
    assert pair["east_m"] == pytest.approx(0.3, abs=0.08)
    assert pair["north_m"] == pytest.approx(-0.2, abs=0.08)
    assert pair["noise_m"] == pytest.approx(0.05, abs=0.01)
    assert (pair["first"][:5], pair["second"][:5]) == ("00001", "00002")
    (said,) = surveys.found(result.report.findings, "S01")
    log = (result.output / "log.jsonl").read_text(encoding="utf-8")
    events = [json.loads(line) for line in log.splitlines()]
    told = [event["text"] for event in events if event.get("level") == "warning"]
    assert sorted(told) == sorted(one.text for one in result.report.findings)
    assert said.values["up_m"] == pytest.approx(0.2, abs=0.01)
    assert said.values["second"] == pair["second"]
    page = (result.output / "report.html").read_text()
    assert "Between flightlines" in page
    assert f"<td>{100 * pair['up_m']:.1f}</td>" in page
    assert "Height between flightlines" in page


def test_flightlines_without_times_are_told_by_their_ids(tmp_path: Path) -> None:
    workflow = survey(tmp_path, Shift(up=0.2), timed=False)
    result = surveys.run(workflow)
    (pair,) = result.report.strips
    assert (pair.first, pair.second) == ("00001", "00002")
    assert pair.up_m == pytest.approx(0.2, abs=0.01)
