"""Coincidence processing as users have it: files in, a workflow, points and a report out."""

import json
import shutil
from pathlib import Path
from typing import Any

import jsonschema
import laspy
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import yaml

from spl_batch import api
from spl_batch.engine.settings.workflow_file import parse_any
from spl_batch.errors import InputError, WorkflowError
from spl_batch.geiger.coincidence.formats import l1_files
from spl_batch.geiger.coincidence.settings import (
    ArraySettings,
    CoincidenceSettings,
    CoincidenceWorkflow,
)
from spl_batch.geiger.coincidence.simulate.scene import SceneSettings
from spl_batch.geiger.coincidence.surface import coincide
from spl_batch.lattice.tiles import Bounds
from tests import surveys
from tests.geiger.coincidence.coincidence_scene import SMALL, flown
from tests.workflow_files import differing, unshown

ROOT = Path(__file__).parents[3]


@pytest.fixture(scope="module")
def survey(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """L1 files of the small scene, a workflow, and a run of it."""
    folder = tmp_path_factory.mktemp("coincidence")
    scene = yaml.safe_load((ROOT / "workflows" / "coincidence_scene.yaml").read_text())
    small = {**scene, **SMALL.model_dump(mode="json")}
    (folder / "given.yaml").write_text(yaml.safe_dump(small))
    made = api.simulate(folder / "given.yaml", folder)
    assert made.frames == len(flown()[0])
    assert made.detections == len(flown()[1])
    assert api.run(folder / "workflow.yaml", workers=0).exit_status == 0
    return folder


def delivered(output: Path) -> np.ndarray:
    """Points of all tiles: x, y, z, intensity, kind of maximum; in order."""
    rows = []
    for path in sorted((output / "points").glob("*.laz")):
        las = laspy.read(path)
        xyz = [np.rint(np.asarray(las[k]) * 1000) for k in "xyz"]
        rows.append(np.stack([*xyz, las.intensity, las["maximum"]], axis=-1))
    table = np.concatenate(rows)
    return table[np.lexsort(table.T[::-1])]


def test_the_points_are_those_of_the_stage(survey: Path) -> None:
    wide = Bounds(499_000_000, 4_199_000_000, 501_000_000, 4_201_000_000)
    points = coincide.coincide(*flown(), wide, CoincidenceSettings(), SMALL.array)
    table = delivered(survey / "out")
    assert len(table) == len(points) > 1000
    assert np.array_equal(table[:, :3], points.xyz)
    assert np.array_equal(table[:, 4], points.kind)
    assert np.abs(table[:, 3] / 65535 - points.intensity).max() < 1e-5


def test_the_files_say_that_they_are_of_an_aggregate_model(survey: Path) -> None:
    path = next((survey / "out" / "points").glob("*.laz"))
    assert int.from_bytes(path.read_bytes()[6:8], "little") == 1 | 8 | 16 | 32
    las = laspy.read(path)
    assert las.header.parse_crs().to_epsg() == 32616
    for name, value in (("return_number", 1), ("number_of_returns", 1), ("point_source_id", 1)):
        assert (las[name] == value).all()
    assert (las.gps_time == 0).all()
    assert (las.scan_angle == 0).all()


def test_the_report_says_what_was_made(survey: Path) -> None:
    out = survey / "out"
    report = json.loads((out / "report.json").read_text())
    schema = json.loads((ROOT / "schemas" / "coincidence_report.schema.json").read_text())
    jsonschema.validate(report, schema)
    counts = report["counts"]
    assert counts["looks"] == counts["frames"] * SMALL.array.detectors
    assert counts["detections"] == len(flown()[1])
    assert counts["points"] == len(delivered(out))
    assert counts["surface"] + counts["ridge"] + counts["peak"] == counts["points"]
    page = (out / "report.html").read_text()
    assert page.count("data:image/png;base64") == 3


def test_no_cut_changes_the_points(survey: Path) -> None:
    # The complete workflow of the examples, with another array, and other tiles and volumes.
    complete = shutil.copy(ROOT / "workflows" / "coincidence.yaml", survey / "complete.yaml")
    changes = ("array.rows=16", "array.columns=32", "tiling.tile_m=2.9", "output=out_cut")
    changes += ("coincidence.volume_voxels=50",)
    assert api.run(complete, workers=0, overrides=changes).exit_status == 0
    assert len(list((survey / "out_cut" / "points").glob("*.laz"))) > 2
    assert np.array_equal(delivered(survey / "out_cut"), delivered(survey / "out"))


def test_a_second_run_has_nothing_to_do(survey: Path) -> None:
    (survey / "out" / "report.html").unlink()  # a report that is there is left as it is
    result = api.run(survey / "workflow.yaml", workers=0)
    assert sum(s.tasks for s in result.report.performance.stages.values()) == 0
    # Without the bit the points stay as they are; only their files are written again.
    again = api.run(survey / "workflow.yaml", workers=0, overrides=("outputs.aggregate_bit=false",))
    stages_done = again.report.performance.stages
    assert stages_done["coincidence"].tasks == 0
    assert stages_done["deliver"].tasks > 0
    path = next((survey / "out" / "points").glob("*.laz"))
    assert path.read_bytes()[6] == 1 | 8 | 16


def test_the_other_method_runs_too(survey: Path) -> None:
    overrides = ("coincidence.method=posterior", "output=out_posterior")
    result = api.run(survey / "workflow.yaml", workers=0, overrides=overrides)
    assert result.report.counts.points > 1000
    assert result.report.counts.surface == 0


def test_the_plan_tells_what_is_there(survey: Path) -> None:
    plan = api.plan(survey / "workflow.yaml")
    assert plan.points == len(flown()[1])
    assert dict(plan.rows)["voxels"] == "45 mm, tiles of 20 m"


def test_a_bad_file_is_named_and_the_rest_goes_on(survey: Path) -> None:
    l1 = survey / "l1"
    (l1 / "zz_detections.parquet").write_bytes(b"PAR1 no more")
    unknown = pa.table({"frame": [5], "detector": [0], "x": [5e5], "y": [4.2e6], "z": [100.0]})
    pq.write_table(unknown, l1 / "yy_detections.parquet")
    try:
        result = api.run(survey / "workflow.yaml", workers=0, overrides=("output=out_bad",))
    finally:
        for name in ("zz", "yy"):
            (l1 / f"{name}_detections.parquet").unlink()
    assert result.exit_status == 1
    reasons = {Path(f.place).name: f.reason for f in result.report.failures}
    assert set(reasons) == {"zz_detections.parquet", "yy_detections.parquet"}
    assert "no whole Parquet file" in reasons["zz_detections.parquet"]
    assert (
        "1 detection is of frames that no frames file has, the first is 5"
        in (reasons["yy_detections.parquet"])
    )
    assert np.array_equal(delivered(survey / "out_bad"), delivered(survey / "out"))


def test_frames_whose_detections_cannot_be_read_are_no_looks(survey: Path, tmp_path: Path) -> None:
    shutil.copytree(survey / "l1", tmp_path / "l1")
    shutil.copy(survey / "workflow.yaml", tmp_path)
    first = min((tmp_path / "l1").glob("*_detections.parquet"))
    first.write_bytes(b"PAR1 no more")
    result = api.run(tmp_path / "workflow.yaml", workers=0)
    assert result.exit_status == 1
    assert surveys.found(result.report.findings, "K01", "unread")
    for path in (first, first.with_name(first.name.replace("detections", "frames"))):
        path.unlink()
    again = api.run(tmp_path / "workflow.yaml", workers=0, overrides=("output=without",))
    assert again.exit_status == 0
    assert np.array_equal(delivered(tmp_path / "out"), delivered(tmp_path / "without"))


def test_wrong_attitudes_and_empty_files_are_warned_of(survey: Path) -> None:
    empty = pa.table({k: pa.array([], pa.int64()) for k in l1_files.DETECTION_COLUMNS})
    pq.write_table(empty, survey / "l1" / "none_detections.parquet")
    changes = ("array.columns=64", "output=out_wrong", "coincidence.bridge_sign.threshold=0.5")
    try:
        result = api.run(survey / "workflow.yaml", workers=0, overrides=changes)
    finally:
        (survey / "l1" / "none_detections.parquet").unlink()
    (empty_file,) = surveys.found(result.report.findings, "K01", "empty")
    assert empty_file.subjects == ("l1/none_detections.parquet",)
    (off,) = surveys.found(result.report.findings, "K02")
    assert any("pass_1_detections.parquet" in name for name in off.subjects)
    sound = json.loads((survey / "out" / "report.json").read_text())
    assert sound["findings"] == []


GOOD = {
    "frame": [7, 7, 8],
    "detector": [1, 3, 2],
    "x": [5e5, 5e5, 5e5],
    "y": [4.2e6, 4.2e6, 4.2e6],
    "z": [100.0, 100.1, 100.2],
}


def changed(**columns: Any) -> dict[str, Any]:
    return {**GOOD, **columns}


@pytest.mark.parametrize(
    ("columns", "said"),
    [
        ({k: v for k, v in GOOD.items() if k not in "xy"}, "no column 'x'; it has .*no column 'y'"),
        (changed(frame=[7.0, 7.5, 8.0]), "column 'frame' is double, not integer"),
        (changed(z=["a", "b", "c"]), "column 'z' is (large_)?string, not a number"),
        (changed(z=[1.0, np.nan, np.inf]), "2 values of 'z' are no finite metres"),
        (changed(z=[1.0, None, 2.0]), "1 row has no 'z'"),
        (
            changed(detector=[1, 512, 2]),
            "1 detection of detectors up to 512, .* has 16 x 32",
        ),
        (changed(detector=[1, -1, 2]), "'detector' runs from -1 to 2; count from 0"),
        (changed(detector=[3, 3, 2]), "1 time a detector fires again .* detector 3 of frame 7"),
    ],
)
def test_faults_of_a_detections_file(tmp_path: Path, columns: dict[str, Any], said: str) -> None:
    path = tmp_path / "d.parquet"
    pq.write_table(pa.table(columns), path)
    with pytest.raises(InputError, match=said) as caught:
        list(l1_files.detections_in_order(path, ArraySettings(rows=16, columns=32)))
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_detections_come_in_order(tmp_path: Path) -> None:
    path = tmp_path / "d.parquet"
    pq.write_table(pa.table({k: v[::-1] for k, v in GOOD.items()}), path)
    (found,) = l1_files.detections_in_order(path, ArraySettings())
    assert found.frame.tolist() == [7, 7, 8]
    assert found.detector.tolist() == [1, 3, 2]
    assert found.xyz[:, 2].tolist() == [100_000, 100_100, 100_200]


def test_a_frame_twice_is_a_fault(tmp_path: Path) -> None:
    path = tmp_path / "f.parquet"
    columns = {name: [0.0, 0.0] for name in l1_files.FRAME_COLUMNS[1:]}
    pq.write_table(pa.table({"frame": [4, 4], **columns}), path)
    with pytest.raises(InputError, match="1 frame is there twice, the first is 4"):
        list(l1_files.frames_in_order(path))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ("array.gate_stop_m=2000", "gate_stop_m 2000 is not beyond gate_start_m 2500"),
        ("array.pixels=4", "array.pixels: no such key; the nearest known key is"),
        ("coincidence.method=mapcp", "coincidence.method: input should be 'bridge_sign'"),
        ("coincidence.bridge_sign.window_voxels=4", "window_voxels: input should be 3, 5, 7 or 9"),
        ("coincidence.voxel_m=0.0455", "voxel_m: 0.0455 is not a whole number of millimetres"),
        ("tiling.tile_m=1.23456", "tile_m: 1.23456 is not a whole number of millimetres"),
        ("survey.crs=EPSG:0", "survey.crs: 'EPSG:0' is not a known CRS"),
        ("survey.crs=EPSG:4326", "survey.crs: .*degrees"),
        ("survey.frames=none_*.parquet", "survey.frames: .* matches no file"),
        ("output=l1/..", "in the output folder"),
        ("survey.detections=l1/*_frames.parquet", "no input is usable: .*no column 'detector'"),
    ],
)
def test_faults_of_a_workflow(survey: Path, change: str, said: str) -> None:
    with pytest.raises(WorkflowError, match=said):
        api.plan(survey / "workflow.yaml", overrides=(change,))


