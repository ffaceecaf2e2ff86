"""What decides how much of a wire the differential cell count keeps.

Run ``python -m benchmarks.airborne.published.tables dcc``.

[W17] Eq. 3.3 asks each shot alone for K returns in 5 m of range. Here the wires of Easton's twin
are made thicker, and detection and false alarms of the corridors of 7 m x 7 m stand beside K and
beside the returns that a wire has in one bin of one shot, as a return of the wire meets them. The
last columns count without the law: what any fixed number of returns would detect on the wires as
they are. Only the kernel runs, so that the table takes seconds.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.airborne.beams.trajectories import read_trajectory
from benchmarks.airborne.filter import methods
from benchmarks.airborne.filter.methods import BACKGROUND, WIRE, Columns
from benchmarks.airborne.published import corridors
from benchmarks.airborne.published.corridors import Counts
from benchmarks.airborne.published.table_wires import CLOSE_M, PUBLISHED
from benchmarks.airborne.published.twins import easton_bright
from spl_batch.airborne.beams.differential_cell_count import dcc_threshold
from spl_batch.airborne.beams.shot_runs import run_starts
from spl_batch.airborne.filter.published.dcc_shots import keep_by_shot

THICKER = (1.0, 4.0, 8.0)
"""Diameters of wires over those of the twin."""

TWINS = {1.0: "easton", 4.0: "bright"}
"""Surveys that :mod:`benchmarks.airborne.published.table_wires` has as well."""

COARSE_M, FINE_M, GATE_M = 30.0, 5.0, 300.0
"""[W17] 3.2.3, 6.3 [m]."""

FIXED = (2, 3, 4, 5)
"""Least returns of a bin, without the law [count]."""


class Shots(NamedTuple):
    """Returns of a survey, shot by shot.

    Parameters
    ----------
    points : dict
        As :func:`benchmarks.airborne.filter.methods.load_truth` gives them, by shot and range.
    starts : (m + 1,) int64
        Rows where shots start, then n.
    range_m : (n,) float64
        Slant ranges [m].
    """

    points: Columns
    starts: NDArray[np.int64]
    range_m: NDArray[np.float64]


def dcc_table(folder: Path, seeds: Sequence[int]) -> dict[tuple[float, str], dict[str, float]]:
    """Print the table, pooled over seeds; figures by thickness and kind of line."""
    said = {kind: PUBLISHED["easton", kind]["dcc"] for kind in ("transmission", "distribution")}
    print(
        "\nDifferential cell count on Easton's twin, wires made thicker [%; K, wire: returns of a"
    )
    print("bin of a shot, median; returns per metre of the line and flightline]; detected by a")
    print("fixed number. [W17] Tables 6-1 and 6-2: " + ", ".join(
        f"{kind} {c.detection:.1f} detected, {c.false_alarm:.1f} false"
        for kind, c in said.items()))  # fmt: skip
    names = ("per m", "wire", "K", "detected", "false al.", "by eye")
    print(f"{'':20s}" + "".join(f"{n:>10s}" for n in (*names, *(f"K = {k}" for k in FIXED))))
    out = {}
    for thicker in THICKER:
        rows: dict[str, list[NDArray[np.float64]]] = {}
        for seed in seeds:
            name = TWINS.get(thicker, f"bright_{thicker:g}")
            survey = methods.make_survey(easton_bright(seed, thicker), folder / f"{name}_{seed}")
            for kind, row in _measure(survey, load(survey)).items():
                rows.setdefault(kind, []).append(row)
        for kind, found in rows.items():
            figures = np.mean(found, axis=0)
            out[thicker, kind] = dict(zip((*names, *map(str, FIXED)), figures, strict=True))
            print(f"{f'{thicker:g} x {kind}':20s}" + "".join(f"{v:10.1f}" for v in figures))
    return out


def load(survey: Path) -> Shots:
    """A simulated survey by shots."""
    points = methods.load_truth(survey)
    flown = read_trajectory(
        [survey / "trajectory.csv"], survey_crs=None, trajectory_crs=None
    ).trajectory
    sensor = [np.interp(points["gps_time"], flown.time_s, flown.xyz_m[:, k]) for k in range(3)]
    range_m = np.sqrt(sum((points[a] - s) ** 2 for a, s in zip("xyz", sensor, strict=True)))
    order = np.lexsort([range_m, points["gps_time"]])
    points = {name: values[order] for name, values in points.items()}
    return Shots(points, run_starts(points["gps_time"]), range_m[order])


def kept(shots: Shots) -> NDArray[np.bool_]:
    """What the filter keeps: (n,) bool."""
    keep = np.empty(len(shots.range_m), dtype=np.bool_)
    keep_by_shot(shots.starts, shots.range_m, GATE_M, COARSE_M, FINE_M, keep)
    return keep


def thresholds(shots: Shots) -> NDArray[np.float64]:
    """K of each shot [count], by the source's counts: (m,) float64."""
    out = np.empty(len(shots.starts) - 1)
    for m in range(len(out)):
        bins = np.floor(shots.range_m[shots.starts[m] : shots.starts[m + 1]] / COARSE_M)
        values, counts = np.unique(bins, return_counts=True)
        near = int((np.abs(bins - values[counts.argmax()]) <= 1).sum())
        noise = max(len(bins) - near, 0.5) * FINE_M / (GATE_M - 3 * COARSE_M)
        out[m] = dcc_threshold(near / 3.0, noise, GATE_M / FINE_M)
    return out


def in_bin(shots: Shots, mask: NDArray[np.bool_]) -> NDArray[np.int64]:
    """How many returns of a mask lie in each return's own bin of its shot: (n,) int64."""
    shot = np.repeat(np.arange(len(shots.starts) - 1), np.diff(shots.starts))
    fine = np.floor(shots.range_m / FINE_M).astype(np.int64)
    _, of_bin = np.unique(shot * 1_000_000 + fine, return_inverse=True)
    count: NDArray[np.int64] = np.bincount(of_bin, weights=mask).astype(np.int64)[of_bin]
    return count


def _measure(survey: Path, shots: Shots) -> dict[str, NDArray[np.float64]]:
    """A row of figures by kind of line."""
    points, keep = shots.points, kept(shots)
    of_wire, of_all = in_bin(shots, points["kind"] == WIRE), in_bin(shots, np.ones_like(keep))
    typical = float(np.median(thresholds(shots)))
    lines = len(np.unique(points["line"]))
    out = {}
    for kind, spans in corridors.lines(survey):
        within = corridors.region(spans, points)
        far = corridors.nearest_m(spans, points) > CLOSE_M
        counts: Counts = corridors.count(points, keep, within)
        wire = within & (points["kind"] == WIRE)
        plain = int((keep & within & far & (points["kind"] == BACKGROUND)).sum())
        east = np.ptp(points["x"][wire])
        out[kind] = np.array([
            counts.wire / east / lines, np.median(of_wire[wire]), typical, counts.detection,
            counts.false_alarm, 100.0 * plain / max(counts.wire_kept + counts.noise_kept, 1),
            *(100.0 * float((of_all[wire] >= k).mean()) for k in FIXED),
        ])  # fmt: skip
    return out
