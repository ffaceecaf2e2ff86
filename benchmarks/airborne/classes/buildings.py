"""Buildings that are found, against a producer's class 6 and against simulated truth.

Run ``python -m benchmarks.airborne.classes.buildings TILE.laz`` or ``... SURVEY``.

TILE is a file that its producer has classified; ground and buildings are found on its points alone,
without the rest of the chain. SURVEY is a folder that ``spl-batch simulate`` wrote and that
``spl-batch run`` has processed with ``classes.building: true``; its signal returns are judged by
what they were reflected from. Printed are precision, recall and F1 of the returns [%], the share
of each other class or kind that was taken for a building [%], and for tiles CPU seconds per million
points.
"""

import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pyarrow.parquet as pq
from numpy.typing import NDArray

from benchmarks.airborne.filter import methods
from spl_batch.airborne.classes.buildings import buildings
from spl_batch.airborne.ground.ground_methods import ground_mask
from spl_batch.airborne.settings import GroundSettings
from spl_batch.constants import CLASS_BUILDING, CLASS_HIGH_NOISE, CLASS_LOW_NOISE, QUANTA_PER_M
from spl_batch.lattice.tables import PointTable
from spl_batch.lattice.tiles import Bounds

KINDS = (*methods.KINDS, "bottom")
Mask = NDArray[np.bool_]


def main(path: Path) -> None:
    """Measure a tile or a survey."""
    (_survey if path.is_dir() else _tile)(path)


def _tile(path: Path) -> None:
    las = laspy.read(path)
    kind = np.asarray(las.classification)
    xyz = np.rint(las.xyz * QUANTA_PER_M).astype(np.int64)
    columns: dict[str, NDArray[Any]] = dict(zip("xyz", xyz.T, strict=True))
    columns["z"] = columns["z"].astype(np.int32)
    columns["flags"] = np.zeros(len(xyz), np.uint8)
    table = PointTable(columns)
    usable = ~np.isin(kind, (CLASS_LOW_NOISE, CLASS_HIGH_NOISE))
    every = np.ones(len(table), np.bool_)
    ground = ground_mask(table, usable, GroundSettings(), every)
    region = Bounds(*xyz[:, :2].min(axis=0).tolist(), *(xyz[:, :2].max(axis=0) + 1).tolist())
    start = time.process_time()
    found = buildings(table.with_columns(ground=ground.astype(np.uint8)), usable, region)
    spent = 1e6 * (time.process_time() - start) / len(table)
    others = {f"class {k}": kind == k for k in np.unique(kind).tolist() if k != CLASS_BUILDING}
    _print(path.name, found, kind == CLASS_BUILDING, others)
    print(f"{'CPU s/M':24s}{spent:8.2f}")


def _survey(folder: Path) -> None:
    found, kinds = [], []
    for truth in sorted((folder / "truth").glob("line_*.parquet")):
        las = laspy.read(folder / "out" / "laz" / "flightlines" / f"{truth.stem}.laz")
        signal = np.asarray(las["noise_class"]) == 0
        found.append(np.asarray(las.classification)[signal] == CLASS_BUILDING)
        kinds.append(pq.read_table(truth, columns=["kind"])["kind"].to_numpy()[signal])
    kind = np.concatenate(kinds)
    others = {name: kind == k for k, name in enumerate(KINDS) if name != "roof"}
    _print(folder.name, np.concatenate(found), kind == KINDS.index("roof"), others)


def _print(name: str, found: Mask, truth: Mask, others: Mapping[str, Mask]) -> None:
    right = np.count_nonzero(found & truth)
    precision, recall = right / max(found.sum(), 1), right / max(truth.sum(), 1)
    score = 2 * precision * recall / max(precision + recall, 1e-9)
    print(f"{name}: precision {precision:.1%}, recall {recall:.1%}, F1 {score:.1%}")
    for label, held in others.items():
        if held.any():
            print(f"{label:24s}{100 * np.mean(found[held]):8.2f}")


if __name__ == "__main__":
    for argument in sys.argv[1:]:
        main(Path(argument))
