"""Weak and ordinary wires: what each filter keeps, against point truth.

``python -m benchmarks.airborne.filter.wires [--folder FOLDER] [--seeds 1 2 3] [--scenes weak
ordinary] [--methods published ours] [--classes]`` simulates the scenes of
:mod:`benchmarks.airborne.published.twins` for
each seed (into FOLDER, where what is there is used again), runs each filter and prints percentages:
wire returns kept, of each line and of all; background returns kept, all of them and those farther
than 5 m from every true return of anything else (the filter's false alarms where nothing vouches
for them); roofs, ground, vegetation and poles kept. A last line of each method pools the seeds.

With ``--classes`` it runs the whole chain with ``filter.wires.classify: true`` instead, on the same
scenes and on one without wires, and prints for class 14 its precision (class 14 that is wire), its
recall (wire that is class 14), and what the rest of it is; ``--extent`` makes the scenes smaller.
"""

import argparse
import tempfile
from collections.abc import Sequence
from pathlib import Path

import laspy
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from benchmarks.airborne.filter import methods
from benchmarks.airborne.filter.methods import (
    BACKGROUND,
    GROUND,
    KINDS,
    OTHER,
    ROOF,
    VEGETATION,
    WIRE,
    Columns,
    Method,
    is_noise,
)
from benchmarks.airborne.published import corridors
from benchmarks.airborne.published.twins import TWINS, ordinary_wires, weak_wires
from spl_batch import api
from spl_batch.airborne.simulate.scene.scene_file import Scene, parse_scene
from spl_batch.constants import CLASS_WIRE

FAR_M = 5.0
"""Background farther than this from every true return is pure noise [m]. Afterpulses are none:
background has its own, which lie everywhere."""

THIN_M = 0.5
"""Returns are thinned to cells of this size before distances to them are taken [m]."""

BARS = {"weak": (75.0, 0.5), "ordinary": (98.0, 0.5)}
"""Wire returns kept at least, pure noise kept at most [%]."""

NEAR_M = 1.0
"""A wire return belongs to the line with a strand within this distance of it [m]."""

CLASSED = ("weak", "ordinary", "none")
"""Scenes for class 14; the last one has roofs, trees and a lake, and no wires."""

EXTENT_M = (160.0, 100.0)
ROOF_M2 = 1600.0
"""Size of a scene [m], and its area for each roof where there are no wires [m2]."""

Tally = dict[str, tuple[int, int]]


def main(folder: Path, scenes: Sequence[str], seeds: Sequence[int], names: Sequence[str]) -> None:
    """Print one table for each scene."""
    known = methods.known_methods()
    for scene in scenes:
        tallies: dict[str, list[Tally]] = {name: [] for name in names}
        for seed in seeds:
            survey = methods.make_survey(TWINS[scene](seed), folder / f"{scene}_{seed}")
            groups = strata(survey, methods.load_truth(survey))
            if seed == seeds[0]:
                _head(scene, list(groups))
            for name in names:
                kept = methods.judge(survey, known[name]) == 0
                tally = {g: (int((kept & m).sum()), int(m.sum())) for g, m in groups.items()}
                tallies[name].append(tally)
                _row(known[name], f"seed {seed}", [tally])
        for name in names:
            if len(seeds) > 1:
                _row(known[name], "pooled", tallies[name])


def classes(
    folder: Path, scenes: Sequence[str], seeds: Sequence[int], extent_m: tuple[float, float]
) -> None:
    """Print precision and recall of class 14."""
    print(f"scenes of {extent_m[0]:g} m x {extent_m[1]:g} m")
    names = f"{'scene':12s}{'seed':>5s}{'wires':>8s}{'recall %':>10s}"
    print(f"{names}{'class 14':>10s}{'precision %':>13s}  rest")
    for scene in scenes:
        counts = [_classed(scene, seed, folder, extent_m) for seed in seeds]
        named = [*zip(map(str, seeds), counts, strict=True)]
        if len(seeds) > 1:
            named.append(("all", np.sum(counts, axis=0)))
        for name, (wires, *given) in named:
            rest = {k: int(n) for k, n in zip(KINDS, given, strict=True) if n and k != "wire"}
            recall = 100 * given[WIRE] / wires if wires else float("nan")
            precision = 100 * given[WIRE] / sum(given) if sum(given) else float("nan")
            print(
                f"{scene:12s}{name:>5s}{wires:8d}{recall:10.1f}{sum(given):10d}{precision:13.1f}  ",
                ", ".join(f"{k} {n}" for k, n in rest.items()),
                flush=True,
            )


