"""What one file without a workflow costs beside a run: the seconds of one and the other.

    python -m benchmarks.airborne.one_file FOLDER [--side-m 150] [--repeats 3]

Simulates one pass over a square of the kind of :mod:`benchmarks.airborne.whole_survey` into FOLDER,
once. Then it runs `spl-batch run` on a workflow of it and `spl-batch denoise --ground --dtm` on its
file with the same trajectory, in turn, in one process each and with kernels compiled before. Prints
processor seconds per million returns of both, which other work on the machine changes less than
wall time, and their ratio.
"""

import argparse
import json
import resource
import subprocess
import sys
from pathlib import Path
from statistics import median

from benchmarks.airborne.end_to_end import survey
from benchmarks.airborne.whole_survey import scene


def main(folder: Path, side_m: float, repeats: int) -> None:
    """Print both times and their ratio."""
    content = scene(side_m)
    content["flights"] = [{"heading_deg": 0, "offset_m": 0}]
    workflow = survey(folder, f"one_pass_{side_m:g}", content)
    (source,) = workflow.parent.glob("flightlines/*.laz")
    trajectory = workflow.parent / "trajectory.csv"
    cloud, dtm = folder / "clean.laz", folder / "dtm.tif"
    ways: dict[str, list[object]] = {
        "run": ["run", workflow, "--fresh"],
        "denoise": [
            *("denoise", source, cloud, "--trajectory", trajectory, "--ground", "--dtm", dtm),
            "--force",
        ],
    }
    cost(ways["run"])  # compiles, and touches memory for the first time
    seconds: dict[str, list[float]] = {name: [] for name in ways}
    for _ in range(repeats):
        for name, arguments in ways.items():
            seconds[name].append(cost(arguments))
    report = json.loads((workflow.parent / "out" / "report.json").read_text(encoding="utf-8"))
    millions = report["counts"]["points_in"] / 1e6
    print(f"{millions:.2f} M returns, median of {repeats}")
    found = {name: median(values) / millions for name, values in seconds.items()}
    for name, value in found.items():
        print(f"{name:8s}{value:7.2f} s of processor a million")
    print(f"denoise / run: {found['denoise'] / found['run']:.2f}")


def cost(arguments: list[object]) -> float:
    """Processor time of a command in one process [s]."""
    line = [sys.executable, "-m", "spl_batch", *map(str, arguments), "--workers", "0"]
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    done = subprocess.run(line, check=False, capture_output=True, text=True)  # noqa: S603
    if done.returncode:
        sys.exit(f"{' '.join(line)}: ended with {done.returncode}\n{done.stderr}")
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return (after.ru_utime + after.ru_stime) - (before.ru_utime + before.ru_stime)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--side-m", type=float, default=150.0)
    parser.add_argument("--repeats", type=int, default=3)
    given = parser.parse_args()
    main(given.folder, given.side_m, given.repeats)
