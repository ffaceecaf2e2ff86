"""Several runs on the same points: where they differ, and what they keep where nothing is."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.context import Context
from spl_batch.airborne.report.profile_strips import WIDTH_M, best_strip, strip_sums
from spl_batch.airborne.store.label_tables import read_region, units_within
from spl_batch.constants import NOISE_NOT_ASSESSED, NOISE_SIGNAL, QUANTUM_M
from spl_batch.engine.tasks.task import Receipt
from spl_batch.formats.rasters.parts import RasterPart
from spl_batch.formats.verified.parquet_npz import read_table
from spl_batch.lattice.tables import PointTable
from spl_batch.lattice.tiles import Bounds, CellId, cell_bounds, parse_cell, quanta

FAR_M: Final = 50.0
"""Farther from where most returns of its column lie, a point is taken for noise [m]."""

GATE_SHARE: Final = 1.0 / 3.0
"""Where the gate is short, that distance is this part of its length at most."""

COLUMN_M: Final = 10.0
"""Edge of a column [m]."""

BIN_M: Final = 5.0
"""Height bin in which most returns are sought [m]."""

STANDS_OUT: Final = 4.0
"""A column's fullest bin holds this many times the mean of its bins, or shows nothing."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """One finished run."""

    done: Mapping[str, Mapping[str, Receipt]]  #: Finished tasks by kind and name.
    context: Context


@dataclass
class Contrast:
    """Several runs against the first of them."""

    kept_only: NDArray[np.int64]  #: (k,): points that each run keeps and the first removes [count].
    #: (k,): points that each run removes and the first keeps [count].
    removed_only: NDArray[np.int64]
    far_kept: NDArray[np.int64]  #: (k,): points kept far from the scene [count].
    far_points: int
    far_m3: float  #: Volume of the gate there [m3].
    disputed: Bounds | None  #: Strip in which the runs disagree about most points.
    left_out: list[str]  #: Tiles that the runs do not all have.


def contrast(runs: Sequence[Outcome]) -> Contrast:
    """Compare the labels of several runs, tile by tile.

    ``runs``: runs on the same inputs with the same tiles; the first is what others differ from.
    """
    zeros = np.zeros((3, len(runs)), dtype=np.int64)
    found = Contrast(zeros[0], zeros[1], zeros[2], 0, 0.0, None, [])
    most = 0
    everywhere = sorted({parse_cell(t) for run in runs for t in run.done.get("build_tile", {})})
    for tile in everywhere:
        classes = list(_classes(runs, tile))
        if len(classes) < len(runs) or len({len(c) for c in classes}) > 1:
            found.left_out.append(str(tile))
            continue
        table = read_table(runs[0].context.store.table("tiles", str(tile)), ("x", "y", "z"))
        kept = np.stack([c == NOISE_SIGNAL for c in classes])
        known = np.stack([c != NOISE_NOT_ASSESSED for c in classes])
        _count(found, kept, known)
        bounds = cell_bounds(tile, quanta(runs[0].context.workflow.tiling.tile_m))
        far = _far(found, table, kept, bounds)
        disputed = known.all(axis=0) & kept.any(axis=0) & ~kept.all(axis=0) & ~far
        strip, points = _fullest_strip(table.take(disputed), bounds)
        if points > most:
            most, found.disputed = points, strip
    return found


def _classes(runs: Sequence[Outcome], tile: CellId) -> Iterator[NDArray[np.uint8]]:
    """What each run that has the tile took its points for."""
    for run in runs:
        if str(tile) in run.done.get("build_tile", {}):
            region = cell_bounds(tile, quanta(run.context.workflow.tiling.tile_m))
            labels = units_within(region, ["noise_class"], run.done)
            table, _ = read_region(run.context.store, [tile], None, ("x",), labels)
            yield table["noise_class"]


def _count(found: Contrast, kept: NDArray[np.bool_], known: NDArray[np.bool_]) -> None:
    both = known & known[0]
    found.kept_only += np.count_nonzero(both & kept & ~kept[0], axis=1)
    found.removed_only += np.count_nonzero(both & ~kept & kept[0], axis=1)


def _far(
    found: Contrast, table: PointTable, kept: NDArray[np.bool_], bounds: Bounds
) -> NDArray[np.bool_]:
    """Count what is kept far from the scene; points that are, or whose column shows nothing.

    The scene is where most returns of a column lie, whatever a filter made of them: the
    terrain model of one that keeps noise below the ground is no place to measure from.
    """
    if not len(table):
        return np.zeros(0, dtype=np.bool_)
    edge = quanta(COLUMN_M)
    size = -(-(bounds.xmax - bounds.xmin) // edge)
    at = (table["y"] - bounds.ymin) // edge * size + (table["x"] - bounds.xmin) // edge
    z = table["z"] * QUANTUM_M
    low = float(z.min())
    level = np.floor((z - low) / BIN_M).astype(np.int64)
    levels = int(level.max()) + 1
    count = np.bincount(at * levels + level, minlength=size * size * levels).reshape(-1, levels)
    top, bottom = np.full(len(count), low), np.full(len(count), z.max())
    np.maximum.at(top, at, z)
    np.minimum.at(bottom, at, z)
    length = np.maximum(top - bottom, 0.0)
    full = count.max(axis=1)
    clear = full * length > STANDS_OUT * count.sum(axis=1) * BIN_M
    scene = low + (np.argmax(count, axis=1) + 0.5) * BIN_M
    reach = np.minimum(FAR_M, GATE_SHARE * length)
    far: NDArray[np.bool_] = clear[at] & (np.abs(z - scene[at]) > reach[at])
    found.far_points += int(np.count_nonzero(far))
    found.far_kept += np.count_nonzero(kept & far, axis=1)
    beyond = np.maximum(top - scene - reach, 0.0) + np.maximum(scene - reach - bottom, 0.0)
    found.far_m3 += float(beyond[clear].sum()) * COLUMN_M**2
    far |= ~clear[at]
    return far


def _fullest_strip(table: PointTable, bounds: Bounds) -> tuple[Bounds, int]:
    """Strip along the easting with most points, and their number; the first of equals."""
    edge = quanta(WIDTH_M)
    rows = -(-(bounds.ymax - bounds.ymin) // edge)
    columns = -(-(bounds.xmax - bounds.xmin) // edge)
    at = (table["y"] - bounds.ymin) // edge * columns + (table["x"] - bounds.xmin) // edge
    count = np.bincount(at, minlength=rows * columns).astype(np.float32)
    count = count.reshape(rows, columns)[::-1]
    north = bounds.ymin + rows * edge
    part = RasterPart(count, bounds.xmin * QUANTUM_M, north * QUANTUM_M, WIDTH_M)
    strip, points = best_strip(part, strip_sums(part, count))
    return strip, int(points)
