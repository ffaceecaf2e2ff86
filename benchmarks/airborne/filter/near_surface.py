"""Near surfaces and at the edges of things: what each filter keeps and loses, against point truth.

``python -m benchmarks.airborne.filter.near_surface [--folder FOLDER] [--seeds 1] [--extent 60 50]``
simulates
scenes with roofs, trees, poles and wires (into FOLDER, where what is there is used again), runs
the published method, the calibrated test and the whole filter, and prints percentages:

- background returns kept, by distance to the nearest true return of anything else: of all, and of
  those whose nearest is at a roof's edge, of a pole or tower, of thin vegetation;
- true returns lost: at roofs by distance in plan from the edge (the nearest ground return), of
  poles and vegetation by distance to the nearest surface, a return of ground or roof;
- true returns lost by kind.

Thin vegetation has fewer than eight returns of vegetation within 1 m. Walls are no poles: those
have no roof within 3 m in plan.
"""

import argparse
import tempfile
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from benchmarks.airborne.filter.methods import (
    BACKGROUND,
    GROUND,
    OTHER,
    ROOF,
    VEGETATION,
    WATER,
    WIRE,
    Columns,
    is_noise,
    judge,
    known_methods,
    load_truth,
    make_survey,
)
from benchmarks.airborne.published.twins import ordinary_wires
from spl_batch.airborne.simulate.scene.scene_file import Scene, parse_scene

FILTERS = ("published", "calibrated", "ours")
"""By name in :func:`benchmarks.airborne.filter.methods.known_methods`."""

NOISE_M = (0.0, 0.15, 0.3, 0.6, 1.0, 1.5, 2.0, 3.0, 5.0, 10.0, np.inf)
EDGE_M = (0.0, 0.25, 0.5, 1.0, 2.0, 4.0, np.inf)
POLE_M = (0.0, 1.0, 2.0, 4.0, 6.0, 8.0, 12.0, 20.0, np.inf)
TREE_M = (0.0, 1.0, 2.0, 4.0, 6.0, 8.0, 12.0, np.inf)
"""Bins of distances."""

AT_EDGE_M = 0.5
"""A return of a roof so near to its edge is at it [m]."""
WALL_M = 3.0
THIN_M, THIN = 1.0, 8

KINDS = {GROUND: "ground", ROOF: "roof", VEGETATION: "vegetation", WIRE: "wire", OTHER: "other",
         WATER: "water"}  # fmt: skip

Bools = NDArray[np.bool_]
Floats = NDArray[np.float64]


class Curve(NamedTuple):
    """Some returns by a distance.

    Parameters
    ----------
    of : (n,) bool
        Which returns.
    distance : (n,) float64
        [m]; matters where ``of``.
    edges : tuple of float
        Bins of the distance [m].
    """

    of: Bools
    distance: Floats
    edges: tuple[float, ...]


class Counts(NamedTuple):
    """Returns of a bin, and how many of them each filter keeps [count]."""

    label: str
    number: int
    kept: tuple[int, ...]


def scene(seed: int, extent_m: tuple[float, float]) -> Scene:
    """Ordinary wires with more trees, and roofs flat, gabled and shed between the lines."""
    content = ordinary_wires(seed, extent_m).model_dump(mode="json", by_alias=True)
    rng = np.random.default_rng([seed, 1])
    roofs = [
        {
            "centre_m": [east * extent_m[0], north * extent_m[1]], "size_m": [14.0, 10.0],
            "heading_deg": float(rng.uniform(0, 180)), "eave_m": float(rng.uniform(4, 8)),
            "roof": roof,
        }
        for east, north, roof in ((0.2, 0.36, "flat"), (0.5, 0.62, "gable"), (0.8, 0.36, "shed"))
    ]  # fmt: skip
    content |= {"name": "near surfaces", "buildings": {"list": roofs}, "trees": {"cover": 0.2}}
    return parse_scene(content, "near surfaces")


