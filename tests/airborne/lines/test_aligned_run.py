"""Flightlines that a run brings together, from files to deliveries, without a noise filter."""

import json
from pathlib import Path

import laspy
import numpy as np
import pytest
import rasterio

from spl_batch import api
from tests import surveys
from tests.airborne.lines.test_strip_run import FINE, survey
from tests.airborne.lines.two_strips import Shift, hills

OFF = Shift(up=0.2)


def aligned(folder: Path, **sections: object) -> Path:
    return survey(folder, OFF, survey={"align": "vertical"}, **sections)


def products(output: Path) -> dict[str, bytes]:
    """Everything that is delivered but what tells time and code."""
    kept = (*output.glob("*.tif"), *output.glob("laz/*/*"), *output.glob("tiles/*"))
    return {path.relative_to(output).as_posix(): path.read_bytes() for path in kept}


def off_truth(output: Path) -> float:
    """Standard deviation of the terrain model from the hills [m]."""
    with rasterio.open(output / "dtm.tif") as source:
        dtm = source.read(1, masked=True)
        rows, columns = np.nonzero(~np.ma.getmaskarray(dtm))
        x, y = rasterio.transform.xy(source.transform, rows, columns)
    away = dtm[rows, columns].data - hills(np.array(x) - 10_000, np.array(y) - 20_000)
    return float(np.std(away))


@pytest.fixture(scope="module")
def vertical(tmp_path_factory: pytest.TempPathFactory) -> api.RunResult:
    workflow = aligned(tmp_path_factory.mktemp("vertical"), outputs={"tiles": "laz"})
    return surveys.run(workflow)


def test_shifts_bring_them_together_and_the_report_has_them(vertical: api.RunResult) -> None:
    report = surveys.report(vertical.output)
    (left,), (first, second) = report["strips"], report["alignment"]
    assert abs(left["up_m"]) < 0.002
    assert (first["stays"], first["up_m"]) == ("kept", 0.0)
    assert second["up_m"] == pytest.approx(-0.2, abs=0.02)
    assert not surveys.found(vertical.report.findings, "S01")
    page = (vertical.output / "report.html").read_text()
    assert f"<td>{100 * second['up_m']:.1f}</td>" in page.replace("\N{MINUS SIGN}", "-")
    assert "1 of 2 flightlines was shifted" in (vertical.output / "log.jsonl").read_text()


def test_delivered_heights_are_shifted_by_the_numbers_reported(vertical: api.RunResult) -> None:
    for line in surveys.report(vertical.output)["alignment"]:
        name = f"{int(line['name'][:5])}.laz"
        given = laspy.read(vertical.output.parent / "lines" / name)
        made = laspy.read(vertical.output / "laz" / "lines" / name)
        for axis, shift_m in zip("XYZ", (0.0, 0.0, line["up_m"]), strict=True):
            assert set((made[axis] - given[axis]).tolist()) == {round(shift_m * 1000)}
        np.testing.assert_array_equal(made.gps_time, given.gps_time)
        records = [v for v in made.header.vlrs if v.user_id == "spl-batch"]
        if line["stays"]:
            assert not records
            continue
        (own,) = json.loads(records[0].record_data_bytes().rstrip(b"\0"))["flightlines"]
        assert (own["name"], own["up_m"]) == (line["name"], line["up_m"])
    tiles = [laspy.read(path) for path in sorted((vertical.output / "tiles").glob("*.laz"))]
    files = [laspy.read(path) for path in sorted((vertical.output / "laz").glob("*/*.laz"))]
    places = [
        np.concatenate([np.stack([some.x, some.y, some.z, some.gps_time], axis=1) for some in all_])
        for all_ in (tiles, files)
    ]
    np.testing.assert_array_equal(*(np.unique(np.round(one, 3), axis=0) for one in places))


def test_tiles_and_workers_do_not_count_and_going_back_gives_what_was(
    vertical: api.RunResult, tmp_path: Path
) -> None:
    fine = {**FINE, "ground": {"cell_m": 50, "buffer_m": 20}, "outputs": {"tiles": "none"}}
    workflow = survey(tmp_path, OFF, **fine)
    plain = surveys.run(workflow)
    assert not plain.report.alignment
    recorded, off_before = products(plain.output), off_truth(plain.output)
    shifted = surveys.run(workflow, "survey.align=vertical")
    wanted = {name: v for name, v in products(vertical.output).items() if "tiles/" not in name}
    assert products(shifted.output) == wanted
    assert all(wanted[name] != recorded[name] for name in ("dtm.tif", "laz/lines/2.laz"))
    assert off_truth(shifted.output) < 0.8 * off_before
    surveys.run(workflow)
    assert products(plain.output) == recorded
