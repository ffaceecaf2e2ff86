"""The whole chain on one worker and on two, beside what others take in the same run.

    python -m benchmarks.end_to_end FOLDER [--side-m 800] [--background 0.035] [--density 1]
        [--memory 4GiB]

Simulates a square of three flightlines into FOLDER, once, nearly 40 % of it noise by default, and
runs it from LAZ to LAZ and COG. Prints seconds of work per million returns and core of each stage,
the highest memory of a worker, how much faster two workers are than one, from the first task of the
chain to its last and in all, and the ratios of :mod:`benchmarks.peers`. Kernels are compiled
before, and a first run, which touches memory for the first time, is not counted. A square of
``--side-m 1500`` at four times the shots has 140 million returns.
"""

import argparse
import json
import subprocess
import sys
import time
from pathlib import Path
from typing import Any, Final

import yaml

from benchmarks.peers import print_ratios
from spl_batch.airborne.precompile import compile_all
from spl_batch.engine.watch.status import LOG, seconds

SIDE_M: Final = 800.0
"""Side of the square, by default [m]."""

FORTY: Final = 0.035
"""Background with which nearly 40 % of what is returned is noise [1/m3]."""


def scene(side_m: float, background: float, density: float) -> dict[str, Any]:
    """Scene of a square: hills, a quarter under trees, a village, three parallel passes."""
    return {
        "name": f"square of {side_m:g} m",
        "extent_m": [side_m, side_m],
        "seed": 2,
        "buildings": {"count": round(side_m**2 / 4500)},
        "trees": {"cover": 0.25},
        "flights": [
            {"heading_deg": 0, "offset_m": -0.3 * side_m},
            {"heading_deg": 180, "offset_m": 0},
            {"heading_deg": 0, "offset_m": 0.3 * side_m},
        ],
        "sky": {"background_per_m3": background},
        "acquisition": {"prf_hz": 28_000 * density, "gate_m": 300},
    }


def survey(folder: Path, content: dict[str, Any]) -> Path:
    """Workflow of a scene, simulated unless it is there."""
    workflow = folder / "survey" / "workflow.yaml"
    if not workflow.exists():  # the last thing that a simulation writes
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "scene.yaml").write_text(yaml.safe_dump(content), encoding="utf-8")
        command("simulate", folder / "scene.yaml", folder / "survey")
    return workflow


def command(*arguments: object) -> float:
    """Run the command line; wall time [s]."""
    start = time.perf_counter()
    line = [sys.executable, "-m", "spl_batch", *map(str, arguments)]
    done = subprocess.run(line, check=False, capture_output=True, text=True)  # noqa: S603
    if done.returncode:
        sys.exit(f"{' '.join(line)}: ended with {done.returncode}\n{done.stderr}")
    return time.perf_counter() - start


def run(workflow: Path, workers: int, memory: str) -> tuple[dict[str, float], float]:
    """Seconds per million of each stage of a fresh run, which it prints, and wall time [s]."""
    wall_s = command("run", workflow, "--fresh", "--workers", workers, "--memory", memory)
    report = json.loads((workflow.parent / "out" / "report.json").read_text(encoding="utf-8"))
    counts, performance = report["counts"], report["performance"]
    millions = counts["points_in"] / 1e6
    # What a reference takes by its own points is no part of the chain.
    stages = {k: v["wall_s"] / millions for k, v in performance["stages"].items() if k != "report"}
    costs = {**stages, "all": sum(stages.values())}
    noise = 100 * (counts["background"] + counts["afterpulse"]) / counts["points_in"]
    print(f"{workers} workers, {millions:.2f} M returns, {noise:.1f} % noise; s per M and core: "
          + ", ".join(f"{name} {seconds:.2f}" for name, seconds in costs.items())
          + f"; {performance['peak_rss_mb']:.0f} MB; {wall_s:.1f} s", flush=True)  # fmt: skip
    return costs, wall_s


def chain_s(output: Path) -> float:
    """Wall time from when workers were ready to the end of the chain, the report left out [s]."""
    events = map(json.loads, (output / LOG).read_text(encoding="utf-8").splitlines())
    begin, end = 0.0, 0.0
    for event in events:
        at = seconds(event)
        if event["event"] == "WorkersReady":
            begin = at
        elif event["event"] == "TaskEnded" and event["kind"] not in {"reference", "accuracy"}:
            end = at
    return end - begin


def main() -> None:
    """Read the arguments, simulate and run."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--side-m", type=float, default=SIDE_M)
    parser.add_argument("--background", type=float, default=FORTY, help="[1/m3]")
    parser.add_argument("--density", type=float, default=1.0, help="share of the shots")
    parser.add_argument("--memory", default="4GiB", help="of a worker")
    given = parser.parse_args()
    compile_all()  # else the first run would
    workflow = survey(given.folder, scene(given.side_m, given.background, given.density))
    run(workflow, 2, given.memory)
    output, walls, chains = workflow.parent / "out", [], []
    costs, wall_s = run(workflow, 1, given.memory)
    for workers in (1, 2):
        if workers > 1:
            _, wall_s = run(workflow, workers, given.memory)
        walls.append(wall_s)
        chains.append(chain_s(output))
    print(
        f"two workers are {chains[0] / chains[1]:.2f} times as fast as one along the chain "
        f"({chains[0]:.0f} and {chains[1]:.0f} s), {walls[0] / walls[1]:.2f} times in all"
    )
    print_ratios(output, {name: costs[name] for name in ("denoise", "all")})


if __name__ == "__main__":
    main()
