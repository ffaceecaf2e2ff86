"""A survey of 140 million returns, from its simulation to its report.

    python -m benchmarks.airborne.whole_survey FOLDER [--side-m 1500] [--memory SIZE] [--workers 2]

Simulates three flightlines over a square of 1.5 km, about 60 returns for each square metre,
into FOLDER, once: one that is there is taken as it is. Runs it and prints wall time, peak
memory of a worker, disk used, and points a second by stage. Smaller squares take the same
share of the time that it needs. ``--only-simulate`` stops after the first part.
"""

import argparse
import json
import os
import resource
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import yaml


def scene(side_m: float) -> dict[str, Any]:
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
        "sky": {"background_per_m3": 0.1},
        "acquisition": {"prf_hz": 28_000, "gate_m": 300},
    }


def simulate(folder: Path, side_m: float) -> Path:
    """Workflow of the survey, simulated unless it is there; prints what that took."""
    workflow = folder / "survey" / "workflow.yaml"
    if not workflow.exists():  # the last thing that a simulation writes
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "scene.yaml").write_text(yaml.safe_dump(scene(side_m)), encoding="utf-8")
        wall_s, peak = _command("simulate", folder / "scene.yaml", folder / "survey")
        print(f"simulated in {wall_s:.0f} s, peak memory {peak:.0f} MiB", flush=True)
    return workflow


def run(workflow: Path, memory: str | None, workers: int) -> None:
    """Run the survey and print what it took."""
    limit = ("--memory", memory) if memory else ()
    wall_s, _ = _command("run", workflow, *limit, "--workers", workers)
    output = workflow.parent / "out"
    report = json.loads((output / "report.json").read_text(encoding="utf-8"))
    counts, performance = report["counts"], report["performance"]
    points = counts["points_in"]
    receipts = sum(1 for _ in (output / "store" / "receipts").rglob("*.json"))
    print(f"{points:,} returns in, {counts['points_out']:,} out, {receipts:,} tasks")
    print(f"wall time {wall_s / 60:.1f} min, {points / wall_s:,.0f} returns/s")
    print(f"peak memory of a worker {performance['peak_rss_mb']:.0f} MB")
    inputs = sum(p.stat().st_size for p in workflow.parent.glob("flightlines/*.laz"))
    sizes = {"inputs": inputs, "store": _size(output / "store")}
    sizes["results"] = _size(output) - sizes["store"]
    print("disk " + ", ".join(f"{name} {size / 1e9:.2f} GB" for name, size in sizes.items()))
    print("| stage | seconds of work | returns / s and worker | peak MB |\n|---|---|---|---|")
    for name, stage in performance["stages"].items():
        speed = points / stage["wall_s"] if stage["wall_s"] else 0.0
        peak = stage["peak_rss_mb"] or 0.0
        print(f"| {name} | {stage['wall_s']:.0f} | {speed:,.0f} | {peak:.0f} |")


def _command(*arguments: object) -> tuple[float, float]:
    """Run the command line; wall time [s] and peak memory of the heaviest process [MiB]."""
    start = time.perf_counter()
    command = [sys.executable, "-m", "spl_batch", *map(str, arguments)]
    done = subprocess.run(command, check=False, stdout=subprocess.DEVNULL)  # noqa: S603
    if done.returncode:
        sys.exit(f"{' '.join(command)}: ended with {done.returncode}")
    peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024
    return time.perf_counter() - start, peak


def _size(folder: Path) -> int:
    """Size of all files below a folder on disk [byte]."""
    return sum(
        Path(place, name).lstat().st_blocks * 512
        for place, _, names in os.walk(folder)
        for name in names
    )


def main() -> None:
    """Read the arguments."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--side-m", type=float, default=1500.0)
    parser.add_argument("--memory", help="of a worker, as the command chooses it by default")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--only-simulate", action="store_true")
    given = parser.parse_args()
    workflow = simulate(given.folder, given.side_m)
    if not given.only_simulate:
        run(workflow, given.memory, given.workers)


if __name__ == "__main__":
    main()