def test_frames_numbered_twice_stop_the_run(survey: Path, tmp_path: Path) -> None:
    for name in ("a", "b"):
        source = survey / "l1" / "pass_1_frames.parquet"
        (tmp_path / f"{name}_frames.parquet").write_bytes(source.read_bytes())
    overrides = (f"survey.frames={tmp_path}/*.parquet", "output=out_twice")
    with pytest.raises(WorkflowError, match=r"a_frames.parquet and .*b_frames.parquet: frames run"):
        api.run(survey / "workflow.yaml", workers=0, overrides=overrides)


def test_the_workflow_file_shows_every_key_and_runs(survey: Path) -> None:
    text = (ROOT / "workflows" / "coincidence.yaml").read_text(encoding="utf-8")
    assert unshown(text, CoincidenceWorkflow) == []
    inputs = {"frames": "f", "detections": "d"}
    bare = parse_any({"kind": "coincidence", "output": "out", "survey": inputs}, "bare")
    different = differing(yaml.safe_load(text), bare.model_dump(mode="json"))
    assert {path.partition(".")[0] for path in different} == {"survey"}
    (survey / "complete.yaml").write_text(text, encoding="utf-8")
    smaller = ("output=out_complete", "array.rows=16", "array.columns=32")
    assert api.run(survey / "complete.yaml", workers=0, overrides=smaller).exit_status == 0
    np.testing.assert_array_equal(delivered(survey / "out_complete"), delivered(survey / "out"))


def test_the_scene_file_shows_every_key_with_its_default() -> None:
    text = (ROOT / "workflows" / "coincidence_scene.yaml").read_text(encoding="utf-8")
    assert unshown(text, SceneSettings) == []
    assert differing(yaml.safe_load(text), SceneSettings().model_dump(mode="json")) == []
