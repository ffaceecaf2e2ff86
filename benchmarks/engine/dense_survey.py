"""A dense survey with little memory, and the same with much.

Run ``python -m benchmarks.engine.dense_survey FOLDER [--side 226] [--memory 1GiB]``.

Six flightlines of 25 returns per m2 lie over one square of open ground, crowns and roofs. One
worker runs the survey with 8 GiB and with the limit: peak memory by stage, time, and whether
rasters and delivered clouds have the same bytes. No filter is asked for: what is looked at is the
memory of ground cells, which hold most.
"""

import argparse
from pathlib import Path

import laspy
import numpy as np
import yaml
from numpy.typing import NDArray
from pyproj import CRS

from spl_batch import api

LINES = 6
"""Flightlines [count]."""

PER_M2 = 25.0
"""Returns of each [1/m2]."""

SECOND = 0.15
"""Share of the pulses that return twice."""

SPEED_M_S, PRF_HZ = 60.0, 50_000.0
MIDDLE_M = (272_100.0, 3_290_100.0)
ROOF_M = 32.0
ROUGH_M = 0.03

Float = NDArray[np.float64]


def terrain(x: Float, y: Float) -> Float:
    """Height of the ground [m]."""
    found: Float = 20.0 + 4.0 * np.sin(x / 40) + 3.0 * np.cos(y / 55)
    return found


def flightline(path: Path, line: int, side_m: float) -> int:
    """Write one flightline; how many returns it has."""
    rng = np.random.default_rng(line)
    pulses = int(PER_M2 / (1 + SECOND) * side_m**2)
    along, across = np.sort(rng.random(pulses)) * side_m, rng.random(pulses) * side_m
    x, y = (along, across) if line % 2 else (across, along)
    z = terrain(x, y) + rng.normal(0, ROUGH_M, pulses)
    crown = np.flatnonzero((np.sin(x / 17) * np.cos(y / 13) > 0.45) & (rng.random(pulses) < 0.8))
    z[crown] += rng.random(len(crown)) * 12
    roof = (np.floor(x / 25) % 4 == 1) & (np.floor(y / 25) % 4 == 1)
    z[roof] = ROOF_M + rng.normal(0, ROUGH_M, int(roof.sum()))
    time = 1000.0 + line * 100 + np.floor(along / SPEED_M_S * PRF_HZ) / PRF_HZ
    second = crown[: int(SECOND * pulses)]
    rows = np.concatenate([np.arange(pulses), second])
    below = terrain(x[second], y[second]) + rng.normal(0, ROUGH_M, len(second))
    order = np.argsort(time[rows], kind="stable")
    twice = np.isin(rows, second)
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales, header.offsets = np.full(3, 0.001), np.array([*MIDDLE_M, 0.0])
    header.add_crs(CRS.from_epsg(6344))
    header.add_extra_dim(laspy.ExtraBytesParams("channel", np.uint8))
    las = laspy.LasData(header)
    las.x = (x[rows] - side_m / 2 + MIDDLE_M[0])[order]
    las.y = (y[rows] - side_m / 2 + MIDDLE_M[1])[order]
    las.z = np.concatenate([z, below])[order]
    las.gps_time = time[rows][order]
    las["channel"] = rng.integers(1, 101, pulses)[rows][order]
    las.return_number = np.repeat([1, 2], [pulses, len(second)])[order]
    las.number_of_returns = (1 + twice)[order]
    las.point_source_id = np.full(len(rows), line, np.uint16)
    las.intensity = rng.integers(1, 999, len(rows)).astype(np.uint16)
    las.write(path)
    return len(rows)


def contents(output: Path) -> dict[str, bytes]:
    """Rasters and clouds that a run delivered."""
    found = [*output.glob("*.tif"), *output.glob("laz/**/*.laz")]
    return {str(path.relative_to(output)): path.read_bytes() for path in found}


def main() -> None:
    """Read the arguments."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--side", type=float, default=226.0)
    parser.add_argument("--memory", default="1GiB")
    given = parser.parse_args()
    lines = given.folder / "flightlines"
    lines.mkdir(parents=True, exist_ok=True)
    points = sum(
        flightline(lines / f"line_{line}.laz", line, given.side) for line in range(1, LINES + 1)
    )
    print(f"{points:,} returns, {points / given.side**2:.0f} per m2")
    workflow = given.folder / "workflow.yaml"
    survey = {"flightlines": "flightlines/*.laz", "sensor": "spl100"}
    content = {
        "survey": {**survey, "channel_dimension": "channel"},
        "filter": {"method": "none"},
        "afterpulse": {"enabled": False},
    }
    delivered = []
    for memory in ("8GiB", given.memory):
        workflow.write_text(yaml.safe_dump({**content, "output": memory}), encoding="utf-8")
        result = api.run(workflow, workers=1, memory=memory)
        if result.exit_status or result.report is None:
            raise SystemExit(f"--memory {memory}: the run failed")
        delivered.append(contents(result.output))
        stages = result.report.performance.stages.items()
        told = (f"{name} {stage.peak_rss_mb or 0:.0f} MiB {stage.wall_s:.0f} s"
                for name, stage in stages)  # fmt: skip
        print(f"--memory {memory}: {', '.join(told)}", flush=True)
    print(f"{len(delivered[0])} files, {'the same' if delivered[0] == delivered[1] else 'OTHER'}"
          " bytes")  # fmt: skip


if __name__ == "__main__":
    main()
