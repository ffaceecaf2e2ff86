"""What tasks hold in memory.

Run ``python -m benchmarks.engine.memory tasks|strips|areas|trajectory|coincidence``.

``tasks WORKFLOW [KEY=VALUE ...]`` runs a workflow in this process, into a folder of its
own, and prints for each kind of task the highest resident memory above what the process
held before it, by the points that the plan counts for it: what the constants of
:mod:`spl_batch.airborne.plan.task_memory` are taken from.

``strips WORKFLOW [KEY=VALUE ...]`` runs a workflow up to its surfaces and does the ground, the
comparison of flightlines and the surfaces of its fullest cell again, at once and in more and more
strips: points that the cell owns and that the fullest strip reads, memory above what the process
held before, processor time, and whether the bytes are the same. Lines through these give the bytes
of a point of the cell and of a strip in :mod:`spl_batch.airborne.plan.memory.cell_memory`.

``areas FOLDER`` flies strips of once, twice, four and eight times the area and runs each
with two workers under a limit: peak memory by stage, which follows the largest stretch or block
and must not grow with the survey.

``trajectory [--records 6000000]`` gathers SBET files of an eighth of the records up to all of
them, 200 each second: memory and time.

``coincidence [--rows 16000000]`` indexes Geiger-mode detections files of an eighth of the rows up
to all of them, and their frames, in order and in disorder: memory, time, bytes in the store.
"""

import argparse
import contextlib
import os
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from unittest import mock

import laspy
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import yaml
from pyproj import CRS

from benchmarks.engine.cell_strips import strips
from benchmarks.engine.peak import Peak
from spl_batch import api
from spl_batch.airborne.context import Context
from spl_batch.airborne.simulate import simulate
from spl_batch.airborne.simulate.scene.scene_file import Scene
from spl_batch.airborne.store import label_tables
from spl_batch.airborne.tasks import space_domain
from spl_batch.airborne.tasks.cells import ground_cell
from spl_batch.engine.flow import job
from spl_batch.engine.store.working_store import Store, read_receipts
from spl_batch.engine.tasks import runner
from spl_batch.engine.tasks.task import Receipt, Task
from spl_batch.formats.trajectory.positions import PointExtent, gathering, write_trajectory
from spl_batch.formats.trajectory.sbet import BLOCK_RECORDS, SBET_RECORD
from spl_batch.geiger.coincidence.formats import l1_files
from spl_batch.geiger.coincidence.settings import ArraySettings
from spl_batch.geiger.coincidence.tables import Attitudes

AREAS = (1, 2, 4, 8)
"""Lengths of the strips, in lengths of the shortest."""

LENGTH_M, WIDTH_M = 200.0, 100.0
"""Size of the shortest strip [m]."""

FILE_POINTS = 250_000
"""Points of a file [count]."""

FRAME_DETECTIONS = 800
"""Detections of a frame of the source's array, about [count]."""

GROUP_ROWS = 1_000_000
"""Rows of a row group of a detections file [count]."""


def tasks(workflow: Path, overrides: Sequence[str]) -> None:
    """Print the memory of each kind of task."""
    seen: dict[str, list[tuple[int, int, int]]] = defaultdict(list)
    plain, read = runner.run_task, label_tables.read_region
    region: list[int] = []

    def counted(*args: Any, **options: Any) -> Any:
        found = read(*args, **options)
        region.append(len(found[0]))
        return found

    def watched(task: Task, key: str, context: Context) -> Receipt:
        region.clear()
        with Peak().watching() as peak:
            receipt = plain(task, key, context)
        held = region[0] if region else max(task.points, receipt.points)
        seen[task.kind].append((peak.highest - peak.before, held, peak.before))
        return receipt

    with tempfile.TemporaryDirectory() as folder, contextlib.ExitStack() as stack:
        stack.enter_context(mock.patch.object(job, "run_task", watched))
        for tasks in (space_domain, ground_cell):
            stack.enter_context(mock.patch.object(tasks, "read_region", counted))
        for attempt in ("first", "second"):  # the first one loads and compiles
            seen.clear()
            api.run(workflow, workers=0, overrides=[f"output={folder}/{attempt}", *overrides])
    titles = f"{'kind':14s}{'tasks':>7s}{'points held':>14s}{'MiB':>8s}{'bytes / point':>15s}"
    print(f"{titles}{'base':>8s}")
    for kind, listed in seen.items():
        most, points, before = max(listed)
        each = most / points if points else 0.0
        print(
            f"{kind:14s}{len(listed):7d}{points:14,d}{most / 2**20:8.0f}{each:15.0f}"
            f"{before / 2**20:8.0f}"
        )


