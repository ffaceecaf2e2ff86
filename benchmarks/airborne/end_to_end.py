"""The whole chain on one worker and on two, and its cost by area and by share of noise.

    python -m benchmarks.airborne.end_to_end FOLDER [workers] [area] [noise] [--side-m 800]
        [--background 0.035] [--density 1] [--memory 4GiB]

Simulates surveys of the kind of :mod:`benchmarks.airborne.whole_survey` into FOLDER, once, and runs
each from LAZ to LAZ and COG. Prints seconds of work per million returns and core of each stage, the
highest memory of a worker, and

- ``workers``: a square of ``--side-m``, nearly 40 % of it noise unless ``--background`` [1/m3] says
  otherwise, and fewer shots where ``--density`` does: how much faster two workers are than one,
  from the first task of the chain to its last and in all, and the ratios of
  :mod:`benchmarks.airborne.peers`;
- ``area``: squares whose sides double, at a quarter of the density, one worker; and what each
  further million of a square costs beside the next smaller one;
- ``noise``: squares of 200 m from little background to more than half of all returns, one worker.

All three by default. Kernels are compiled before, and a first run of ``workers``, which touches
memory for the first time, is not counted. Workers have the same memory whether one works or two: by
default one has more of it, and larger blocks.
"""

import argparse
import json
import subprocess
import sys
import time
from datetime import datetime
from pathlib import Path
from typing import Any

import yaml

from benchmarks.airborne.peers import print_ratios
from benchmarks.airborne.whole_survey import scene
from spl_batch.airborne.precompile import compile_share

SIDES_M = (100, 200, 400, 800)
SIDE_M = 800.0
"""Side of the square that workers share, by default [m]."""

BACKGROUNDS = (0.001, 0.01, 0.03, 0.08, 0.2, 0.5)
"""Background of the scenes [1/m3]."""

FORTY = 0.035
"""Background with which nearly 40 % of what is returned is noise [1/m3]."""


def survey(folder: Path, name: str, content: dict[str, Any]) -> Path:
    """Workflow of a scene, simulated unless it is there."""
    workflow = folder / name / "workflow.yaml"
    if not workflow.exists():  # the last thing that a simulation writes
        folder.mkdir(parents=True, exist_ok=True)
        (folder / f"{name}.yaml").write_text(yaml.safe_dump(content), encoding="utf-8")
        command("simulate", folder / f"{name}.yaml", folder / name)
    return workflow


def command(*arguments: object) -> float:
    """Run the command line; wall time [s]."""
    start = time.perf_counter()
    line = [sys.executable, "-m", "spl_batch", *map(str, arguments)]
    done = subprocess.run(line, check=False, capture_output=True, text=True)  # noqa: S603
    if done.returncode:
        sys.exit(f"{' '.join(line)}: ended with {done.returncode}\n{done.stderr}")
    return time.perf_counter() - start


def run(
    workflow: Path, workers: int, memory: str
) -> tuple[dict[str, float], dict[str, Any], float]:
    """Seconds per million of each stage, the report, and wall time [s]."""
    wall_s = command("run", workflow, "--fresh", "--workers", workers, "--memory", memory)
    report = json.loads((workflow.parent / "out" / "report.json").read_text(encoding="utf-8"))
    millions = report["counts"]["points_in"] / 1e6
    stages = report["performance"]["stages"]
    # What a reference says takes time by its own points, and is no part of the chain.
    costs = {k: stage["wall_s"] / millions for k, stage in stages.items() if k != "report"}
    return costs, report, wall_s


def print_run(label: str, costs: dict[str, float], report: dict[str, Any], wall_s: float) -> None:
    """One line of a table."""
    counts = report["counts"]
    noise = 100 * (counts["background"] + counts["afterpulse"]) / counts["points_in"]
    stages = "".join(f"{seconds:10.2f}" for seconds in costs.values())
    print(
        f"{label:10s}{counts['points_in'] / 1e6:8.2f}{noise:9.1f}{stages}{sum(costs.values()):8.2f}"
        f"{report['performance']['peak_rss_mb']:8.0f}{wall_s:8.1f}",
        flush=True,
    )


