"""L1 files of users [M20 1.1, 3.3], and tables in the working store: both Parquet.

Columns of L1 files are those of :class:`~spl_batch.geiger.coincidence.tables.Frames` and
:class:`~spl_batch.geiger.coincidence.tables.Detections`, coordinates in metres. Rows may
come in any order, further columns are left alone. What a detector looked at follows from its frame;
so looks without a detection need no row.

Files of detections are read a stretch of rows at a time, whatever their row groups. In the store
tables are found again by the position and the frames of their row groups.
"""

from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping
from itertools import chain
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from spl_batch.constants import QUANTA_PER_M
from spl_batch.errors import InputError, counted, reason_of
from spl_batch.formats.declared import bounded, refuse_bomb
from spl_batch.formats.files.atomic import replacing
from spl_batch.formats.verified.parquet_npz import groups_between, read_with, writing
from spl_batch.geiger.coincidence.settings import ArraySettings
from spl_batch.geiger.coincidence.tables import Detections, Frames, Points, Table

_WHOLE: Final = frozenset({"frame", "detector"})
_FARTHEST_M: Final = 1e8
"""Coordinates beyond this are none of a projected CRS [m]."""

STRETCH_ROWS: Final = 262_144
"""Rows that are read at once [count]."""

_GROUP_ROWS: Final[Mapping[type[Table], int]] = {Frames: 512, Detections: 65_536, Points: 65_536}
"""Rows of a row group; 512 frames are a quarter of a second of the source's sensor [count]."""

Extent = tuple[float, float, float, float, int]
"""West, south, east, north [m] of some rows, and how many they are."""


def inspect(path: Path, columns: Collection[str]) -> int:
    """Check that a file is Parquet and has these columns, name every fault; its number of rows."""
    try:
        file = pq.ParquetFile(path)
    except OSError as error:
        raise InputError(str(path), f"cannot be read: {reason_of(error)}") from error
    except pa.ArrowException as error:
        raise InputError(
            str(path), f"no whole Parquet file ({' '.join(str(error).split())}); copy it again"
        ) from error
    with file:
        schema, faults = file.schema_arrow, []
        for name in columns:
            if name not in schema.names:
                faults.append(f"no column {name!r}; it has {', '.join(schema.names) or 'none'}")
                continue
            kind, wanted = schema.field(name).type, "integer" if name in _WHOLE else "a number"
            floating = name not in _WHOLE and pa.types.is_floating(kind)
            if not (pa.types.is_integer(kind) or floating):
                faults.append(f"column {name!r} is {kind}, not {wanted}")
        if faults:
            raise InputError(str(path), faults)
        rows = bounded(path, "rows", file.metadata.num_rows, most=2**62)
        refuse_bomb(path, f"{rows} rows", 8 * len(columns) * rows, path.stat().st_size)
        return rows


def extents(path: Path) -> tuple[Extent, ...] | None:
    """Where the rows of each row group of a checked file lie; None if its footer lacks them.

    A row of each group is read first: with a damaged footer that raises, while a look at its
    statistics ends the whole process.
    """
    found = []
    with pq.ParquetFile(path, pre_buffer=False) as file:
        try:
            for group in range(file.num_row_groups):
                next(file.iter_batches(1, [group], ["x", "y"], use_threads=False), None)
        except (OSError, pa.ArrowException):
            return None
        at = [file.schema_arrow.names.index(axis) for axis in "xy"]
        for group in map(file.metadata.row_group, range(file.num_row_groups)):
            spans = [group.column(column).statistics for column in at]
            if any(span is None or not span.has_min_max for span in spans):
                return None
            (west, east), (south, north) = ((float(s.min), float(s.max)) for s in spans)
            if not max(map(abs, (west, south, east, north))) < _FARTHEST_M:
                return None
            found.append((west, south, east, north, int(group.num_rows)))
    return tuple(found)


