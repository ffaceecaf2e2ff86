"""What planning costs, and what is planned.

    python -m benchmarks.airborne.plan.plan_scale [--files N] [--points N] [--side-m M] [--memory
    SIZE]

Writes LAS files that are a header and a hole, in strips of half overlap over a square, 2 000 over
100 km by 100 km by default, and runs ``spl-batch plan`` on them as a process of its own: its
output, its time and its peak memory. ``--memory`` is a worker's: it and the density of a survey
decide how large blocks are and how much they read with their halos.
"""

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import laspy
import numpy as np
from pyproj import CRS

from spl_batch.constants import QUANTUM_M

SIDE_M = 100_000.0
"""Edge of the surveyed square."""

OVERLAP = 2.0
"""Times that a place is flown over."""

RECORD_BYTES = 30
"""A point of format 6 [byte]."""


def write_survey(folder: Path, files: int, points: int, side_m: float = SIDE_M) -> Path:
    """Write headers that tell of a survey, and its workflow; the points are holes on disk.

    Parameters
    ----------
    folder : Path
        Where to.
    files, points : int
        Files, and points in each [count].
    side_m : float
        Edge of the surveyed square [m].
    """
    lines = max(round(np.sqrt(files / 20)) * 2, 1)
    pieces = -(-files // lines)
    width, length = OVERLAP * side_m / lines, side_m / pieces
    for k in range(files):
        line, piece = divmod(k, pieces)
        low = (272_000.0 + piece * length, 3_290_000.0 + line * side_m / lines, 0.0)
        high = (low[0] + length, min(low[1] + width, 3_290_000.0 + side_m), 100.0)
        _write_header(folder / f"line_{line:04d}_{piece:03d}.las", points, low, high)
    workflow = folder / "workflow.yaml"
    workflow.write_text('survey: {flightlines: "*.las"}\noutput: out\n', encoding="utf-8")
    return workflow


def _write_header(
    path: Path, points: int, low: tuple[float, float, float], high: tuple[float, float, float]
) -> None:
    header = laspy.LasHeader(version="1.4", point_format=6)
    header.scales = np.full(3, QUANTUM_M)
    header.offsets = np.array([0.0, 3_000_000.0, 0.0])
    header.global_encoding.gps_time_type = laspy.header.GpsTimeType.STANDARD
    header.add_crs(CRS.from_epsg(32615))
    header.mins, header.maxs = np.array(low), np.array(high)
    header.point_count = points
    header.number_of_points_by_return[0] = points
    with path.open("wb") as stream:
        header.write_to(stream)
        stream.truncate(stream.tell() + points * RECORD_BYTES)


def main() -> None:
    """Write a survey and plan it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--files", type=int, default=2000)
    parser.add_argument("--points", type=int, default=100_000_000)
    parser.add_argument("--side-m", type=float, default=SIDE_M)
    parser.add_argument("--memory", help="of a worker, as the command chooses it by default")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        workflow = write_survey(Path(folder), given.files, given.points, given.side_m)
        start = time.perf_counter()
        command = [sys.executable, "-m", "spl_batch", "plan", str(workflow)]
        command += ["--memory", given.memory] if given.memory else []
        process = subprocess.Popen(command)  # noqa: S603 - our own command
        _, status, usage = os.wait4(process.pid, 0)
        wall = time.perf_counter() - start
    ended = os.waitstatus_to_exitcode(status)
    print(
        f"{given.files} files: {wall:.1f} s wall, {usage.ru_utime + usage.ru_stime:.1f} s of a "
        f"processor, {usage.ru_maxrss / 1024:.0f} MiB, exit status {ended}"
    )


if __name__ == "__main__":
    main()
