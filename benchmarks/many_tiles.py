"""A sparse survey of many tiles, killed half-way and continued.

    python -m benchmarks.many_tiles FOLDER [--side-m 16000] [--workers 2]

Makes a square of flightlines with some returns in each tile of 50 m, which is a large
survey's number of tasks without its points, runs it until half of the cells of ``ground`` are done,
kills the whole process group and runs it again. Prints the memory of the process that schedules,
how soon after the kill the next task ended, and the tasks of each kind with their time.
"""

import argparse
import json
import os
import signal
import subprocess
import sys
import time
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import laspy
import numpy as np
import yaml
from pyproj import CRS

from spl_batch.engine.watch.status import LOG, seconds

TILE_M: Final = 50.0
PER_TILE: Final = 25
"""Returns of a tile [count]."""

SWATH_M: Final = 1000.0
"""Width of a flightline; none overlaps another [m]."""

SPEED: Final = 100.0
"""Of the aircraft [m/s]."""

ALTITUDE_M: Final = 3000.0
GATE_M: Final = 100.0
NOISE_SHARE: Final = 0.02
CORNER: Final = (272_000.0, 3_289_000.0)
CELL_M: Final = 10.0
"""Of the rasters [m]: finer ones cost by area, not by task."""

GROUND_CELL_M: Final = 400.0


def survey(folder: Path, side_m: float) -> Path:
    """Workflow of a survey, written unless it is there."""
    workflow = folder / "workflow.yaml"
    if workflow.exists():
        return workflow
    (folder / "flightlines").mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(1)
    length_s = side_m / SPEED
    with (folder / "trajectory.csv").open("w", encoding="utf-8") as trajectory:
        trajectory.write("gps_time,x,y,z\n")
        for line in range(round(side_m / SWATH_M)):
            start = 1000.0 + 2 * length_s * line
            middle = CORNER[0] + SWATH_M * (line + 0.5)
            for second in range(-5, int(length_s) + 6):
                north = CORNER[1] + SPEED * second
                place = f"{middle:.3f},{north:.3f},{ALTITUDE_M:.3f}"
                trajectory.write(f"{start + second:.3f},{place}\n")
            _flightline(folder / "flightlines" / f"{line + 1:03}.laz", line + 1, start, side_m, rng)
    content = {
        "survey": {
            "flightlines": "flightlines/*.laz",
            "trajectory": "trajectory.csv",
            "sensor": "spl100",
            "channel_dimension": "user_data",
        },
        "output": "out",
        "acquisition": {"prf_hz": 1000.0, "gate_m": GATE_M},
        "tiling": {"tile_m": TILE_M},
        "ground": {"cell_m": GROUND_CELL_M},
        "products": {"cell_m": CELL_M},
    }
    workflow.write_text(yaml.safe_dump(content), encoding="utf-8")
    return workflow


def _flightline(
    path: Path, number: int, start_s: float, side_m: float, rng: np.random.Generator
) -> None:
    """Shots of one return each over gentle hills, a tenth of them noise."""
    n = round(side_m * SWATH_M / TILE_M**2 * PER_TILE)
    at = np.sort(rng.uniform(0.0, side_m, n))
    x = CORNER[0] + SWATH_M * (number - 1) + rng.uniform(0.0, SWATH_M, n)
    y = CORNER[1] + at
    z = 20.0 * np.sin(x / 700.0) * np.cos(y / 900.0) + rng.normal(0.0, 0.05, n)
    noise = rng.random(n) < NOISE_SHARE
    z[noise] = rng.uniform(-GATE_M / 2, GATE_M / 2, int(noise.sum()))
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales, header.offsets = np.full(3, 0.001), np.array([*CORNER, 0.0])
    header.add_crs(CRS.from_user_input("EPSG:32616"))
    cloud = laspy.LasData(header)
    cloud.x, cloud.y, cloud.z = x, y, z
    cloud.gps_time = start_s + at / SPEED
    cloud.return_number = cloud.number_of_returns = np.ones(n, np.uint8)
    cloud.point_source_id = np.full(n, number, np.uint16)
    cloud.user_data = rng.integers(0, 100, n, dtype=np.uint8)
    cloud.write(path)


def events(log: Path) -> Iterator[dict[str, Any]]:
    """What a run recorded, each with its time ``at`` [s]; a line that is being written is left."""
    if not log.exists():
        return
    with log.open(encoding="utf-8") as lines:
        for line in lines:
            if line.endswith("\n"):
                event = json.loads(line)
                yield event | {"at": seconds(event)}


def ended(log: Path, kind: str) -> int:
    """Tasks of a kind that have ended [count]."""
    return sum(some["event"] == "TaskEnded" and some["kind"] == kind for some in events(log))


def start(workflow: Path, workers: int, *options: str) -> "subprocess.Popen[bytes]":
    """A run in a process group of its own."""
    line = [sys.executable, "-m", "spl_batch", "run", str(workflow), "--workers", str(workers)]
    return subprocess.Popen([*line, *options], start_new_session=True)  # noqa: S603


def highest_mb(process: int) -> float:
    """Highest memory of a process until now [MB]."""
    status = Path(f"/proc/{process}/status").read_text(encoding="utf-8")
    return int(status.partition("VmHWM:")[2].split()[0]) / 1024


def wait(run: "subprocess.Popen[bytes]") -> tuple[int, float]:
    """Its exit status, and the highest memory of the process that schedules [MB]."""
    highest = 0.0
    while run.poll() is None:
        try:
            highest = max(highest, highest_mb(run.pid))
        except (FileNotFoundError, IndexError):
            break  # it ended in between
        time.sleep(1.0)
    return run.wait(), highest


def stages(log: Path) -> dict[str, tuple[int, float, float]]:
    """Tasks, their seconds and the mean of these [s], by kind."""
    count: dict[str, int] = defaultdict(int)
    own: dict[str, float] = defaultdict(float)
    for event in events(log):
        if event["event"] == "TaskEnded":
            count[event["kind"]] += 1
            own[event["kind"]] += event["wall_s"]
    return {kind: (count[kind], own[kind], own[kind] / count[kind]) for kind in count}


def main() -> None:
    """Make the survey, run it, kill it, and continue."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--side-m", type=float, default=16_000.0)
    parser.add_argument("--workers", type=int, default=2)
    given = parser.parse_args()
    workflow = survey(given.folder, given.side_m)
    log = given.folder / "out" / LOG
    cells = (given.side_m / GROUND_CELL_M) ** 2
    begun = time.time()
    run = start(workflow, given.workers, "--fresh")
    while run.poll() is None and ended(log, "ground") < cells / 2:
        time.sleep(30.0)
    half = highest_mb(run.pid)
    os.killpg(run.pid, signal.SIGKILL)
    run.wait()
    killed = time.time()
    print(f"killed after {killed - begun:.0f} s; the process that schedules held {half:.0f} MB")
    run = start(workflow, given.workers)
    status, highest = wait(run)
    over = time.time()
    if status:
        sys.exit(f"ended with {status}")
    following = (some for some in events(log) if some["at"] > killed)
    next_s = next(some["at"] for some in following if some["event"] == "TaskEnded") - killed
    print(f"first task ended {next_s:.1f} s after the kill; {highest:.0f} MB")
    print(f"{over - begun:.0f} s in all")
    for kind, (count, own, mean) in stages(log).items():
        print(f"{kind:20} {count:8} tasks {own:8.0f} s {1000 * mean:8.1f} ms each")


if __name__ == "__main__":
    main()
