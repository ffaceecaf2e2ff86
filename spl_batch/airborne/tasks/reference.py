"""What results are compared with: reference points by square, checkpoints one by one.

A file of reference points may hold more than memory does, and a survey many files.
"""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from itertools import product
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS

from spl_batch.airborne.accuracy.raster_and_reference import Raster, Reference
from spl_batch.airborne.context import Context
from spl_batch.airborne.settings import ReferenceSettings
from spl_batch.airborne.tasks.index import CHUNK_POINTS
from spl_batch.constants import QUANTUM_M
from spl_batch.engine.findings import Finding
from spl_batch.engine.tasks.context import Produced
from spl_batch.engine.tasks.input_changes import unchanged
from spl_batch.formats.checkpoints import Checkpoint, read_checkpoints
from spl_batch.formats.crs import parse_crs
from spl_batch.formats.las.reader import iter_points
from spl_batch.formats.verified.parquet_npz import groups_between, writing
from spl_batch.lattice.row_order import lexicographic_order
from spl_batch.lattice.tables import COLUMNS, PointTable
from spl_batch.lattice.tiles import Bounds, CellId, inside, parse_cell

_KEPT: Final = ("x", "y", "z", "input_class")
"""Columns that a square keeps of a point."""

_DTYPES: Final[Mapping[str, Any]] = {
    **dict.fromkeys("ij", np.int64), **{name: COLUMNS[name].dtype for name in _KEPT}
}  # fmt: skip
"""Column and row of a square, and what it keeps."""

REFERENCE_POINT_BYTES: Final = sum(np.dtype(kind).itemsize for kind in _DTYPES.values())
"""A point of a reference in the working store [byte]."""


def reference(args: Mapping[str, Any], context: Context) -> Produced:
    """Put down the points of a reference file by squares of the survey's lattice.

    Each chunk that is read is a group of rows of every square that it touches.

    Each square has a margin, whose points do not count but show what lies nearby: the
    error of a point depends neither on the cutting nor on the file that it came in.
    """
    path, target = Path(args["path"]), context.store.table("reference", args["file"])
    points, squares = 0, Counter[str]()
    with (
        unchanged(path, args["stamp"]),
        writing(target, _DTYPES, sought=("i", "j")) as writer,
    ):
        for table in iter_points(
            path, channel_dimension=None, source=0, chunk=CHUNK_POINTS, units=context.units
        ):
            points += len(table)
            for square, rows in _by_square(table, args["edge"], args["margin"]):
                squares[str(square)] += len(rows)
                place = {k: np.full(len(rows), v) for k, v in square._asdict().items()}
                writer.write({**place, **table.select(_KEPT).take(rows).columns})
    facts = {"points": points, "squares": dict(sorted(squares.items()))}
    return Produced([target], facts, points)


def read_square(context: Context, files: Sequence[str], square: str, core: Bounds) -> Reference:
    """Points of a square and its margin, those of all files that have some.

    Those of ``core``, the square itself, count [quanta]. Raises DamagedError if a file of the store
    is missing or damaged.
    """
    span = {name: (at, at) for name, at in parse_cell(square)._asdict().items()}
    found = (groups_between(context.store.table("reference", name), span) for name in files)
    parts = [groups.read(_KEPT)[0] for groups in found]
    columns = {name: np.concatenate([part[name] for part in parts]) for name in _KEPT}
    xyz = np.column_stack([columns[axis] * QUANTUM_M for axis in "xyz"])
    return Reference(xyz, columns["input_class"], inside(columns["x"], columns["y"], core))


def _by_square(
    table: PointTable, edge: int, margin: int
) -> Iterator[tuple[CellId, NDArray[np.intp]]]:
    """Squares, and the points that lie in each or within a margin of it."""
    low = [(table[axis] - margin) // edge for axis in "xy"]
    high = [(table[axis] + margin) // edge for axis in "xy"]
    parts = []
    for a, b in product((0, 1), (0, 1)):
        # the far square, where there is one beside the near one
        mine = np.flatnonzero(((high[0] > low[0]) | (a == 0)) & ((high[1] > low[1]) | (b == 0)))
        parts.append((low[0][mine] + a, low[1][mine] + b, mine))
    i, j, row = (np.concatenate(one) for one in zip(*parts, strict=True))
    order = lexicographic_order((i, j))
    i, j, row = i[order], j[order], row[order]
    cuts = np.flatnonzero((np.diff(i) != 0) | (np.diff(j) != 0)) + 1
    for rows, at in zip(np.split(row, cuts), [0, *cuts.tolist()], strict=True):
        yield CellId(int(i[at]), int(j[at])), rows


def checkpoints(args: Mapping[str, Any], context: Context) -> Produced:
    """Compare the terrain with checkpoints."""
    # What is wrong with single ones was reported before the work began.
    known, _, _ = read_named(Path(args["path"]), context.crs, context.workflow.reference)
    terrain_m = [_terrain_m(point, context) for point in known]
    found = [
        {**asdict(point), "error_m": None if height is None else height - point.z_m}
        for point, height in zip(known, terrain_m, strict=True)
    ]
    beyond = [one["id"] for one in found if one["error_m"] is None]
    lost = Finding("C01", {"kind": "beyond", "count": len(beyond), "names": beyond})
    facts = {
        "name": args["name"],
        "checkpoints": found,
        "findings": [lost] if beyond else [],
    }
    return Produced([], facts, len(known))


def read_named(
    path: Path, crs: CRS | None, settings: ReferenceSettings | None
) -> tuple[list[Checkpoint], list[str], list[str]]:
    """Checkpoints of a file as a workflow has them, what is wrong with some, units of heights.

    Raises InputError if the file as a whole cannot be used.
    """
    stated = settings.checkpoints_crs if settings else None
    own = None if stated is None else parse_crs(stated, "reference.checkpoints_crs")
    return read_checkpoints(path, crs, own, settings.checkpoints_accuracy_m if settings else None)


def _terrain_m(point: Checkpoint, context: Context) -> float | None:
    """Height of the terrain, bilinear between cell centres; None where there is none [m]."""
    place = np.array([(point.x_m, point.y_m)])
    terrain = Raster.around(context.output / "dtm.tif", place)
    if terrain is None:
        return None
    height = float(terrain.bilinear(place)[0])
    return height if np.isfinite(height) else None


def checkpoint_results(receipts: Mapping[str, Any]) -> Sequence[Mapping[str, Any]]:
    """What :func:`checkpoints` has found, by its receipts; nothing where it has not run."""
    return [one for receipt in receipts.values() for one in receipt.facts["checkpoints"]]
