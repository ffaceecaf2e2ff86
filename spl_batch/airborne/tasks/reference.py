"""Reference points by square: a file may hold more than memory does, and a survey many files."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.accuracy.raster_and_reference import Reference
from spl_batch.airborne.context import Context
from spl_batch.constants import QUANTUM_M
from spl_batch.engine.tasks.context import Produced
from spl_batch.engine.tasks.input_changes import unchanged
from spl_batch.formats.files.atomic import remove, scratch_folder
from spl_batch.formats.las.reader import iter_points
from spl_batch.formats.verified.parquet_npz import read_columns, writing
from spl_batch.lattice.tables import PointTable
from spl_batch.lattice.tiles import Bounds, inside

CHUNK_POINTS: Final = 500_000
"""Points that are read and written at a time [count]."""

_COLUMNS: Final = {"x": np.int64, "y": np.int64, "z": np.int32, "class": np.uint8}
"""What a square keeps of a point [quanta]."""

_RECORD: Final = np.dtype(list(_COLUMNS.items()))


def reference(args: Mapping[str, Any], context: Context) -> Produced:
    """Put down the points of a reference file by squares of the survey's lattice.

    Each square has a margin, whose points do not count but tell what stands nearby: what is
    said of a point depends neither on the cutting nor on the file that it came in.
    """
    path, edge, margin = Path(args["path"]), args["edge"], args["margin"]
    points, written, squares = 0, [], {}
    remove(context.store.path("reference", args["file"]))  # squares of another cutting
    with unchanged(path, args["stamp"]), scratch_folder(context.store.local / "squares") as folder:
        for table in iter_points(
            path, channel_dimension=None, source=0, chunk=CHUNK_POINTS, units=context.units
        ):
            points += len(table)
            _put_down(_records(table), folder, edge, margin)
        for square in sorted(folder.iterdir()):
            target = _file(context, args["file"], square.name)
            squares[square.name] = _write_square(square, target)
            written.append(target)
    return Produced(written, {"points": points, "squares": squares}, points)


def _write_square(scratch: Path, target: Path) -> int:
    """Keep the points of a square, some at a time; their number."""
    count = 0
    with writing(target, _COLUMNS, sought=()) as file, scratch.open("rb") as stream:
        while content := stream.read(CHUNK_POINTS * _RECORD.itemsize):
            records = np.frombuffer(content, _RECORD)
            file.write({name: np.ascontiguousarray(records[name]) for name in _COLUMNS})
            count += len(records)
    return count


def read_square(context: Context, files: Sequence[str], square: str, core: Bounds) -> Reference:
    """Points of a square and its margin, those of all files that have some.

    Those of ``core``, the square itself, count [quanta]. Raises DamagedError if a file of the store
    is missing or damaged.
    """
    parts = [read_columns(_file(context, name, square), tuple(_COLUMNS)) for name in files]
    columns = {name: np.concatenate([part[name] for part in parts]) for name in _COLUMNS}
    xyz = np.column_stack([columns[axis] * QUANTUM_M for axis in "xyz"])
    return Reference(xyz, columns["class"], inside(columns["x"], columns["y"], core))


def _file(context: Context, name: str, square: str) -> Path:
    return context.store.path("reference", name, f"{square}.parquet")


def _records(table: PointTable) -> NDArray[np.void]:
    records = np.empty(len(table), _RECORD)
    for axis in "xyz":
        records[axis] = table[axis]
    records["class"] = table["input_class"]
    return records


def _put_down(records: NDArray[np.void], folder: Path, edge: int, margin: int) -> None:
    """Append points to each square that they lie in or within a margin of."""
    low = [(records[axis] - margin) // edge for axis in "xy"]
    high = [(records[axis] + margin) // edge for axis in "xy"]
    for a in (0, 1):
        for b in (0, 1):
            # the far square, where there is one beside the near one
            mine = np.flatnonzero(((high[0] > low[0]) | (a == 0)) & ((high[1] > low[1]) | (b == 0)))
            i, j = low[0][mine] + a, low[1][mine] + b
            if not len(mine):
                continue
            order = _by_square(i, j)
            mine, i, j = mine[order], i[order], j[order]
            cuts = np.flatnonzero((np.diff(i) != 0) | (np.diff(j) != 0)) + 1
            for rows, at in zip(np.split(mine, cuts), [0, *cuts.tolist()], strict=True):
                with Path(folder, f"{i[at]}_{j[at]}").open("ab") as stream:
                    # numpy's own tofile keeps quiet about a full disk
                    stream.write(records[rows].tobytes())


def _by_square(i: NDArray[np.int64], j: NDArray[np.int64]) -> NDArray[np.intp]:
    """Order of points by the column and row of their square, as they came within each."""
    column, row = i - i.min(), j - j.min()
    square = column * (int(row.max()) + 1) + row
    # numpy counts numbers of up to 16 bits where it compares longer ones
    return np.argsort(square.astype(np.min_scalar_type(int(square.max()))), kind="stable")
