"""Buildings that are found, against a producer's class 6 and against simulated truth.

Run ``python -m benchmarks.airborne.classes.buildings [--vary] PATH ...``, each a TILE or a SURVEY.

TILE is a file that its producer has classified; ground and buildings are found on its points alone,
without the rest of the chain. SURVEY is a folder that ``spl-batch simulate`` wrote and that
``spl-batch run`` has processed with ``classes.building: true``; its signal returns are judged by
what they were reflected from. Printed are precision, recall and F1 of the returns [%], the share
of each other class or kind that was taken for a building [%], and for tiles CPU seconds per million
points.

With ``--vary`` each constant is made a fifth smaller and a quarter larger, and F1 of the halves of
each path is printed [%]: what was fitted to one of them would be better there and worse elsewhere.
"""

import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple
from unittest import mock

import laspy
import numpy as np
import pyarrow.parquet as pq
from numpy.typing import NDArray

from benchmarks.airborne.filter import methods
from spl_batch.airborne.classes import buildings as module
from spl_batch.airborne.ground.ground_methods import ground_mask
from spl_batch.airborne.settings import GroundSettings
from spl_batch.constants import (
    CLASS_BUILDING,
    CLASS_GROUND,
    CLASS_HIGH_NOISE,
    CLASS_LOW_NOISE,
    QUANTA_PER_M,
)
from spl_batch.lattice.tables import PointTable, concat
from spl_batch.lattice.tiles import Bounds

KINDS = (*methods.KINDS, "bottom")
Mask = NDArray[np.bool_]


VARIED = ("STANDS_M", "FLAT_M", "STEEPEST", "WIDE", "NEAR_SIGMA", "MANY", "MOST")
"""Constants that ``--vary`` changes."""


class Scene(NamedTuple):
    """Returns of a path, and what they are."""

    name: str
    table: PointTable
    usable: Mask
    truth: Mask
    others: Mapping[str, Mask]


def main(path: Path) -> None:
    """Measure a tile or a survey as it was delivered."""
    if path.is_dir():
        _survey(path)
        return
    scene = _tile(path)
    start = time.process_time()
    found = _found(scene)
    spent = 1e6 * (time.process_time() - start) / len(scene.table)
    _print(scene.name, found, scene.truth, scene.others)
    print(f"{'CPU s/M':24s}{spent:8.2f}")


def vary(paths: Sequence[Path]) -> None:
    """Print F1 of the halves of each path, by constant."""
    scenes = [_signal(path) if path.is_dir() else _tile(path) for path in paths]
    scenes = [scene for scene in scenes if scene.truth.any()]
    west = [scene.table["x"] < np.median(scene.table["x"]) for scene in scenes]
    names = (f"{scene.name[:12]} {side}" for scene in scenes for side in ("west", "east"))
    print(f"{'constant':20s}" + "".join(f"{name:>19s}" for name in names))
    for name, by in [("as it is", 1.0), *((n, by) for n in VARIED for by in (0.8, 1.25))]:
        changed = mock.patch.object(module, name, by * getattr(module, name, 1.0), create=True)
        with changed:
            found = [_found(scene) for scene in scenes]
        halves = [(s, f, h) for s, f, w in zip(scenes, found, west, strict=True) for h in (w, ~w)]
        scores = (_score(f[half], s.truth[half])[2] for s, f, half in halves)
        label = name if by == 1.0 else f"{name} x {by}"
        print(f"{label:20s}" + "".join(f"{100 * score:19.1f}" for score in scores), flush=True)


def _found(scene: Scene) -> Mask:
    x, y = scene.table["x"], scene.table["y"]
    region = Bounds(int(x.min()), int(y.min()), int(x.max()) + 1, int(y.max()) + 1)
    floor = module.Floor(region)
    floor.add(scene.table, scene.usable)
    return module.buildings(scene.table, scene.usable, floor)


def _table(las: laspy.LasData, ground: Mask | None, usable: Mask) -> PointTable:
    xyz = np.rint(las.xyz * QUANTA_PER_M).astype(np.int64)
    columns: dict[str, NDArray[Any]] = dict(zip("xyz", xyz.T, strict=True))
    columns["z"] = columns["z"].astype(np.int32)
    columns["flags"] = np.zeros(len(xyz), np.uint8)
    table = PointTable(columns)
    if ground is None:
        ground = ground_mask(table, usable, GroundSettings(), np.ones(len(table), np.bool_))
    return table.with_columns(ground=ground.astype(np.uint8))


def _tile(path: Path) -> Scene:
    las = laspy.read(path)
    kind = np.asarray(las.classification)
    usable = ~np.isin(kind, (CLASS_LOW_NOISE, CLASS_HIGH_NOISE))
    others = {f"class {k}": kind == k for k in np.unique(kind).tolist() if k != CLASS_BUILDING}
    return Scene(path.stem, _table(las, None, usable), usable, kind == CLASS_BUILDING, others)


def _clouds(folder: Path) -> Iterator[tuple[laspy.LasData, NDArray[Any]]]:
    """Signal of each delivered cloud, and what it was reflected from."""
    for truth in sorted((folder / "truth").glob("line_*.parquet")):
        las = laspy.read(folder / "out" / "laz" / "flightlines" / f"{truth.stem}.laz")
        signal = np.asarray(las["noise_class"]) == 0
        kind = pq.read_table(truth, columns=["kind"])["kind"].to_numpy()[signal]
        las.points = las.points[signal]
        yield las, kind


def _signal(folder: Path) -> Scene:
    """Signal of a survey with the ground that it has found."""
    parts, kinds = [], []
    for las, kind in _clouds(folder):
        ground = np.asarray(las.classification) == CLASS_GROUND
        parts.append(_table(las, ground, ground))
        kinds.append(kind)
    table, kind = concat(parts, ("x", "y", "z", "flags", "ground")), np.concatenate(kinds)
    usable = np.ones(len(table), np.bool_)
    return Scene(folder.name, table, usable, kind == KINDS.index("roof"), {})


def _survey(folder: Path) -> None:
    clouds = list(_clouds(folder))
    found = np.concatenate([np.asarray(las.classification) for las, _ in clouds])
    kind = np.concatenate([kind for _, kind in clouds])
    others = {name: kind == k for k, name in enumerate(KINDS) if name != "roof"}
    _print(folder.name, found == CLASS_BUILDING, kind == KINDS.index("roof"), others)


def _score(found: Mask, truth: Mask) -> tuple[float, float, float]:
    """Precision, recall and F1."""
    right = np.count_nonzero(found & truth)
    precision, recall = right / max(found.sum(), 1), right / max(truth.sum(), 1)
    return precision, recall, 2 * precision * recall / max(precision + recall, 1e-9)


def _print(name: str, found: Mask, truth: Mask, others: Mapping[str, Mask]) -> None:
    precision, recall, score = _score(found, truth)
    print(f"{name}: precision {precision:.1%}, recall {recall:.1%}, F1 {score:.1%}")
    for label, held in others.items():
        if held.any():
            print(f"{label:24s}{100 * np.mean(found[held]):8.2f}")


if __name__ == "__main__":
    arguments = list(map(Path, sys.argv[1:]))
    if sys.argv[1:2] == ["--vary"]:
        vary(arguments[1:])
    else:
        for argument in arguments:
            main(argument)
