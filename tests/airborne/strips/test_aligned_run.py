"""Flightlines that a run brings together, from files to deliveries, without a noise filter."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import laspy
import numpy as np
import pytest
import rasterio

from spl_batch import api
from spl_batch.airborne.strips import strip_comparison
from spl_batch.airborne.tasks import space_domain, surfaces
from spl_batch.engine.store.working_store import read_receipts
from spl_batch.engine.verbs.preparing import prepare
from tests import surveys
from tests.airborne.strips.test_strip_run import FINE, survey
from tests.airborne.strips.two_strips import Shift, hills
from tests.airborne.tasks.test_done_in_parts import cuts_of, only_task

OFF = Shift(0.3, -0.2, 0.2)


def aligned(folder: Path, how: str, **sections: object) -> Path:
    return survey(folder, OFF, survey={"align": how}, **sections)


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
def rigid(tmp_path_factory: pytest.TempPathFactory) -> api.RunResult:
    workflow = aligned(tmp_path_factory.mktemp("rigid"), "rigid", outputs={"tiles": "laz"})
    return surveys.run(workflow)


def test_rigid_brings_them_together_and_every_place_says_so(rigid: api.RunResult) -> None:
    report = json.loads((rigid.output / "report.json").read_text())
    (before,), (left,) = report["alignment"]["before"], report["strips"]
    assert before["up_m"] == pytest.approx(0.2, abs=0.02)
    assert abs(left["up_m"]) < 3 * left["up_sd_m"] + 0.002
    assert np.hypot(left["east_m"], left["north_m"]) < 3 * left["horizontal_sd_m"]
    first, second = report["alignment"]["lines"]
    assert (first["stays"], first["up_m"], first["east_m"]) == ("held", 0.0, 0.0)
    assert second["up_m"] == pytest.approx(-0.2, abs=0.02)
    assert second["east_m"] == pytest.approx(-0.3, abs=0.08)
    assert not surveys.found(rigid.report.findings, "S01")
    page = (rigid.output / "report.html").read_text()
    assert "Shifts that were applied" in page
    assert f"<td>{100 * second['up_m']:.1f}</td>" in page.replace("\N{MINUS SIGN}", "-")
    assert "1 of 2 flightlines was shifted" in (rigid.output / "metadata.xml").read_text()
    log = (rigid.output / "log.jsonl").read_text()
    assert "1 of 2 flightlines was shifted" in log


def test_delivered_points_are_shifted_by_the_numbers_told(rigid: api.RunResult) -> None:
    for line in json.loads((rigid.output / "report.json").read_text())["alignment"]["lines"]:
        name = f"{int(line['name'][:5])}.laz"
        given = laspy.read(rigid.output.parent / "lines" / name)
        made = laspy.read(rigid.output / "laz" / "lines" / name)
        assert len(made) == len(given)
        for axis, shift_m in zip(
            "XYZ", (line["east_m"], line["north_m"], line["up_m"]), strict=True
        ):
            assert set((made[axis] - given[axis]).tolist()) == {round(shift_m * 1000)}
        np.testing.assert_array_equal(made.gps_time, given.gps_time)
        if line["stays"]:  # nothing to be said of it
            assert not [v for v in made.header.vlrs if v.user_id == "spl-batch"]
            continue
        (record,) = [v for v in made.header.vlrs if v.user_id == "spl-batch"]
        told = json.loads(record.record_data_bytes().rstrip(b"\0"))
        assert told["align"] == "rigid"
        (own,) = told["flightlines"]
        assert (own["name"], own["up_m"]) == (line["name"], line["up_m"])
    tiles = [laspy.read(path) for path in sorted((rigid.output / "tiles").glob("*.laz"))]
    files = [laspy.read(path) for path in sorted((rigid.output / "laz").glob("*/*.laz"))]
    places = [
        np.concatenate([np.stack([some.x, some.y, some.z, some.gps_time], axis=1) for some in all_])
        for all_ in (tiles, files)
    ]
    ordered = [np.unique(np.round(one, 3), axis=0) for one in places]
    np.testing.assert_array_equal(*ordered)
    assert rigid.report.counts.points_out == rigid.report.counts.points_in


STEPS = ("index_file", "scatter", "build_tile", "denoise", "recorded_patches", "align", "ground")
"""What must be done before shifted points are compared and drawn."""


@pytest.mark.parametrize("kind", ["recorded_patches", "strip_patches", "ground", "surface"])
def test_where_memory_is_small_shifted_clouds_are_read_in_strips_and_no_byte_tells(
    rigid: api.RunResult, tmp_path: Path, kind: str
) -> None:
    prepared = prepare(rigid.output.parent / "workflow.yaml", ["outputs.tiles=laz"])
    shutil.copytree(rigid.output / "store", tmp_path / "store")
    context = replace(prepared.context, output=tmp_path)
    for step in STEPS:
        for receipt in read_receipts(context.store, step):
            prepared.ledger.of(step).put(receipt)
    task = only_task(prepared.ledger, kind)
    assert ("align", "all") in task.needs or kind == "recorded_patches"
    work = {"ground": space_domain.ground, "surface": surfaces.surface}.get(
        kind, strip_comparison.strip_patches
    )
    alike = replace(task, kind="strip_patches") if "patches" in kind else task
    how = cuts_of(alike, context, 4)
    assert max(map(len, how["cuts"].values())) > 1
    found = []
    cuts: dict[str, object]
    for cuts in ({}, how["cuts"]):
        produced = work({**task.args, "cuts": cuts}, context)
        found.append([path.read_bytes() for path in produced.outputs])
    whole, strips = found
    assert whole == strips
    (receipt,) = (r for r in read_receipts(context.store, kind) if r.name == task.name)
    assert len(whole) == len(receipt.outputs)


def test_tiles_and_workers_do_not_count_and_going_back_gives_what_was(
    rigid: api.RunResult, tmp_path: Path
) -> None:
    fine = {**FINE, "ground": {"cell_m": 50, "buffer_m": 20}, "outputs": {"tiles": "none"}}
    workflow = aligned(tmp_path, "none", **fine)
    plain = surveys.run(workflow)
    assert plain.report.alignment is None
    recorded, off_before = products(plain.output), off_truth(plain.output)
    moved = surveys.run(workflow, "survey.align=rigid")
    wanted = {name: v for name, v in products(rigid.output).items() if "tiles/" not in name}
    assert products(moved.output) == wanted
    assert wanted.keys() == recorded.keys()
    assert all(wanted[name] != recorded[name] for name in ("dtm.tif", "laz/lines/2.laz"))
    assert off_truth(moved.output) < 0.8 * off_before
    surveys.run(workflow)
    assert products(plain.output) == recorded


def test_vertical_moves_heights_alone_and_needs_no_times(tmp_path: Path) -> None:
    result = surveys.run(survey(tmp_path, OFF, timed=False, survey={"align": "vertical"}))
    (left,) = result.report.strips
    assert abs(left.up_m or 0.0) < 3 * (left.up_sd_m or 0.0) + 0.002
    assert left.east_m == pytest.approx(0.3, abs=0.08)
    given, made = (laspy.read(tmp_path / where / "2.laz") for where in ("lines", "out/laz/lines"))
    np.testing.assert_array_equal(made.X, given.X)
    assert set((made.Z - given.Z).tolist()) <= set(range(-210, -189))


def test_a_flightline_alone_stays_and_one_line_says_so(tmp_path: Path) -> None:
    workflow = aligned(tmp_path, "rigid")
    (tmp_path / "lines" / "2.laz").unlink()
    planned = surveys.command("plan", workflow).text
    assert "coordinates shifted in all that follows" in planned
    assert "one flightline" not in planned  # not known yet
    result = surveys.run(workflow, until="ground")
    log = (result.output / "log.jsonl").read_text()
    assert log.count("there is one flightline, nothing is shifted") == 1
