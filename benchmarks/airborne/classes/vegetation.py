"""What density ground and vegetation by height need: F1 of thinned clouds.

Run ``python -m benchmarks.airborne.classes.vegetation LOW MEDIUM HIGH PATH ...``, each a TILE or a
SURVEY; LOW, MEDIUM and HIGH are heights above the terrain from which on vegetation counts [m].

TILE is a file that its producer has classified. SURVEY is a folder that ``spl-batch simulate``
wrote and ``spl-batch run`` has processed: of its signal, what was reflected from vegetation has the
class of its height above the true terrain. Both are thinned at random (seeded); ground is found on
what is left alone, and all else is classed by its height above a triangulation of that ground
(scipy's). Judged are returns that are ground or vegetation in truth. Printed are the density
[1/m2], that of ground found, and F1 of each class [%] with its true returns in brackets.
"""

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import pyarrow.parquet as pq
import rasterio
from numpy.typing import NDArray
from scipy.interpolate import LinearNDInterpolator

from benchmarks.airborne.filter import methods
from spl_batch.airborne.ground.ground_methods import ground_mask
from spl_batch.airborne.settings import GroundSettings
from spl_batch.constants import CLASS_GROUND, CLASS_LOW_VEGETATION, QUANTA_PER_M
from spl_batch.lattice.tables import PointTable

DENSITIES = (10.0, 5.0, 2.0, 1.0, 0.5, 0.24, 0.12)
"""Densities to which a cloud is thinned [1/m2]."""

CLASSES = {2: "ground", 3: "low", 4: "medium", 5: "high"}


def main(limits_m: Sequence[float], path: Path) -> None:
    """Print a line for each density below that of a path."""
    xyz, truth = _survey(path, limits_m) if path.is_dir() else _tile(path)
    order = np.random.default_rng(1).permutation(len(xyz))
    area_m2 = len(np.unique(np.floor(xyz[:, :2] / 10.0), axis=0)) * 100.0
    whole = len(xyz) / area_m2
    print(path.name, f"({whole:.2f} per m2)")
    for density in (whole, *(d for d in DENSITIES if d < 0.9 * whole)):
        chosen = np.sort(order[: round(density * area_m2)])
        found = _classes(xyz[chosen], limits_m)
        ground = np.count_nonzero(found == CLASS_GROUND) / area_m2
        print(f"{density:8.2f}{ground:8.2f}  {_scores(found, truth[chosen])}", flush=True)


def _tile(path: Path) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
    las = laspy.read(path)
    return np.asarray(las.xyz), np.asarray(las.classification)


def _survey(
    folder: Path, limits_m: Sequence[float]
) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
    """Signal of all flightlines, and the classes of what it was reflected from."""
    places, kinds = [], []
    for truth in sorted((folder / "truth").glob("line_*.parquet")):
        las = laspy.read(folder / "out" / "laz" / "flightlines" / f"{truth.stem}.laz")
        signal = np.asarray(las["noise_class"]) == 0
        kinds.append(pq.read_table(truth, columns=["kind"])["kind"].to_numpy()[signal])
        places.append(np.asarray(las.xyz)[signal])
    xyz, kind = np.concatenate(places), np.concatenate(kinds)
    with rasterio.open(folder / "truth" / "dtm.tif") as source:
        row, column = rasterio.transform.rowcol(source.transform, xyz[:, 0], xyz[:, 1])
        row, column = (
            np.clip(k, 0, n - 1) for k, n in zip((row, column), source.shape, strict=True)
        )
        above = xyz[:, 2] - source.read(1)[row, column]
    classes = np.where(kind == methods.GROUND, CLASS_GROUND, 0)
    plant = kind == methods.VEGETATION
    classes[plant] = _by_height(above[plant], limits_m)
    return xyz, classes.astype(np.uint8)


def _by_height(above_m: NDArray[np.float64], limits_m: Sequence[float]) -> NDArray[np.int64]:
    """Classes 3, 4 and 5 from their heights on; 1 below."""
    step = np.searchsorted(limits_m, above_m, side="right")
    return np.where(step > 0, step + CLASS_LOW_VEGETATION - 1, 1)


def _classes(xyz: NDArray[np.float64], limits_m: Sequence[float]) -> NDArray[np.int64]:
    quanta = np.rint(xyz * QUANTA_PER_M).astype(np.int64)
    columns: dict[str, NDArray[Any]] = dict(zip("xyz", quanta.T, strict=True))
    columns["z"] = columns["z"].astype(np.int32)
    columns["flags"] = np.zeros(len(xyz), np.uint8)
    table = PointTable(columns)
    everything = np.ones(len(xyz), np.bool_)
    ground = ground_mask(table, everything, GroundSettings(), everything)
    corner = xyz[0]
    heights = LinearNDInterpolator((xyz - corner)[ground, :2], (xyz - corner)[ground, 2])
    above = (xyz - corner)[:, 2] - heights((xyz - corner)[:, :2])
    return np.where(ground, CLASS_GROUND, _by_height(np.nan_to_num(above, nan=-1.0), limits_m))


def _scores(found: NDArray[np.int64], truth: NDArray[np.uint8]) -> str:
    judged = np.isin(truth, list(CLASSES))
    words = []
    for number, name in CLASSES.items():
        mine, true = found[judged] == number, truth[judged] == number
        right, all_of = np.count_nonzero(mine & true), int(mine.sum() + true.sum())
        words.append(f"{name} {200 * right / max(all_of, 1):5.1f} ({int(true.sum())})")
    return "  ".join(words)


if __name__ == "__main__":
    low, medium, high, *paths = sys.argv[1:]
    for argument in paths:
        main(tuple(map(float, (low, medium, high))), Path(argument))