def head(first: str, stages: dict[str, float]) -> None:
    """The line above a table."""
    names = "".join(f"{name:>10s}" for name in stages)
    print(f"{first:10s}{'M':>8s}{'noise %':>9s}{names}{'all':>8s}{'MB':>8s}{'wall s':>8s}")


def chain_s(output: Path) -> float:
    """Wall time from when workers were ready to the end of the chain, the report left out [s]."""
    events = map(json.loads, (output / "log.jsonl").read_text(encoding="utf-8").splitlines())
    begin, end = 0.0, 0.0
    for event in events:
        at = datetime.fromisoformat(event["time"]).timestamp()
        if event["event"] == "WorkersReady":
            begin = at
        elif event["event"] == "TaskEnded" and event["kind"] not in {"reference", "accuracy"}:
            end = at
    return end - begin


def by_workers(folder: Path, side_m: float, background: float, density: float, memory: str) -> None:
    """One worker, and two; ratios to others."""
    content = scene(side_m)
    content["sky"]["background_per_m3"] = background
    content["acquisition"]["prf_hz"] *= density
    workflow = survey(folder, f"workers_{side_m:g}_{background:g}_{density:g}", content)
    run(workflow, 2, memory)
    walls, chains = {}, {}
    for workers in (1, 2):
        costs, report, walls[workers] = run(workflow, workers, memory)
        chains[workers] = chain_s(workflow.parent / "out")
        if workers == 1:
            head("workers", costs)
            ours = {"denoise": costs["denoise"], "all": sum(costs.values())}
        print_run(str(workers), costs, report, walls[workers])
    print(
        f"two workers are {chains[1] / chains[2]:.2f} times as fast as one along the chain "
        f"({chains[1]:.0f} and {chains[2]:.0f} s), {walls[1] / walls[2]:.2f} times in all"
    )
    print_ratios(workflow.parent / "out", ours)


def by_area(folder: Path, memory: str) -> None:
    """Squares whose sides double."""
    before = 0.0, 0.0
    for side_m in SIDES_M:
        content = scene(float(side_m))
        content["acquisition"]["prf_hz"] /= 4
        costs, report, wall_s = run(survey(folder, f"side{side_m}", content), 1, memory)
        if side_m == SIDES_M[0]:
            head("side [m]", costs)
        print_run(str(side_m), costs, report, wall_s)
        millions = report["counts"]["points_in"] / 1e6
        work_s = millions * sum(costs.values())
        more_s = (work_s - before[1]) / (millions - before[0])
        print(f"{'':10s}each further million {more_s:.2f} s", flush=True)
        before = millions, work_s


def by_noise(folder: Path, memory: str) -> None:
    """From little background to much."""
    for background in BACKGROUNDS:
        content = scene(200.0)
        content["sky"]["background_per_m3"] = background
        costs, report, wall_s = run(survey(folder, f"sky{background:g}", content), 1, memory)
        if background == BACKGROUNDS[0]:
            head("1/m3", costs)
        print_run(f"{background:g}", costs, report, wall_s)


def main() -> None:
    """Read the arguments."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parts = ["workers", "area", "noise"]
    parser.add_argument("parts", nargs="*", choices=[*parts, []], default=[])
    parser.add_argument("--side-m", type=float, default=SIDE_M)
    parser.add_argument("--background", type=float, default=FORTY, help="of --side-m [1/m3]")
    parser.add_argument(
        "--density", type=float, default=1.0, help="of shots in it, of the full one"
    )
    parser.add_argument("--memory", default="4GiB", help="of a worker")
    given = parser.parse_args()
    compile_share(0, 1)  # else the first run would
    for part in given.parts or parts:
        if part == "workers":
            by_workers(given.folder, given.side_m, given.background, given.density, given.memory)
        elif part == "area":
            by_area(given.folder, given.memory)
        else:
            by_noise(given.folder, given.memory)


if __name__ == "__main__":
    main()
