"""What tasks hold in memory.

Run ``python -m benchmarks.memory tasks|areas``.

``tasks WORKFLOW [KEY=VALUE ...]`` runs a workflow in this process, into a folder of its
own, and prints for each kind of task the highest resident memory above what the process
held before it, by the points that the plan counts for it: what the constants of
:mod:`spl_batch.airborne.plan.task_memory` are taken from.

``areas FOLDER`` simulates surveys of once, twice, four and eight times the area and runs each
with two workers under a limit: peak memory by stage, which follows the largest stretch or cell
and must not grow with the survey.
"""

import argparse
import contextlib
import os
import sys
import tempfile
import threading
import time
from collections import defaultdict
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any
from unittest import mock

import laspy
import yaml

from spl_batch import api
from spl_batch.airborne.context import Context
from spl_batch.airborne.simulate import simulate
from spl_batch.airborne.simulate.scene.scene_file import Scene
from spl_batch.airborne.store import label_tables
from spl_batch.engine.store.working_store import Store, read_receipts
from spl_batch.engine.tasks import runner
from spl_batch.engine.tasks.task import Receipt, Task

AREAS = (1, 2, 4, 8)
"""Lengths of the strips, in lengths of the shortest."""

LENGTH_M, WIDTH_M = 200.0, 100.0
"""Size of the shortest strip [m]."""

FILE_POINTS = 250_000
"""Points of a file [count]."""


def resident_bytes() -> int:
    """Memory of this process that is in use now [byte]."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * 4096


class Peak:
    """Highest resident memory while a block runs, looked at every millisecond."""

    def __init__(self) -> None:
        self.before = self.highest = resident_bytes()
        self._done = threading.Event()

    @contextlib.contextmanager
    def watching(self) -> Iterator["Peak"]:
        """Watch while the block runs."""
        watcher = threading.Thread(target=self._watch, daemon=True)
        watcher.start()
        try:
            yield self
        finally:
            self._done.set()
            watcher.join()

    def _watch(self) -> None:
        while not self._done.is_set():
            self.highest = max(self.highest, resident_bytes())
            time.sleep(0.001)


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
        stack.enter_context(mock.patch.object(runner, "run_task", watched))
        stack.enter_context(mock.patch.object(label_tables, "read_region", counted))
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
    of_areas = verbs.add_parser("areas")
    of_areas.add_argument("folder", type=Path)
    of_areas.add_argument("--memory", default="1GiB")
    given = parser.parse_args()
    if given.verb != "areas":
        _give_back_freed_memory()
    if given.verb == "tasks":
        tasks(given.workflow, given.overrides)
    else:
        areas(given.folder, given.memory)


if __name__ == "__main__":
    main()