def areas(folder: Path, memory: str) -> None:
    """Print the peak memory of surveys that grow."""
    for factor in AREAS:
        workflow = _strip(folder / f"x{factor}", factor)
        result = api.run(workflow, workers=2, memory=memory)
        if result.report is None or result.exit_status:
            raise SystemExit(f"{workflow}: the run failed")
        stages = result.report.performance.stages
        if factor == AREAS[0]:
            names = ("points", "largest stretch", *(f"{name} MiB" for name in stages))
            print("| " + " | ".join(names) + " |\n|" + "---|" * len(names))
        stretches = read_receipts(Store(result.output), "scatter")
        cells = [result.report.counts.points_in, max(r.points for r in stretches)]
        cells += [round(stage.peak_rss_mb or 0) for stage in stages.values()]
        print("| " + " | ".join(f"{n:,}" for n in cells) + " |", flush=True)


def _strip(folder: Path, factor: int) -> Path:
    """Workflow of a strip of this many times the shortest one's length.

    Its flightline is cut into files of equal length: a longer strip has more of them.
    """
    workflow = folder / "workflow.yaml"
    if not workflow.exists():
        scene = Scene.model_validate(
            {
                "name": f"strip of {factor}",
                "extent_m": [LENGTH_M * factor, WIDTH_M],
                "flights": [{"heading_deg": 90, "speed_m_s": 60}],
                "sky": {"background_per_m3": 0.02},
                "acquisition": {"prf_hz": 25000, "gate_m": 60, "margin_m": 2},
            }
        )
        simulate(scene, folder)
        _cut_files(folder / "flightlines")
        content = yaml.safe_load(workflow.read_text(encoding="utf-8"))
        # of one size in every survey, where a longer one would have larger blocks
        content["tiling"] = {"tile_m": 50, "block_tiles": 2}
        content["ground"] = {"cell_m": 100, "buffer_m": 40}
        workflow.write_text(yaml.safe_dump(content), encoding="utf-8")
    return workflow


def _cut_files(folder: Path) -> None:
    for path in sorted(folder.glob("*.laz")):
        with laspy.open(path) as source:
            for k, points in enumerate(source.chunk_iterator(FILE_POINTS)):
                with laspy.open(
                    path.with_name(f"{path.stem}_{k:02d}.laz"), "w", header=source.header
                ) as target:
                    target.write_points(points)
        path.unlink()


