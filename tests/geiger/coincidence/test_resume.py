"""Coincidence processing of files of any size, and with files that fail."""

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import yaml

from spl_batch import api
from spl_batch.engine.store.working_store import Store, read_receipts
from spl_batch.errors import InputError
from spl_batch.geiger.coincidence.formats import l1_files
from spl_batch.geiger.coincidence.simulate import simulate
from spl_batch.geiger.coincidence.tables import Detections
from tests.geiger.coincidence.coincidence_scene import SMALL, flown


@pytest.fixture(scope="module")
def l1(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Frames and detections of the small scene, and a workflow with tiles of 2 m."""
    folder = tmp_path_factory.mktemp("coincidence_l1")
    simulate(SMALL, folder)
    content = yaml.safe_load((folder / "workflow.yaml").read_text())
    content["tiling"] = {"tile_m": 2}
    (folder / "workflow.yaml").write_text(yaml.safe_dump(content))
    return folder


@pytest.fixture(scope="module")
def whole(l1: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """Points of a run that nothing disturbs."""
    workflow = copy_of(l1, tmp_path_factory.mktemp("coincidence_whole"))
    assert api.run(workflow, workers=0).exit_status == 0
    return points(workflow)


def copy_of(l1: Path, folder: Path) -> Path:
    shutil.copytree(l1 / "l1", folder / "l1")
    return Path(shutil.copy(l1 / "workflow.yaml", folder))


def points(workflow: Path) -> dict[str, bytes]:
    folder = workflow.parent / "out" / "points"
    return {path.name: path.read_bytes() for path in sorted(folder.glob("*.laz"))}


def test_a_frames_file_that_fails_is_named_to_its_detections(
    l1: Path, whole: dict[str, bytes], tmp_path: Path
) -> None:
    workflow = copy_of(l1, tmp_path)
    frames = tmp_path / "l1" / "pass_1_frames.parquet"
    sound, table = frames.read_bytes(), pq.read_table(frames)
    number = table["frame"].to_numpy().copy()
    number[1] = number[0]
    pq.write_table(table.set_column(0, "frame", [number]), frames)
    result = api.run(workflow, workers=0)
    assert result.exit_status == 1
    reasons = {Path(f.place).name: f.reason for f in result.report.failures}
    assert set(reasons) == {"pass_1_frames.parquet", "pass_1_detections.parquet"}
    assert "1 frame is there twice" in reasons["pass_1_frames.parquet"]
    said = reasons["pass_1_detections.parquet"]
    assert "l1/pass_1_frames.parquet could not be read: mend" in said
    assert "name the file" not in said
    # A file that is none at all is left out before the work begins, and named just as well.
    frames.write_bytes(b"PAR1 no more")
    again = api.run(workflow, workers=0)
    assert any("l1/pass_1_frames.parquet could not" in f.reason for f in again.report.failures)
    frames.write_bytes(sound)
    assert api.run(workflow, workers=0).exit_status == 0
    assert points(workflow) == whole


def test_a_file_that_goes_after_it_was_looked_at_fails_alone(
    l1: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    workflow = copy_of(l1, tmp_path)
    looked = l1_files.extents

    def and_gone(path: Path) -> Any:
        found = looked(path)
        if path.name == "pass_2_detections.parquet":
            path.unlink()
        return found

    monkeypatch.setattr(l1_files, "extents", and_gone)
    result = api.run(workflow, workers=0)
    assert result.exit_status == 1
    (failure,) = result.report.failures
    assert Path(failure.place).name == "pass_2_detections.parquet"
    assert "is gone since the run began" in failure.reason
    assert points(workflow)


def test_the_plan_counts_tasks(l1: Path, whole: dict[str, bytes], tmp_path: Path) -> None:
    workflow = copy_of(l1, tmp_path)
    planned = api.plan(workflow).cost.tasks
    result = api.run(workflow, workers=0)
    done = sum(stage.tasks for stage in result.report.performance.stages.values())
    tiles = sum(1 for _ in read_receipts(Store(result.output), "coincide"))
    assert done == 4 + tiles + len(whole)
    # Rims of files' extents have tiles with next to nothing in them.
    assert done <= planned <= 1.5 * done


@pytest.mark.parametrize("shuffled", [False, True])
@pytest.mark.parametrize("stretch_rows", [100, 3000])
def test_stretches_do_not_matter(shuffled: bool, stretch_rows: int, tmp_path: Path) -> None:  # noqa: FBT001
    _, detections = flown()
    path = tmp_path / "d.parquet"
    rows = np.arange(len(detections))
    order = np.random.default_rng(2).permutation(rows) if shuffled else rows
    l1_files.write_detections(path, detections.take(order))
    parts = list(l1_files.detections_in_order(path, SMALL.array, tmp_path, stretch_rows))
    assert len(parts) > 10_000 / stretch_rows
    found = Detections.joined(parts)
    for name in Detections.__slots__:
        assert np.array_equal(getattr(found, name), getattr(detections, name))
    assert list(tmp_path.iterdir()) == [path]


def test_faults_of_several_stretches_add_up(tmp_path: Path) -> None:
    _, detections = flown()
    path = tmp_path / "d.parquet"
    again = detections.take(np.r_[0 : len(detections), 0:3, len(detections) - 4])
    l1_files.write_detections(path, again)
    frame = int(detections.frame[0])
    with pytest.raises(InputError, match=rf"^.*: 4 times a detector .* of frame {frame};"):
        list(l1_files.detections_in_order(path, SMALL.array, None, 1000))
    table = pq.read_table(path)
    x = table["x"].to_numpy().copy()
    x[[5, -5]] = np.inf
    detector = table["detector"].to_numpy().astype(np.int64)
    detector[-1] = -3
    table = table.set_column(2, "x", [x]).set_column(1, "detector", [detector])
    pq.write_table(table, path, row_group_size=700)
    with pytest.raises(InputError, match=r"'detector' runs from -3 to .*; 2 values of 'x'"):
        list(l1_files.detections_in_order(path, SMALL.array, None, 1000))


def test_extents_come_from_row_groups(tmp_path: Path) -> None:
    _, detections = flown()
    path = tmp_path / "d.parquet"
    l1_files.write_detections(path, detections)
    pq.write_table(pq.read_table(path), path, row_group_size=5000)
    found = l1_files.extents(path)
    assert found is not None
    assert sum(rows for *_, rows in found) == len(detections)
    first = detections.xyz[:5000] / 1000
    assert found[0] == (*first[:, :2].min(axis=0), *first[:, :2].max(axis=0), 5000)
    pq.write_table(pq.read_table(path), path, write_statistics=False)
    assert l1_files.extents(path) is None


def test_a_damaged_footer_ends_no_process(tmp_path: Path) -> None:
    path, column = tmp_path / "d.parquet", np.arange(40)
    names = l1_files.DETECTION_COLUMNS
    table = {name: column if name in {"frame", "detector"} else column / 2 for name in names}
    pq.write_table(pa.table(table), path, row_group_size=20)
    whole, refused = path.read_bytes(), 0
    start = len(whole) - 8 - int.from_bytes(whole[-8:-4], "little")
    for at in range(start, start + 400):
        for value in (0, 4):
            path.write_bytes(whole[:at] + bytes([value]) + whole[at + 1 :])
            try:
                l1_files.inspect(path, names)
                refused += l1_files.extents(path) is None
            except InputError:
                refused += 1
    assert refused > 100
