"""What one file without a workflow costs beside a run: the seconds of one and the other.

    python -m benchmarks.airborne.one_file FOLDER [--side-m 150] [--repeats 3] [--memory 16GiB]

Simulates one pass over a square of the kind of :mod:`benchmarks.airborne.whole_survey` into FOLDER,
once. Then it runs `spl-batch run` on a workflow of it and `spl-batch denoise --ground --dtm` on its
file with the same trajectory, in turn, in one process each and with kernels compiled before. Prints
processor seconds per million returns of both, which other work on the machine changes less than
wall time, their ratio, and the most memory that each process held. Two sides and one --memory show
whether memory is bounded: the larger file takes no more.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from statistics import median

from benchmarks.airborne.end_to_end import survey
from benchmarks.airborne.whole_survey import scene


def main(folder: Path, side_m: float, repeats: int, memory: str) -> None:
    """Print both times and their ratio."""
    content = scene(side_m)
    content["flights"] = [{"heading_deg": 0, "offset_m": 0}]
    workflow = survey(folder, f"one_pass_{side_m:g}", content)
    (source,) = workflow.parent.glob("flightlines/*.laz")
    trajectory = workflow.parent / "trajectory.csv"
    cloud, dtm = folder / "clean.laz", folder / "dtm.tif"
    bound = ("--memory", memory)
    ways: dict[str, list[object]] = {
        "run": ["run", workflow, "--fresh", *bound],
        "denoise": [
            *("denoise", source, cloud, "--trajectory", trajectory, "--ground", "--dtm", dtm),
            *("--force", *bound),
        ],
    }
    cost(ways["run"])  # compiles, and touches memory for the first time
    spent: dict[str, list[tuple[float, float]]] = {name: [] for name in ways}
    for _ in range(repeats):
        for name, arguments in ways.items():
            spent[name].append(cost(arguments))
    report = json.loads((workflow.parent / "out" / "report.json").read_text(encoding="utf-8"))
    millions = report["counts"]["points_in"] / 1e6
    print(f"{millions:.2f} M returns, median of {repeats}")
    found = {name: median(time_s for time_s, _ in each) / millions for name, each in spent.items()}
    for name, value in found.items():
        peak = max(mib for _, mib in spent[name])
        print(f"{name:8s}{value:7.2f} s of processor a million, {peak:6.0f} MiB at most")
    print(f"denoise / run: {found['denoise'] / found['run']:.2f}")


def cost(arguments: list[object]) -> tuple[float, float]:
    """Processor time [s] and largest memory [MiB] of a command in one process."""
    line = [sys.executable, "-m", "spl_batch", *map(str, arguments), "--workers", "0"]
    with tempfile.TemporaryFile("w+") as said:
        process = subprocess.Popen(line, stdout=said, stderr=said)  # noqa: S603
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode:
            said.seek(0)
            sys.exit(f"{' '.join(line)}: ended with {process.returncode}\n{said.read()}")
    return used.ru_utime + used.ru_stime, used.ru_maxrss / 1024


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--side-m", type=float, default=150.0)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--memory", default="16GiB")
    given = parser.parse_args()
    main(given.folder, given.side_m, given.repeats, given.memory)
