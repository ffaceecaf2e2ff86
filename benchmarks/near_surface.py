"""Noise near surfaces, and the edges of things: what each filter keeps, against point truth.

``python -m benchmarks.near_surface [--folder FOLDER] [--seeds 1 2] [--extent 90 70]`` simulates
scenes with roofs, trees, poles and wires (into FOLDER, where what is there is used again), runs
the published test, the corrected tail and the calibrated one, and prints two tables in percent:

- background returns kept, by the distance to the nearest true return of anything else, and by
  what that is;
- true returns lost, by kind, at roof edges (a lower return within 0.5 m in plan) and where
  vegetation is thin (fewer than eight returns of vegetation within 1 m).
"""

import argparse
import tempfile
from collections.abc import Mapping, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from benchmarks.methods import (
    AFTERPULSE,
    BACKGROUND,
    GROUND,
    OTHER,
    ROOF,
    VEGETATION,
    WATER,
    WIRE,
    Columns,
    judge,
    known_methods,
    load_truth,
    make_survey,
)
from benchmarks.twins import ordinary_wires

DISTANCES_M = (0.0, 0.3, 1.0, 3.0, 10.0, np.inf)
EDGE_M = 0.5
DROP_M = 1.5
"""A return this much lower beside a roof's is not of the roof [m]."""

THIN_M, THIN = 1.0, 8

NAMES = {GROUND: "ground", ROOF: "roof", VEGETATION: "vegetation", WIRE: "wire", OTHER: "pole"}

Strata = Mapping[str, NDArray[np.bool_]]


def noise_strata(points: Columns) -> Strata:
    """Background returns by distance and by the kind of the nearest other return."""
    xyz, kind = _places(points), points["kind"]
    true = ~np.isin(kind, (BACKGROUND, AFTERPULSE))
    noise = np.flatnonzero(kind == BACKGROUND)
    distance, nearest = cKDTree(xyz[true]).query(xyz[noise], distance_upper_bound=DISTANCES_M[-2])
    other = np.append(kind[true], BACKGROUND)[nearest]
    strata = {}
    for low, high in pairwise(DISTANCES_M):
        near = (distance >= low) & ((distance < high) | np.isinf(high))
        name = f"{low:g}-{high:g} m" if np.isfinite(high) else f"> {low:g} m"
        groups = {"all": near}
        if np.isfinite(high):
            groups |= {label: near & (other == code) for code, label in NAMES.items()}
        for label, rows in groups.items():
            mask = np.zeros(len(kind), dtype=np.bool_)
            mask[noise[rows]] = True
            strata[f"{name:>8s} {label}"] = mask
    return strata


def signal_strata(points: Columns) -> Strata:
    """True returns by kind, at roof edges and where vegetation is thin."""
    xyz, kind = _places(points), points["kind"]
    strata = {label: kind == code for code, label in {**NAMES, WATER: "water"}.items()}
    true = ~np.isin(kind, (BACKGROUND, AFTERPULSE))
    roofs, around = np.flatnonzero(kind == ROOF), np.flatnonzero(true)
    edge = np.zeros(len(kind), dtype=np.bool_)
    plan = cKDTree(xyz[around, :2]).query_ball_point(xyz[roofs, :2], EDGE_M)
    for row, rows in zip(roofs, plan, strict=True):
        edge[row] = bool((xyz[around[rows], 2] < xyz[row, 2] - DROP_M).any())
    strata["roof within 0.5 m of an edge"] = edge
    trees = np.flatnonzero(kind == VEGETATION)
    tree = cKDTree(xyz[trees])
    thin = np.zeros(len(kind), dtype=np.bool_)
    crowd = tree.query_ball_point(xyz[trees], THIN_M, return_length=True)
    thin[trees] = crowd - 1 < THIN
    strata["thin vegetation"] = thin
    return strata


def _places(points: Columns) -> NDArray[np.float64]:
    xyz = np.column_stack([points[axis] for axis in "xyz"])
    low: NDArray[np.float64] = xyz.min(axis=0)
    return xyz - low


def table(
    title: str, labels: Sequence[str], counts: Mapping[str, Sequence[tuple[int, int]]]
) -> None:
    """One row for each stratum, one column for each method."""
    print(f"\n{title:34s}{'points':>9s}" + "".join(f"{label:>24s}" for label in labels))
    for name, row in counts.items():
        if row and row[0][1]:
            shares = "".join(f"{100 * part / whole:24.2f}" for part, whole in row)
            print(f"{name:34s}{row[0][1]:9d}{shares}")


def main(folder: Path, seeds: Sequence[int], extent_m: tuple[float, float]) -> None:
    """Simulate, filter and print."""
    known = known_methods()
    methods = [known[n] for n in ("published", "tail", "calibrated", "ours") if n in known]
    noise: dict[str, list[list[int]]] = {}
    signal: dict[str, list[list[int]]] = {}
    for seed in seeds:
        survey = make_survey(ordinary_wires(seed, extent_m), folder / f"near_{seed}")
        points = load_truth(survey)
        groups = (noise, noise_strata(points)), (signal, signal_strata(points))
        for column, method in enumerate(methods):
            kept = judge(survey, method) == 0
            for tally, strata in groups:
                for name, mask in strata.items():
                    cells = tally.setdefault(name, [[0, 0] for _ in methods])
                    counted = kept if tally is noise else ~kept
                    cells[column][0] += int((counted & mask).sum())
                    cells[column][1] += int(mask.sum())
    labels = [method.label for method in methods]
    for title, tally in (("noise kept [%]", noise), ("true returns lost [%]", signal)):
        table(title, labels, {n: [(a, b) for a, b in c] for n, c in tally.items()})


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--folder", type=Path)
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--extent", type=float, nargs=2, default=(90.0, 70.0))
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        main(options.folder or Path(scratch), options.seeds, tuple(options.extent))