def trajectory(records: int) -> None:
    """Print what gathering trajectories of several lengths takes."""
    print(f"{'records':>12s}{'MiB':>8s}{'s':>8s}")
    for count in (65_536, records // 8, records // 4, records // 2, records):
        with tempfile.TemporaryDirectory() as folder:
            path, start = Path(folder, "track.sbet"), 371_000_000.0
            with path.open("wb") as file:
                for first in range(0, count, BLOCK_RECORDS):
                    part = np.zeros(min(BLOCK_RECORDS, count - first), SBET_RECORD)
                    part["time"] = start + (first + np.arange(len(part))) / 200
                    part["longitude"], part["latitude"] = np.radians(-93.0), np.radians(29.7)
                    part.tofile(file)
            points = PointExtent((start + 1, start + 2), (5e5, 3.28e6, 5.01e5, 3.29e6))
            begin = time.perf_counter()
            with (
                Peak().watching() as peak,
                gathering(
                    [path], survey_crs=CRS.from_epsg(32615), trajectory_crs=None, points=points
                ) as found,
            ):
                write_trajectory(Path(folder, "track.parquet"), found)
            spent = time.perf_counter() - begin
            print(f"{found.records:12,d}{(peak.highest - peak.before) / 2**20:8.0f}{spent:8.1f}")


def coincidence(rows: int) -> None:
    """Print what indexing L1 files of several lengths takes."""
    print(f"{'order':10s}{'detections':>12s}{'MiB':>8s}{'s':>8s}{'rows/s':>12s}"
          f"{'file B/row':>12s}{'store B/row':>12s}")  # fmt: skip
    for shuffled in (False, True):
        for count in (rows // 16, rows // 8, rows // 4, rows // 2, rows):
            with tempfile.TemporaryDirectory() as folder:
                workflow = _write_l1(Path(folder), count, shuffled=shuffled)
                begin = time.perf_counter()
                with Peak().watching() as peak:
                    result = api.run(workflow, workers=0, until="index")
                spent = time.perf_counter() - begin
                kept = sum(f.stat().st_size for f in result.output.glob("store/det*/*.parquet"))
                given = (Path(folder) / "detections.parquet").stat().st_size
            if count == rows // 16 and not shuffled:
                continue  # the first one loads and compiles
            name = "disorder" if shuffled else "order"
            print(f"{name:10s}{count:12,d}{(peak.highest - peak.before) / 2**20:8.0f}{spent:8.1f}"
                  f"{count / spent:12,.0f}{given / count:12.1f}{kept / count:12.1f}",
                  flush=True)  # fmt: skip


def _write_l1(folder: Path, rows: int, *, shuffled: bool) -> Path:
    """A straight flight over level ground with 800 detections in each frame, a million in a group.

    In order a row group has frames one after the other, in disorder frames of the whole flight.
    """
    array, n = ArraySettings(), rows // FRAME_DETECTIONS
    step_m, height_m, tangent = 0.05, 3000.0, array.ifov_rad
    place = np.column_stack([5e5 + np.arange(n) * step_m, np.full(n, 4e6), np.full(n, height_m)])
    attitude = np.column_stack([np.full(n, 0.5 * np.pi), np.zeros((n, 2))])
    l1_files.write_frames(folder / "frames.parquet", Attitudes(np.arange(n), place, attitude))
    detector = np.arange(FRAME_DETECTIONS) * (array.detectors // FRAME_DETECTIONS)
    across, along = np.divmod(detector, array.columns)
    x = (along - 0.5 * (array.columns - 1)) * tangent * height_m
    y = -(across - 0.5 * (array.rows - 1)) * tangent * height_m
    rng, groups = np.random.default_rng(1), -(-rows // GROUP_ROWS)
    kinds = {"frame": "int64", "detector": "int32", **dict.fromkeys("xyz", "float64")}
    schema = pa.schema(list(kinds.items()))
    with pq.ParquetWriter(folder / "detections.parquet", schema, compression="zstd") as writer:
        for group, frame in enumerate(np.array_split(np.arange(n), groups)):
            if shuffled:
                frame = np.arange(group, n, groups)  # noqa: PLW2901
            columns = [
                np.repeat(frame, FRAME_DETECTIONS),
                np.tile(detector, len(frame)).astype(np.int32),
                (place[frame, :1] + x).ravel(),
                (place[frame, 1:2] + y).ravel(),
                rng.normal(0.0, 0.05, len(frame) * FRAME_DETECTIONS),
            ]
            writer.write_table(pa.table(columns, schema=schema), row_group_size=GROUP_ROWS)
    workflow = folder / "workflow.yaml"
    survey = {"frames": "frames.parquet", "detections": "detections.parquet"}
    content = {"kind": "coincidence", "survey": survey, "output": "out"}
    workflow.write_text(yaml.safe_dump(content), encoding="utf-8")
    return workflow


def _give_back_freed_memory() -> None:
    """Start again with an allocator that keeps nothing: what is in use is what is counted."""
    wanted = {"MALLOC_MMAP_THRESHOLD_": "65536", "MALLOC_TRIM_THRESHOLD_": "65536"}
    if any(os.environ.get(key) != value for key, value in wanted.items()):
        os.execve(sys.executable, sys.orig_argv, {**os.environ, **wanted})  # noqa: S606


def main() -> None:
    """Read the arguments."""
    parser = argparse.ArgumentParser(description=__doc__)
    verbs = parser.add_subparsers(dest="verb", required=True)
    of_tasks = verbs.add_parser("tasks")
    of_tasks.add_argument("workflow", type=Path)
    of_tasks.add_argument("overrides", nargs="*")
    of_strips = verbs.add_parser("strips")
    of_strips.add_argument("workflow", type=Path)
    of_strips.add_argument("overrides", nargs="*")
    of_areas = verbs.add_parser("areas")
    of_areas.add_argument("folder", type=Path)
    of_areas.add_argument("--memory", default="1GiB")
    of_coincidence = verbs.add_parser("coincidence")
    of_coincidence.add_argument("--rows", type=int, default=16_000_000)
    of_trajectory = verbs.add_parser("trajectory")
    of_trajectory.add_argument("--records", type=int, default=6_000_000)
    given = parser.parse_args()
    if given.verb != "areas":
        _give_back_freed_memory()
    if given.verb == "tasks":
        tasks(given.workflow, given.overrides)
    elif given.verb == "strips":
        strips(given.workflow, given.overrides)
    elif given.verb == "trajectory":
        trajectory(given.records)
    elif given.verb == "coincidence":
        coincidence(given.rows)
    else:
        areas(given.folder, given.memory)


if __name__ == "__main__":
    main()
