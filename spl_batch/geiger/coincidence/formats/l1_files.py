"""L1 files: frames and detections of a Geiger-mode array, as Parquet [M20 1.1, 3.3].

Their columns are those of :class:`~spl_batch.geiger.coincidence.tables.Frames` and
:class:`~spl_batch.geiger.coincidence.tables.Detections`, places in metres. Rows may come in any
order, further columns are left alone. What a detector looked at follows from its frame; so looks
without a detection need no row.

Files of detections are read a stretch of rows at a time, whatever their row groups.
"""

from collections import Counter
from collections.abc import Iterator, Sequence
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
from spl_batch.geiger.coincidence.settings import ArraySettings
from spl_batch.geiger.coincidence.tables import Detections, Frames, Table

_WHOLE: Final = frozenset({"frame", "detector"})
_FARTHEST_M: Final = 1e8
"""Coordinates beyond this are none of a projected CRS [m]."""

STRETCH_ROWS: Final = 262_144
"""Rows that are read at once [count]."""

_BUFFER_BYTES: Final = 1 << 20
"""A column's pages are read through a buffer, not with the whole of their row group [byte]."""

Extent = tuple[float, float, float, float, int]
"""West, south, east, north [m] of some rows, and how many they are."""


def inspect(path: Path, columns: Sequence[str]) -> int:
    """Check that a file is Parquet and has these columns; gives its number of rows.

    Raises
    ------
    InputError
        With every fault of the file.
    """
    try:
        file = pq.ParquetFile(path)
    except OSError as error:
        reason = reason_of(error)
        raise InputError(str(path), f"cannot be read: {reason}") from error
    except pa.ArrowException as error:
        raise InputError(
            str(path), f"no whole Parquet file ({' '.join(str(error).split())}); copy it again"
        ) from error
    with file:
        names = file.schema_arrow.names
        faults = [
            f"no column {name!r}; it has {', '.join(names) or 'none'}"
            for name in columns
            if name not in names
        ]
        faults += [
            f"column {name!r} is {file.schema_arrow.field(name).type}, not "
            f"{'integer' if name in _WHOLE else 'a number'}"
            for name in columns
            if name in names and not _fits(file.schema_arrow.field(name).type, name)
        ]
        if faults:
            raise InputError(str(path), faults)
        rows = bounded(path, "rows", file.metadata.num_rows, most=2**62)
        refuse_bomb(path, f"{rows} rows", 8 * len(columns) * rows, path.stat().st_size)
        return rows


def extents(path: Path) -> tuple[Extent, ...] | None:
    """Where the rows of each row group of a checked file lie; None if its footer does not tell.

    A row of each group is read first: with a damaged footer that raises, while a look at its
    statistics ends the whole process.
    """
    with pq.ParquetFile(path, pre_buffer=False) as file:
        if not _readable(file):
            return None
        footer, names = file.metadata, file.schema_arrow.names
        at = [names.index(axis) for axis in "xy"]
        found = []
        for k in range(footer.num_row_groups):
            group = footer.row_group(k)
            spans = [group.column(column).statistics for column in at]
            if any(span is None or not span.has_min_max for span in spans):
                return None
            (west, east), (south, north) = ((float(s.min), float(s.max)) for s in spans)
            if not max(map(abs, (west, south, east, north))) < _FARTHEST_M:
                return None
            found.append((west, south, east, north, int(group.num_rows)))
    return tuple(found)


def _readable(file: pq.ParquetFile) -> bool:
    """Whether places of every row group can be read."""
    try:
        for group in range(file.num_row_groups):
            next(file.iter_batches(1, [group], ["x", "y"], use_threads=False), None)
    except (OSError, pa.ArrowException):
        return False
    return True


def _fits(kind: pa.DataType, name: str) -> bool:
    number = pa.types.is_integer(kind) or pa.types.is_floating(kind)
    return bool(pa.types.is_integer(kind) if name in _WHOLE else number)


def _stretches(path: Path, columns: Sequence[str], rows: int) -> Iterator[dict[str, NDArray[Any]]]:
    """Columns of a file, some rows at a time; at the end every fault is raised."""
    inspect(path, columns)
    nulls, bad = Counter[str](), Counter[str]()
    try:
        with pq.ParquetFile(path, buffer_size=_BUFFER_BYTES, pre_buffer=False) as file:
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


def read_frames(path: Path, stretch_rows: int = STRETCH_ROWS) -> Frames:
    """Frames of a file in order of their numbers.

    Raises
    ------
    InputError
        If the file is damaged, or names a frame twice.
    """
    parts = list(_stretches(path, Frames.names(), stretch_rows))
    frames = Frames.joined([Frames.of(part) for part in parts]).in_order()
    again = np.flatnonzero(frames.number[1:] == frames.number[:-1])
    if len(again):
        twice = counted(len(again), "frames", "are")
        first = frames.number[again[0]]
        raise InputError(
            str(path), f"{twice} there twice, the first is {first}; number them through"
        )
    return frames


def read_detections(
    path: Path, array: ArraySettings, stretch_rows: int = STRETCH_ROWS
) -> Iterator[Detections]:
    """Detections of a file, a stretch of rows at a time, each in order of frame and detector.

    Raises
    ------
    InputError
        If the file is damaged, names detectors that the array has not, or one twice in a frame
        among the rows of a stretch; once all stretches were given.
    """
    outside = highest = twice = 0
    first = ""
    for columns in _stretches(path, Detections.names(), stretch_rows):
        frame, detector = columns["frame"], columns["detector"]
        outside += int((detector >= array.detectors).sum())
        highest = max(highest, int(detector.max(initial=0)))
        places = {k: np.rint(columns[k] * QUANTA_PER_M).astype(np.int64) for k in "xyz"}
        part = Detections.of({**columns, **places, "detector": detector.astype(np.int32)})
        once = part.distinct()
        if len(once) < len(part) and not twice:
            key = frame * array.detectors + detector
            number, place = divmod(_first_repeated(key), array.detectors)
            first = f"detector {place} of frame {number}"
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


def _first_repeated(keys: NDArray[np.int64]) -> int:
    values, count = np.unique(keys, return_counts=True)
    return int(values[count > 1][0])


def write(path: Path, table: Table) -> None:
    """Write a file of frames or detections."""
    columns = table.columns()
    if isinstance(table, Detections):
        columns |= {name: columns[name] / QUANTA_PER_M for name in "xyz"}
    with replacing(path) as part:
        pq.write_table(pa.table(dict(columns)), part, compression="zstd")
