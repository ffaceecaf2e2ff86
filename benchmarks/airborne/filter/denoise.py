"""Speed and agreement of the space-domain noise filter.

``python -m benchmarks.airborne.filter.denoise [POINTS]`` prints the seconds per million points of
the tree, the neighbours and the whole filter on one core, the ratio to scipy's cKDTree in
the same run, the labels of 20 000 points that differ from a slow twin's, full counts in
float64, with those of them that are ties within float error, for the calibrated test as for the
tail, and the share of pure noise that each test keeps. ``python -m
benchmarks.airborne.filter.denoise_steps`` splits the whole stage up.
"""

import argparse
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats
from scipy.spatial import cKDTree

from benchmarks.numerics.searches import nearest, nearest_sets
from spl_batch.airborne.filter.denoise import denoise
from spl_batch.airborne.filter.ellipsoid.null_distribution import null_table
from spl_batch.airborne.settings import FilterSettings, WireSettings
from spl_batch.lattice.tables import PointTable
from spl_batch.numerics.neighbours.kdtree import build

DENSITY = 0.13
"""Background of the scene [1/m3]."""

TAIL, CALIBRATED = (
    FilterSettings(test=test, wires=WireSettings(enabled=False)) for test in ("tail", "calibrated")
)
"""What the slow twin computes."""


def survey(n: int, seed: int = 0) -> NDArray[np.int64]:
    """Relief at 25 returns per m2, three wires and background, sorted [mm]: (about n, 3)."""
    rng = np.random.default_rng(seed)
    gate = 180.0
    side = np.sqrt(n / (25.0 + DENSITY * gate))
    ground = rng.uniform(0, side, (rng.poisson(25.0 * side**2), 3))
    ground[:, 2] = 4 * np.sin(ground[:, 0] / 37) + rng.normal(0, 0.05, len(ground))
    noise = rng.uniform(0, 1, (rng.poisson(DENSITY * gate * side**2), 3))
    noise = noise * [side, side, gate] - [0, 0, gate / 3]
    along = rng.uniform(0, 1, (3, rng.poisson(2.5 * side)))
    wires = [np.stack([u * side, 0 * u + 0.4 * side + 3 * i, 25 + 0 * u], axis=1)
             for i, u in enumerate(along)]  # fmt: skip
    wire = np.concatenate(wires) + rng.normal(0, 0.05, (along.size, 3))
    xyz = np.rint(np.concatenate([ground, noise, wire]) * 1000).astype(np.int64)
    return xyz[np.lexsort(xyz.T[::-1])]


def as_table(xyz: NDArray[np.int64]) -> PointTable:
    """Points as the filter takes them."""
    flags = np.zeros(len(xyz), dtype=np.uint8)
    return PointTable(
        {"x": xyz[:, 0], "y": xyz[:, 1], "z": xyz[:, 2].astype(np.int32), "flags": flags}
    )


TIE = 1e-9
"""Relative difference that float error may make."""


