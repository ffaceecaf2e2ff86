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
from spl_batch.errors import InputError, WorkflowError
from spl_batch.geiger.coincidence import files
from spl_batch.geiger.coincidence.settings import (
    ArraySettings,
    CoincidenceSettings,
)
from spl_batch.geiger.coincidence.surface import coincide
from spl_batch.geiger.coincidence.tables import Detections
from spl_batch.lattice.tiles import Bounds
from tests import surveys
from tests.geiger.coincidence.coincidence_scene import SMALL, flown

ROOT = Path(__file__).parents[3]


@pytest.fixture(scope="module")
def survey(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """L1 files of the small scene, a workflow, and a run of it."""
    folder = tmp_path_factory.mktemp("coincidence")
    scene = yaml.safe_load((ROOT / "workflows" / "coincidence_scene.yaml").read_text())
    small = {**scene, **SMALL.model_dump(mode="json")}
    (folder / "given.yaml").write_text(yaml.safe_dump(small))
    made = api.simulate(folder / "given.yaml", folder)
    assert made.workflow == folder / "workflow.yaml"
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


def failures(result: Any) -> dict[str, str]:
    return {Path(f.place).name: f.reason for f in result.report.failures}


def test_points_files_and_report(survey: Path) -> None:
    wide = Bounds(499_000_000, 4_199_000_000, 501_000_000, 4_201_000_000)
    points = coincide.coincide(*flown(), wide, CoincidenceSettings(), SMALL.array)
    table = delivered(survey / "out")
    assert np.array_equal(table[:, :3], points.xyz)
    assert np.array_equal(table[:, 4], points.kind)
    assert np.abs(table[:, 3] / 65535 - points.intensity).max() < 1e-5
    path = next((survey / "out" / "points").glob("*.laz"))
    assert int.from_bytes(path.read_bytes()[6:8], "little") == 1 | 8 | 16 | 32
    las = laspy.read(path)
    assert las.header.parse_crs().to_epsg() == 32616
    for name in ("return_number", "number_of_returns", "point_source_id"):
        assert (las[name] == 1).all()
    report = surveys.report(survey / "out")
    schema = json.loads((ROOT / "schemas" / "coincidence_report.schema.json").read_text())
    jsonschema.validate(report, schema)
    counts = report["counts"]
    assert counts["looks"] == counts["frames"] * SMALL.array.detectors
    assert counts["detections"] == len(flown()[1])
    assert counts["points"] == len(table) > 1000
    assert counts["surface"] + counts["ridge"] + counts["peak"] == counts["points"]
    assert (survey / "out" / "report.html").read_text().count("data:image/png;base64") == 3


def test_neither_cuts_nor_the_order_of_rows_change_the_points(survey: Path) -> None:
    # The complete workflow of the examples, with another array, and other tiles and volumes.
    text = (ROOT / "workflows" / "coincidence.yaml").read_text(encoding="utf-8")
    known = ArraySettings.model_validate({"preset": "intelliearth", "rows": 16})
    assert (known.rows, known.columns, known.ifov_rad) == (16, 128, 35e-6)
    other = survey / "other"
    (other / "l1").mkdir(parents=True)
    (other / "complete.yaml").write_text(text, encoding="utf-8")
    for path in (survey / "l1").iterdir():
        table = pq.read_table(path)
        rows = np.random.default_rng(2).permutation(len(table))
        pq.write_table(table.take(rows), other / "l1" / path.name, row_group_size=700)
    changes = ("array.rows=16", "array.columns=32", "tiling.tile_m=2.9")
    changes += ("coincidence.volume_voxels=50",)
    planned = api.plan(other / "complete.yaml", overrides=changes).cost.tasks
    result = api.run(other / "complete.yaml", workers=0, overrides=changes)
    assert result.exit_status == 0
    assert len(list((other / "out" / "points").glob("*.laz"))) > 2
    assert np.array_equal(delivered(other / "out"), delivered(survey / "out"))
    # Rims of files' extents have tiles with next to nothing in them.
    done = sum(stage.tasks for stage in result.report.performance.stages.values())
    assert done <= planned <= 1.5 * done


def own(survey: Path, folder: Path) -> tuple[Path, Path]:
    """L1 files and workflow in a folder of the test's own."""
    l1 = Path(shutil.copytree(survey / "l1", folder / "l1"))
    return l1, Path(shutil.copy(survey / "workflow.yaml", folder))


def test_bad_files_are_named_and_the_rest_goes_on(survey: Path, tmp_path: Path) -> None:
    l1, workflow = own(survey, tmp_path)
    (l1 / "zz_detections.parquet").write_bytes(b"PAR1 no more")
    unknown = pa.table({"frame": [5], "detector": [0], "x": [5e5], "y": [4.2e6], "z": [100.0]})
    pq.write_table(unknown, l1 / "yy_detections.parquet")
    empty = pa.table({k: pa.array([], pa.int64()) for k in Detections.types()})
    pq.write_table(empty, l1 / "xx_detections.parquet")
    result = api.run(workflow, workers=0)
    assert result.exit_status == 1
    reasons = failures(result)
    assert set(reasons) == {"zz_detections.parquet", "yy_detections.parquet"}
    assert "the first is 5" in reasons["yy_detections.parquet"]
    (empty_file,) = surveys.found(result.report.findings, "K01", "empty")
    assert empty_file.subjects == ("l1/xx_detections.parquet",)
    assert np.array_equal(delivered(tmp_path / "out"), delivered(survey / "out"))


def test_frames_whose_detections_cannot_be_read_are_no_looks(survey: Path, tmp_path: Path) -> None:
    l1, workflow = own(survey, tmp_path)
    bad, frames = l1 / "pass_1_detections.parquet", l1 / "pass_1_frames.parquet"
    sound, seen = bad.read_bytes(), frames.read_bytes()
    bad.write_bytes(b"PAR1 no more")
    result = api.run(workflow, workers=0)
    assert result.exit_status == 1
    assert surveys.found(result.report.findings, "K01", "unread")
    bad.unlink()
    frames.unlink()
    assert api.run(workflow, workers=0, overrides=("output=without",)).exit_status == 0
    assert np.array_equal(delivered(tmp_path / "out"), delivered(tmp_path / "without"))
    # Detections of a frames file that cannot be used name it, and are taken in once it is mended.
    bad.write_bytes(sound)
    table = pq.read_table(pa.BufferReader(seen))
    number = table["frame"].to_numpy().copy()
    number[1] = number[0]
    pq.write_table(table.set_column(0, "frame", [number]), frames)
    reasons = failures(api.run(workflow, workers=0))
    assert set(reasons) == {frames.name, bad.name}
    assert "l1/pass_1_frames.parquet" in reasons[bad.name]
    frames.write_bytes(seen)
    assert api.run(workflow, workers=0).exit_status == 0
    assert np.array_equal(delivered(tmp_path / "out"), delivered(survey / "out"))
    shutil.copy(frames, l1 / "a_frames.parquet")
    with pytest.raises(WorkflowError, match=r"a_frames\.parquet and .*pass_1_frames\.parquet"):
        api.run(workflow, workers=0)


def test_without_the_bit_files_alone_are_written_again(survey: Path) -> None:
    again = api.run(survey / "workflow.yaml", workers=0, overrides=("outputs.aggregate_bit=false",))
    assert again.report.performance.stages["coincidence"].tasks == 0
    path = next((survey / "out" / "points").glob("*.laz"))
    assert path.read_bytes()[6] == 1 | 8 | 16


def test_wrong_attitudes_are_warned_of(survey: Path) -> None:
    changes = ("array.columns=64", "output=out_wrong", "coincidence.bridge_sign.threshold=0.5")
    result = api.run(survey / "workflow.yaml", workers=0, overrides=changes)
    (off,) = surveys.found(result.report.findings, "K02")
    assert any("pass_1_detections.parquet" in name for name in off.subjects)
    sound = surveys.report(survey / "out")
    assert sound["findings"] == []


GOOD = {
    "frame": [7, 7, 8],
    "detector": [1, 3, 2],
    "x": [5e5, 5e5, 5e5],
    "y": [4.2e6, 4.2e6, 4.2e6],
    "z": [100.0, 100.1, 100.2],
}


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        ({"x": None, "y": None}, "no column 'x'; .*no column 'y'"),
        ({"frame": [7.0, 7.5, 8.0]}, "'frame' is double"),
        ({"z": ["a", "b", "c"]}, "'z' is (large_)?string"),
        ({"z": [1.0, np.nan, np.inf], "x": [1.0, None, 2.0]}, "1 row has no 'x'; 2 values of 'z'"),
        ({"detector": [1, 512, 2]}, "1 detection of detectors up to 512, .* 16 x 32"),
        ({"detector": [1, -1, 2]}, "1 value of 'detector'"),
        ({"detector": [3, 3, 2]}, "1 time .* detector 3 of frame 7"),
    ],
)
def test_faults_of_a_detections_file(tmp_path: Path, change: dict[str, Any], fault: str) -> None:
    path = tmp_path / "d.parquet"
    pq.write_table(pa.table({k: v for k, v in (GOOD | change).items() if v is not None}), path)
    with pytest.raises(InputError, match=fault) as caught:
        list(files.read_detections(path, ArraySettings(rows=16, columns=32)))
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_stretches_are_in_order_and_their_faults_add_up(tmp_path: Path) -> None:
    _, detections = flown()
    path = tmp_path / "d.parquet"
    order = np.random.default_rng(2).permutation(len(detections))
    files.write(path, detections.take(order))
    parts = list(files.read_detections(path, SMALL.array, 3000))
    assert len(parts) == -(-len(detections) // 3000)
    assert all((np.diff(part.frame) >= 0).all() for part in parts)
    found = Detections.joined(parts).distinct()
    for name in Detections.__slots__:
        assert np.array_equal(getattr(found, name), getattr(detections, name))
    lower = Detections(found.frame, found.detector, found.xyz - [0, 0, 5])
    assert np.array_equal(Detections.joined([found, lower]).distinct().xyz, lower.xyz)
    table = pq.read_table(path)
    x = table["x"].to_numpy().copy()
    x[[5, -5]] = np.inf
    pq.write_table(table.set_column(2, "x", [x]), path, row_group_size=700)
    with pytest.raises(InputError, match="2 values of 'x'"):
        list(files.read_detections(path, SMALL.array, 1000))


def test_a_damaged_footer_ends_no_process(tmp_path: Path) -> None:
    path, column = tmp_path / "d.parquet", np.arange(40)
    names = Detections.types()
    table = {name: column if name in {"frame", "detector"} else column / 2 for name in names}
    pq.write_table(pa.table(table), path, row_group_size=20)
    assert files.extents(path) == ((0.0, 0.0, 9.5, 9.5, 20), (10.0, 10.0, 19.5, 19.5, 20))
    whole, refused = path.read_bytes(), 0
    start = len(whole) - 8 - int.from_bytes(whole[-8:-4], "little")
    for at in range(start, start + 400):
        path.write_bytes(whole[:at] + bytes([4 if whole[at] == 0 else 0]) + whole[at + 1 :])
        try:
            files.inspect(path, names)
            refused += files.extents(path) is None
        except InputError:
            refused += 1
    assert refused > 50


@pytest.mark.parametrize(
    ("change", "key"),
    [
        ("array.gate_stop_m=2000", "gate_stop_m"),
        ("array.pixels=4", "array.pixels: no such key"),
        ("coincidence.method=mapcp", "coincidence.method"),
        ("coincidence.bridge_sign.window_voxels=4", "window_voxels"),
        ("coincidence.voxel_m=0.0455", "voxel_m: 0.0455"),
        ("survey.crs=EPSG:4326", "survey.crs: .*degrees"),
        ("survey.frames=none_*.parquet", "survey.frames: .* matches no file"),
        ("output=l1/..", "in the output folder"),
        ("survey.detections=l1/*_frames.parquet", "no input is usable: .*'detector'"),
    ],
)
def test_faults_of_a_workflow(survey: Path, change: str, key: str) -> None:
    with pytest.raises(WorkflowError, match=key):
        api.plan(survey / "workflow.yaml", overrides=(change,))
