"""What the functions on arrays keep and remove, by how much they are told; against point truth.

Run ``python -m benchmarks.airborne.filter.from_arrays SURVEY [OF]``.

SURVEY is a folder that ``spl-batch simulate`` or ``spl-batch quickstart`` wrote. Of its points the
western part OF (0..1, all by default) is filtered: by coordinates alone, with the true mean
density, with times and channels, and with the positions of the sensor as well. Each line has the
share of ground, roofs, vegetation and wires that is kept, of background and afterpulses that is
removed, the expected noise density over the one that beams tell (median), and seconds of processor
time per million points.
"""

import sys
import time
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pyarrow.parquet as pq
from numpy.typing import NDArray

import spl_batch
from benchmarks.airborne.filter import methods

SHOWN = ("ground", "roof", "vegetation", "wire")


def main(folder: Path, share: float = 1.0) -> None:
    """Filter the points of one survey in each way."""
    points = _load(folder, share)
    xyz = np.stack([points[axis] for axis in "xyz"], axis=1)
    table = np.loadtxt(folder / "trajectory.csv", delimiter=",", skiprows=1)
    time_s = points["gps_time"]
    origin = np.stack([np.interp(time_s, table[:, 0], table[:, k]) for k in (1, 2, 3)], axis=1)
    shots: dict[str, Any] = {name: points[name] for name in ("gps_time", "channel", "flightline")}
    known = spl_batch.expected_noise(xyz, **shots, beam_origin=origin)
    ways: dict[str, dict[str, Any]] = {
        "coordinates alone": {},
        "one mean density": {"noise_density": float(known.density.mean())},
        "times and channels": shots,
        "and beam origins": {**shots, "beam_origin": origin},
    }
    print(f"{len(xyz)} points of {folder.name}")
    print(
        f"{'told':20s}"
        + "".join(f"{name:>12s}" for name in SHOWN)
        + f"{'background':>12s}{'afterpulse':>12s}{'density':>9s}{'s/million':>11s}"
    )
    spl_batch.filter_points(xyz[:20_000])  # compiled before anything is timed
    for name, told in ways.items():
        start = time.process_time()
        labels = spl_batch.filter_points(xyz, **told)
        seconds = time.process_time() - start
        print(_line(name, labels, points["kind"], known.mean, 1e6 * seconds / len(xyz)))
        for text in labels.warnings:
            print(f"    {text}")


def _load(folder: Path, share: float) -> dict[str, NDArray[Any]]:
    parts: dict[str, list[NDArray[Any]]] = {}
    for truth in sorted((folder / "truth").glob("line_*.parquet")):
        las = laspy.read(folder / "flightlines" / f"{truth.stem}.laz")
        columns = {axis: np.asarray(las[axis]) for axis in "xyz"}
        columns |= {"gps_time": np.asarray(las.gps_time), "channel": np.asarray(las.channel)}
        columns |= {"flightline": np.asarray(las.point_source_id)}
        columns |= {"kind": pq.read_table(truth)["kind"].to_numpy()}
        for name, values in columns.items():
            parts.setdefault(name, []).append(values)
    whole = {name: np.concatenate(values) for name, values in parts.items()}
    west, east = whole["x"].min(), whole["x"].max()
    chosen = whole["x"] <= west + share * (east - west)
    return {name: values[chosen] for name, values in whole.items()}


def _line(
    name: str,
    labels: spl_batch.Labels,
    kind: NDArray[Any],
    density: NDArray[np.float64],
    seconds: float,
) -> str:
    kinds = (*methods.KINDS, "bottom")
    kept = [100 * float(labels.signal[kind == kinds.index(one)].mean()) for one in SHOWN]
    gone = [
        100 * float((~labels.signal[kind == kinds.index(one)]).mean())
        for one in ("background", "afterpulse")
    ]
    ratio = float(np.median(labels.noise_density / np.maximum(density, 1e-9)))
    shares = "".join(f"{value:12.2f}" for value in (*kept, *gone))
    return f"{name:20s}{shares}{ratio:9.3f}{seconds:11.1f}"


if __name__ == "__main__":
    main(Path(sys.argv[1]), *map(float, sys.argv[2:]))