def _stretches(
    path: Path, columns: Collection[str], rows: int
) -> Iterator[dict[str, NDArray[Any]]]:
    """Columns of a file, some rows at a time; at the end every fault is raised."""
    inspect(path, columns)
    nulls, bad = Counter[str](), Counter[str]()
    try:
        # A column's pages come through a buffer of 1 MiB, not with the whole of their row group.
        with pq.ParquetFile(path, buffer_size=1 << 20, pre_buffer=False) as file:
            for batch in file.iter_batches(rows, columns=list(columns), use_threads=False):
                found = {}
                for name in columns:
                    column, kind = batch.column(name), np.int64 if name in _WHOLE else np.float64
                    values = column.drop_null().to_numpy(zero_copy_only=False).astype(kind)
                    sound = values >= 0 if name in _WHOLE else np.abs(values) < _FARTHEST_M
                    nulls[name] += column.null_count
                    bad[name] += int((~sound).sum())
                    found[name] = values
                if not nulls.total() + bad.total():
                    yield found
    except (OSError, pa.ArrowException) as error:
        reason = " ".join(str(error).split())
        raise InputError(str(path), f"damaged: {reason}; copy it again") from error
    faults = [f"{counted(n, 'rows', 'have')} no {name!r}" for name, n in (+nulls).items()]
    for name, n in (+bad).items():
        what = "counts from 0" if name in _WHOLE else "finite metres or radians"
        faults.append(f"{counted(n, 'values')} of {name!r} are no {what}")
    if faults:
        raise InputError(str(path), faults)


def read_frames(path: Path) -> Frames:
    """Frames of a file in order of their numbers, each once."""
    parts = _stretches(path, Frames.types(), STRETCH_ROWS)
    frames = Frames.joined([Frames.of(part) for part in parts]).in_order()
    again = frames.number[1:][frames.number[1:] == frames.number[:-1]]
    if len(again):
        twice = counted(len(again), "frames", "are")
        raise InputError(
            str(path), f"{twice} there twice, the first is {again[0]}; number them through"
        )
    return frames


def read_detections(
    path: Path, array: ArraySettings, stretch_rows: int = STRETCH_ROWS
) -> Iterator[Detections]:
    """Detections of a file, a stretch of rows at a time, each in order of frame and detector.

    Once all were given an error names detectors that the array has not, or one that fires again in
    a frame among the rows of a stretch.
    """
    outside = highest = twice = 0
    first = ""
    for columns in _stretches(path, Detections.types(), stretch_rows):
        detector = columns["detector"]
        outside += int((detector >= array.detectors).sum())
        highest = max(highest, int(detector.max(initial=0)))
        xyz = {k: np.rint(columns[k] * QUANTA_PER_M).astype(np.int64) for k in "xyz"}
        part = Detections.of({**columns, **xyz, "detector": detector.astype(np.int32)})
        once = part.distinct()
        if len(once) < len(part) and not twice:
            keys, count = np.unique(
                columns["frame"] * array.detectors + detector, return_counts=True
            )
            number, pixel = divmod(int(keys[count > 1][0]), array.detectors)
            first = f"detector {pixel} of frame {number}"
        twice += len(part) - len(once)
        if not outside:
            yield once
    if outside:
        raise InputError(
            str(path),
            f"{counted(outside, 'detections')} of detectors up to {highest}, but the array has "
            f"{array.rows} x {array.columns}; set array.rows and array.columns",
        )
    if twice:
        raise InputError(
            str(path),
            f"{counted(twice, 'times')} a detector fires again in its frame, first {first}; only "
            "the first detection counts",
        )


def write(path: Path, table: Table) -> None:
    """Write a file of frames or detections."""
    columns = table.columns()
    if isinstance(table, Detections):
        columns |= {name: columns[name] / QUANTA_PER_M for name in "xyz"}
    with replacing(path) as part:
        pq.write_table(pa.table(dict(columns)), part, compression="zstd")


def store(path: Path, kind: type[Table], parts: Iterable[Table]) -> None:
    """Keep parts of a table in the working store."""
    with writing(path, kind.types()) as writer:
        for part in chain([kind.joined([])], parts):
            for start in range(0, len(part), _GROUP_ROWS[kind]):
                writer.write(part.take(slice(start, start + _GROUP_ROWS[kind])).columns())


def stored_frames(path: Path, **spans: tuple[float, float]) -> Frames:
    """Frames with columns within spans; row groups are read whole, so more may come."""
    # Bounds of a row group are compared as whole numbers.
    whole = {name: (int(low) - 1, int(high) + 1) for name, (low, high) in spans.items()}
    return Frames.of(groups_between(path, whole).read([*Frames.types()])[0])


def known_frames(paths: Iterable[Path], numbers: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Which of some increasing numbers are of frames that files of the store have: (n,) bool."""
    known = np.zeros(len(numbers), np.bool_)
    for path in paths:
        for columns in read_with(path, ("frame",), "frame", numbers):
            known |= np.isin(numbers, columns["frame"])
    return known


def stored_detections(path: Path, numbers: NDArray[np.int64]) -> Detections:
    """Detections of some frames, whose numbers increase; a row group is held at a time."""
    parts = []
    for columns in read_with(path, [*Detections.types()], "frame", numbers):
        part = Detections.of(columns)
        parts.append(part.take(np.isin(part.frame, numbers)))
    return Detections.joined(parts)