def _classed(
    scene: str, seed: int, folder: Path, extent_m: tuple[float, float]
) -> NDArray[np.int64]:
    """Wire returns, then the returns of class 14 by kind [count]."""
    make = {"none": wireless, "weak": weak_wires, "ordinary": ordinary_wires}[scene]
    name = f"{scene}_{seed}" if extent_m == EXTENT_M else f"{scene}_{seed}_{extent_m[0]:g}"
    survey = methods.make_survey(make(seed, extent_m), folder / name)
    changed = ["filter.wires.classify=true", "output=classed"]
    if api.run(survey / "workflow.yaml", overrides=changed, until="deliver", workers=0).exit_status:
        raise SystemExit(f"{survey}: the run failed; see {survey}/classed/log.jsonl")
    kind = methods.load_truth(survey)["kind"]
    paths = (
        survey / "classed" / "laz" / "flightlines" / p.name for p in methods.flightlines(survey)
    )
    given = np.concatenate([np.asarray(laspy.read(path).classification) for path in paths])
    sure = np.bincount(kind[given == CLASS_WIRE], minlength=len(KINDS))[: len(KINDS)]
    return np.array([np.count_nonzero(kind == WIRE), *sure], dtype=np.int64)


def wireless(seed: int, extent_m: tuple[float, float]) -> Scene:
    """Roofs, trees and a lake in the light and noise of the ordinary wires' scene."""
    content = ordinary_wires(seed, extent_m).model_dump(mode="json", by_alias=True)
    lake = [[10.0, 10.0], [35.0, 8.0], [38.0, 30.0], [12.0, 33.0]]
    roofs = {"count": round(extent_m[0] * extent_m[1] / ROOF_M2)}
    content |= {"wires": [], "buildings": roofs, "water": [{"ring_m": lake}]}
    return parse_scene(content, "wireless")


def strata(survey: Path, points: Columns) -> dict[str, NDArray[np.bool_]]:
    """Returns that are counted together, by name: each (n,) bool."""
    kind = points["kind"]
    groups = {"wires": kind == WIRE}
    groups |= {f"line {k + 1}": m for k, m in enumerate(_by_line(survey, points))}
    noise = kind == BACKGROUND
    groups |= {"noise": noise, "far noise": noise & _far(points)}
    groups |= {"ground": kind == GROUND, "roofs": kind == ROOF, "trees": kind == VEGETATION}
    groups["poles"] = kind == OTHER
    return groups


def _far(points: Columns) -> NDArray[np.bool_]:
    """Which returns are farther than :data:`FAR_M` from all true returns."""
    xyz = np.column_stack([points[axis] for axis in "xyz"])
    low = xyz.min(axis=0)
    rest = xyz[~is_noise(points["kind"])] - low
    _, first = np.unique(np.floor(rest / THIN_M).astype(np.int64), axis=0, return_index=True)
    noise = np.flatnonzero(points["kind"] == BACKGROUND)
    distance = cKDTree(rest[first]).query(xyz[noise] - low, distance_upper_bound=FAR_M)[0]
    far = np.zeros(len(xyz), dtype=np.bool_)
    far[noise[np.isinf(distance)]] = True
    return far


def _by_line(survey: Path, points: Columns) -> list[NDArray[np.bool_]]:
    """Wire returns of each line, by the distance to its strands."""
    rows = np.flatnonzero(points["kind"] == WIRE)
    wires = {axis: points[axis][rows] for axis in "xyz"}
    found = []
    for _, spans in corridors.lines(survey):
        mask = np.zeros(len(points["kind"]), dtype=np.bool_)
        near = corridors.nearest_m(spans, wires)
        mask[rows[near <= NEAR_M]] = True
        found.append(mask)
    return found


def _head(scene: str, groups: Sequence[str]) -> None:
    least, most = BARS[scene]
    print(f"\n{scene} wires, kept [%]; asked: wires >= {least:g}, noise <= {most:g}")
    print(f"{'':32s}" + "".join(f"{g:>10s}" for g in groups))


def _row(method: Method, which: str, tallies: Sequence[Tally]) -> None:
    shares = [methods.pooled([t[g] for t in tallies if g in t]) for g in tallies[0]]
    digits = [3 if "noise" in g else 2 for g in tallies[0]]
    print(
        f"{method.label:24s}{which:8s}"
        + "".join(f"{s:10.{d}f}" for s, d in zip(shares, digits, strict=True)),
        flush=True,
    )


def parse() -> argparse.Namespace:
    """Arguments of the command line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    known = [name for name in ("published", "ours") if name in methods.known_methods()]
    parser.add_argument("--folder", type=Path)
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2, 3])
    parser.add_argument("--scenes", nargs="+", choices=CLASSED, help="all by default")
    parser.add_argument("--classes", action="store_true", help="class 14 instead of what is kept")
    parser.add_argument("--extent", type=float, nargs=2, default=EXTENT_M, metavar="M")
    parser.add_argument("--methods", nargs="+", choices=list(methods.known_methods()),
                        default=known)  # fmt: skip
    return parser.parse_args()


if __name__ == "__main__":
    given = parse()
    with tempfile.TemporaryDirectory() as temporary:
        place = given.folder or Path(temporary)
        if given.classes:
            classes(place, given.scenes or CLASSED, given.seeds, tuple(given.extent))
        else:
            main(place, given.scenes or list(BARS), given.seeds, given.methods)