def curves(points: Columns) -> dict[str, Curve]:
    """What is told by distance, from returns with their truth; names begin with what is told."""
    xyz, kind = _places(points), points["kind"]
    true = ~is_noise(kind)
    surface = np.isin(kind, (GROUND, ROOF))
    from_edge = _distance(xyz[:, :2], kind == ROOF, kind == GROUND)
    from_surface = _distance(xyz, true & ~surface, surface)
    pole = (kind == OTHER) & (_distance(xyz[:, :2], kind == OTHER, kind == ROOF) > WALL_M)
    thin = _thin(xyz, kind == VEGETATION)
    at_edge = (kind == ROOF) & (from_edge < AT_EDGE_M)
    noise = kind == BACKGROUND
    distance = np.full(len(kind), np.inf)
    distance[noise], row = cKDTree(xyz[true]).query(xyz[noise])
    nearest = np.full(len(kind), -1)
    nearest[noise] = np.flatnonzero(true)[row]
    found = {"noise": Curve(noise, distance, NOISE_M)}
    for name, mask in (("roof edges", at_edge), ("poles", pole), ("thin vegetation", thin)):
        found[f"noise nearest to {name}"] = Curve(noise & mask[nearest], distance, NOISE_M[:-1])
    return {
        **found,
        "roofs, from the edge in plan": Curve(kind == ROOF, from_edge, EDGE_M),
        "poles, from ground or roof": Curve(pole, from_surface, POLE_M),
        "vegetation, from ground or roof": Curve(kind == VEGETATION, from_surface, TREE_M),
        "thin vegetation, from ground or roof": Curve(thin, from_surface, TREE_M),
    }


def _thin(xyz: Floats, vegetation: Bools) -> Bools:
    trees = np.flatnonzero(vegetation)
    crowd = cKDTree(xyz[trees]).query_ball_point(xyz[trees], THIN_M, return_length=True)
    thin = np.zeros(len(xyz), dtype=np.bool_)
    thin[trees] = crowd - 1 < THIN
    return thin


def _distance(xyz: Floats, of: Bools, to: Bools) -> Floats:
    """From some returns to the nearest of others [m]; infinite elsewhere."""
    out = np.full(len(xyz), np.inf)
    out[of] = cKDTree(xyz[to]).query(xyz[of])[0]
    return out


def _places(points: Columns) -> Floats:
    xyz = np.column_stack([points[axis] for axis in "xyz"])
    low: Floats = xyz.min(axis=0)
    return xyz - low


def measure(
    folder: Path, seeds: Sequence[int], extent_m: tuple[float, float]
) -> dict[str, list[Counts]]:
    """Simulate and filter; by name of curve its bins, and at last the kinds of returns."""
    known = known_methods()
    pooled: dict[str, list[Counts]] = {}
    for seed in seeds:
        survey = make_survey(scene(seed, extent_m), folder / f"near_{seed}")
        points = load_truth(survey)
        kept = [judge(survey, known[name]) == 0 for name in FILTERS]
        for name, row in _counts(points, kept).items():
            before = pooled.get(name, [Counts(c.label, 0, (0,) * len(kept)) for c in row])
            pooled[name] = [
                Counts(a.label, a.number + b.number,
                       tuple(x + y for x, y in zip(a.kept, b.kept, strict=True)))
                for a, b in zip(before, row, strict=True)
            ]  # fmt: skip
    return pooled


def _counts(points: Columns, kept: Sequence[Bools]) -> dict[str, list[Counts]]:
    out = {}
    for name, (of, distance, edges) in curves(points).items():
        bins = np.where(of, np.digitize(distance, edges) - 1, -1)
        out[name] = [_count(_bin(*pair), bins == k, kept) for k, pair in enumerate(pairwise(edges))]
    out["all, by kind"] = [_count(n, points["kind"] == k, kept) for k, n in KINDS.items()]
    return out


def _bin(low: float, high: float) -> str:
    return f"{low:g}-{high:g} m" if np.isfinite(high) else f"> {low:g} m"


def _count(label: str, mask: Bools, kept: Sequence[Bools]) -> Counts:
    return Counts(label, int(mask.sum()), tuple(int((k & mask).sum()) for k in kept))


def shares(name: str, row: Counts) -> list[float]:
    """Percentage of noise kept, or of other returns lost, by each filter."""
    kept = [100 * k / row.number if row.number else np.nan for k in row.kept]
    return kept if name.startswith("noise") else [100 - k for k in kept]


def main(folder: Path, seeds: Sequence[int], extent_m: tuple[float, float]) -> None:
    """Print a table for each curve."""
    labels = [known_methods()[name].label for name in FILTERS]
    for name, rows in measure(folder, seeds, extent_m).items():
        what = "kept [%]" if name.startswith("noise") else "lost [%]"
        print(f"\n{f'{name}: {what}':46s}{'returns':>9s}" + "".join(f"{n:>24s}" for n in labels))
        for row in rows:
            if row.number:
                text = "".join(f"{share:24.2f}" for share in shares(name, row))
                print(f"{row.label:46s}{row.number:9d}{text}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--folder", type=Path)
    parser.add_argument("--seeds", type=int, nargs="+", default=[1])
    parser.add_argument("--extent", type=float, nargs=2, default=(60.0, 50.0))
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        main(options.folder or Path(scratch), options.seeds, tuple(options.extent))
