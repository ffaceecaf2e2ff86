"""Total error and kappa of all ground methods on the ISPRS filter samples.

Usage: ``python benchmarks/airborne/ground/isprs.py FOLDER`` with the samples as ``samp*.laz``
(class 2 ground, every other class object) [Sithole & Vosselman 2003]. One setting, the project's
defaults, for all samples. Points go through ground cells with buffers as in a run; a
second pass takes each sample whole, to show what the cutting does.
"""

import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Literal, NamedTuple

import laspy
import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.ground.ground_methods import ground_mask
from spl_batch.airborne.settings import GroundSettings
from spl_batch.constants import QUANTUM_M
from spl_batch.lattice.tables import PointTable
from spl_batch.lattice.tiles import Bounds, cell_bounds, cells_touching, grow, inside, quanta

PUBLISHED = {
    "ptd": {
        "samp11": (10.76, 78.5),
        "samp24": (4.42, 88.5),
        "samp41": (13.91, 72.2),
        "samp53": (8.91, 39.1),
        "samp71": (1.63, 91.4),
    },
    "smrf": {
        "samp11": (8.28, 83.1),
        "samp24": (3.52, 91.1),
        "samp41": (5.91, 88.2),
        "samp53": (2.43, 68.1),
        "samp71": (1.65, 91.8),
    },
}
"""Total error and kappa [%]: Axelsson's results in Sithole & Vosselman (2003), and
Pingel et al. (2013) with parameters tuned for each sample."""


COLUMNS = ("in cells", "whole", "published")


class Score(NamedTuple):
    """Total error and Cohen's kappa [%]."""

    total_error: float
    kappa: float


def read(path: Path) -> tuple[PointTable, NDArray[np.bool_]]:
    """Points in canonical order, and which of them are ground."""
    las = laspy.read(path)
    x, y, z = (np.rint(np.asarray(v) / QUANTUM_M).astype(np.int64) for v in (las.x, las.y, las.z))
    order = np.lexsort([z, y, x])
    table = PointTable({"x": x[order], "y": y[order], "z": z[order].astype(np.int32)})
    return table, np.asarray(las.classification)[order] == 2


def by_cells(table: PointTable, settings: GroundSettings) -> NDArray[np.bool_]:
    """Ground mask put together from the ground cells, each run with its buffer."""
    mask = np.zeros(len(table), dtype=np.bool_)
    x, y = table["x"], table["y"]
    extent = Bounds(int(x.min()), int(y.min()), int(x.max()) + 1, int(y.max()) + 1)
    size = quanta(settings.cell_m)
    for cell in cells_touching(extent, size):
        owned = cell_bounds(cell, size)
        part = np.flatnonzero(inside(x, y, grow(owned, quanta(settings.buffer_m))))
        found = ground_mask(table.take(part), np.ones(len(part), dtype=np.bool_), settings)
        own = inside(x[part], y[part], owned)
        mask[part[own]] = found[own]
    return mask


def score(found: NDArray[np.bool_], truth: NDArray[np.bool_]) -> Score:
    """Total error and Cohen's kappa of a classification into two classes."""
    agreed = float(np.mean(found == truth))
    by_chance = found.mean() * truth.mean() + (1 - found.mean()) * (1 - truth.mean())
    return Score(100 * (1 - agreed), 100 * float((agreed - by_chance) / (1 - by_chance)))


def mistakes(found: NDArray[np.bool_], truth: NDArray[np.bool_]) -> list[float]:
    """Ground missed and objects taken [%], and kappa if all of these were right, of either kind."""
    return [
        100 * float(np.mean(~found[truth])),
        100 * float(np.mean(found[~truth])),
        score(found | truth, truth).kappa,
        score(found & truth, truth).kappa,
    ]


def compare(
    samples: dict[str, tuple[PointTable, NDArray[np.bool_]]],
    method: Literal["multiscale", "ptd", "smrf"],
) -> None:
    """Print one method's table."""
    settings = GroundSettings(method=method)
    print(f"\n{method:8}  total error / kappa [%]", *(f"{n:>15}" for n in COLUMNS))
    started = time.perf_counter()
    rows, kinds = [], []
    for name, (table, truth) in samples.items():
        cut = score(by_cells(table, settings), truth)
        found = ground_mask(table, np.ones(len(table), dtype=np.bool_), settings)
        whole = score(found, truth)
        published = Score(*PUBLISHED.get(method, {}).get(name, (np.nan, np.nan)))
        rows.append((cut, whole, published))
        kinds.append(mistakes(found, truth))
        print_row(name, rows[-1])
    means = np.array(rows).mean(axis=0) if rows else np.full((3, 2), np.nan)
    print_row("mean", [Score(*mean) for mean in means])
    print(f"{time.perf_counter() - started:.1f} s for both passes")
    print("whole: ground missed, objects taken; kappa without the one, without the other [%]")
    for name, kind in zip(samples, kinds, strict=True):
        print(f"{name:33}" + "".join(f"{value:9.1f}" for value in kind))
    print(f"{'mean':33}" + "".join(f"{value:9.1f}" for value in np.mean(kinds, axis=0)))


def print_row(name: str, scores: Sequence[Score]) -> None:
    """Print one line of a table."""
    print(f"{name:33}", *(f"{s.total_error:6.2f} / {s.kappa:6.2f}" for s in scores))


def main(folder: Path) -> int:
    """Print one table for each method; the exit status."""
    samples = {path.name[:6]: read(path) for path in sorted(folder.glob("samp*.la[sz]"))}
    if not samples:
        print(f"{folder}: no samples (samp*.laz) here", file=sys.stderr)
        return 2
    compare(samples, "multiscale")
    compare(samples, "ptd")
    compare(samples, "smrf")
    return 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1] if len(sys.argv) > 1 else ".")))