def slow_labels(
    xyz: NDArray[np.int64], settings: FilterSettings
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Signal or not by scipy's neighbours, numpy's eigenvectors and full counts; and ties.

    A tie is a point with another one on the surface of its ellipsoid, within :data:`TIE`.
    """
    points = xyz / 1000.0
    tree = cKDTree(points)
    spacing = tree.query(points, k=settings.spacing_neighbours + 1)[0][:, -1]
    spacing = np.minimum(spacing, settings.spacing_cap_m)
    score, tied = np.empty(len(points)), np.zeros(len(points), np.bool_)
    for i, near in enumerate(tree.query(points, k=settings.neighbours + 1)[1]):
        values, vectors = np.linalg.eigh(np.cov(points[near[near != i]].T, bias=True))
        spread = np.maximum(values, settings.eigen_floor_m**2)
        axes = settings.radius_m * spread / np.cbrt(spread.prod())
        axes = np.minimum(axes, settings.axis_cap_m)
        rows = np.array(tree.query_ball_point(points[i], axes.max()))
        rows = rows[spacing[rows] * settings.peer_ratio >= spacing[i]]
        around = points[rows] - points[i]
        flag = ((around @ vectors / axes) ** 2).sum(axis=1)
        tied[i] = np.any(np.abs(flag - 1) < TIE)
        count = (flag < 1).sum() - 1
        noise = DENSITY * 4 / 3 * np.pi * axes.prod()
        score[i] = stats.poisson.sf(count - 1, noise)
        if settings.test == "calibrated" and count > 0:
            outermost = flag[flag < 1].max() ** (1.5 * count)
            score[i] -= (1 - outermost) * stats.poisson.pmf(count, noise)
    alone, weak, link_m = _limits(settings)
    strong = score <= alone
    passed = np.flatnonzero(strong)
    linked = cKDTree(points[strong]).query_ball_point(points, link_m)
    links = np.array([
        (spacing[passed[rows]] * settings.peer_ratio >= spacing[i]).sum()
        for i, rows in enumerate(linked)
    ])  # fmt: skip
    signal: NDArray[np.bool_] = strong | ((score <= weak) & (links >= settings.link_count))
    return signal, tied


def _limits(settings: FilterSettings) -> tuple[float, float, float]:
    """Score that passes alone, score that passes with links, and how long these are [m]."""
    if settings.test == "tail":
        return settings.alpha / settings.selection, settings.weak_alpha, settings.link_m
    table, density = null_table(settings), np.array([DENSITY])
    alone = table.critical(density, table.alone(density, settings.alpha))
    weak = table.critical(density, settings.weak_alpha)
    link_m = np.minimum(table.link(density, settings.alpha), settings.link_m)
    return float(alone[0]), float(weak[0]), float(link_m[0])


def seconds_per_million(n: int, call: Callable[[], Any]) -> float:
    """Best processor time of three calls, after one that compiles."""
    call()
    best = np.inf
    for _ in range(3):
        start = time.process_time()
        call()
        best = min(best, time.process_time() - start)
    return best / n * 1e6


def kept_noise() -> None:
    """Share of uniform noise that each test keeps, borders left out."""
    rng = np.random.default_rng(1)
    n = 60_000
    tests: dict[str, dict[str, Any]] = {
        "published": {"test": "published"},
        "tail, uncorrected": {"test": "tail", "selection": 1.0, "link_count": 0},
        "tail": {"test": "tail"},
        "calibrated": {},
    }
    print("pure noise kept [%], alpha 0.001:  " + "  ".join(tests))
    for density in (0.02, 0.05, 0.13, 0.3, 1.0):
        side = (n / density) ** (1 / 3) * 1000
        table = as_table(np.rint(rng.uniform(0, side, (n, 3))).astype(np.int64))
        inner = np.all([np.abs(table[a] - side / 2) < 0.4 * side for a in "xyz"], axis=0)
        shares = [
            (denoise(table, np.full(n, density), inner, FilterSettings(**t))["noise_class"] == 0)
            for t in tests.values()
        ]
        print(f"{density:6.2f} /m3  " + "  ".join(f"{s.mean() * 100:8.3f}" for s in shares))


def compare_labels(xyz: NDArray[np.int64], settings: FilterSettings) -> None:
    """Labels that differ from the slow twin's, and ties."""
    every = np.ones(len(xyz), dtype=np.bool_)
    fast = denoise(as_table(xyz), np.full(len(xyz), DENSITY), every, settings)["noise_class"] == 0
    slow, tied = slow_labels(xyz, settings)
    differ = fast != slow
    print(
        f"labels of the test {settings.test} that differ from the slow twin's: {differ.sum()} of "
        f"{len(xyz)}, of them {(differ & tied).sum()} ties; ties in all: {tied.sum()}"
    )


def main(points: int) -> None:
    """Print everything."""
    xyz = survey(points)
    n = len(xyz)
    local = (xyz - xyz.min(axis=0)).astype(np.int32)
    metres = xyz / 1000.0
    table, density, every = as_table(xyz), np.full(n, DENSITY), np.ones(n, dtype=np.bool_)
    reference = cKDTree(metres)
    ours = {
        "build tree": seconds_per_million(n, lambda: build(local)),
        "6 nearest, sorted": seconds_per_million(n, lambda: nearest(local, every, 6, 12_000)),
        "6 nearest": seconds_per_million(n, lambda: nearest_sets(local, every, 6, 12_000)),
        "15 nearest, sorted": seconds_per_million(n, lambda: nearest(local, every, 15, 12_000)),
        "15 nearest": seconds_per_million(n, lambda: nearest_sets(local, every, 15, 12_000)),
        "25 nearest, sorted": seconds_per_million(n, lambda: nearest(local, every, 25, 12_000)),
        "25 nearest": seconds_per_million(n, lambda: nearest_sets(local, every, 25, 12_000)),
        "whole filter": seconds_per_million(
            n, lambda: denoise(table, density, every, FilterSettings())
        ),
    }
    scipy = seconds_per_million(n, lambda: reference.query(metres, k=16))
    print(f"{n} points, seconds per million on one core")
    for name, seconds in ours.items():
        print(f"{name:18s} {seconds:6.2f}   {seconds / scipy:5.2f} x cKDTree")
    print(f"{'cKDTree, k=15':18s} {scipy:6.2f}")
    small = survey(20_000, seed=2)
    for settings in (TAIL, CALIBRATED):
        compare_labels(small, settings)
    kept_noise()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("points", nargs="?", type=int, default=500_000)
    main(parser.parse_args().points)
