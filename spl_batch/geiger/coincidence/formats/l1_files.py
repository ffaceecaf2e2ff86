"""L1 files: frames and detections of a Geiger-mode array, as Parquet [M20 1.1, 3.3].

A frames file has a row for each laser pulse, whether or not anything was detected:

=============================  =====================================================
``frame``                      number, unique in the survey (integer)
``x``, ``y``, ``z``            place of the sensor [m]
``heading, roll, pitch``       of the array [rad]: clockwise from north, starboard
                               wing down, nose up
=============================  =====================================================

A detections file has a row for each detector that fired:

=============================  =====================================================
``frame``                      its frame (integer)
``detector``                   ``row * columns + column``; rows count to starboard,
                               columns to the nose (integer)
``x``, ``y``, ``z``            where the light came back from [m]
=============================  =====================================================

Rows may come in any order, further columns are left alone. What a detector looked at follows
from its frame; so looks without a detection need no row.

Files are read a stretch of rows at a time, whatever their row groups, and put in order on disk.
"""

from collections.abc import Iterator, Mapping, Sequence
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
from spl_batch.formats.files.external_sort import STRETCH_ROWS, Sorter, repeated
from spl_batch.geiger.coincidence.settings import ArraySettings
from spl_batch.geiger.coincidence.tables import Attitudes, Detections

FRAME_COLUMNS: Final = ("frame", "x", "y", "z", "heading", "roll", "pitch")
DETECTION_COLUMNS: Final = ("frame", "detector", "x", "y", "z")
_WHOLE: Final = frozenset({"frame", "detector"})
_FARTHEST_M: Final = 1e8
"""Coordinates beyond this are none of a projected CRS [m]."""

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


class _Checks:
    """Faults of a file's values, counted stretch by stretch."""

    def __init__(self, columns: Sequence[str]) -> None:
        self._nulls = dict.fromkeys(columns, 0)
        self._bad = dict.fromkeys(columns, 0)
        self._ends: dict[str, tuple[int, int]] = {}

    def take(self, batch: pa.RecordBatch) -> dict[str, NDArray[Any]]:
        """Columns of a stretch, integers as int64 and numbers as float64; without the bad ones."""
        found = {}
        for name in self._nulls:
            column = batch.column(name)
            if column.null_count:
                self._nulls[name] += column.null_count
                continue
            values = column.to_numpy(zero_copy_only=False)
            if name in _WHOLE and len(values):
                low, high = self._ends.get(name, (0, 0))
                self._ends[name] = min(low, int(values.min())), max(high, int(values.max()))
            found[name] = values.astype(np.int64 if name in _WHOLE else np.float64)
            if name not in _WHOLE:
                self._bad[name] += int((~(np.abs(found[name]) < _FARTHEST_M)).sum())
        return found

    def faults(self) -> list[str]:
        """Every fault so far."""
        faults = []
        for name, nulls in self._nulls.items():
            low, high = self._ends.get(name, (0, 0))
            if nulls:
                faults.append(f"{counted(nulls, 'rows', 'have')} no {name!r}")
            if low < 0 or high > 2**62:
                faults.append(f"{name!r} runs from {low} to {high}; count from 0")
            if self._bad[name]:
                faults.append(
                    f"{self._bad[name]} values of {name!r} are no finite metres or radians"
                )
        return faults


def _stretches(path: Path, columns: Sequence[str], rows: int) -> Iterator[dict[str, NDArray[Any]]]:
    """Columns of a file, some rows at a time; at the end every fault is raised."""
    inspect(path, columns)
    checks = _Checks(columns)
    try:
        with pq.ParquetFile(path, buffer_size=_BUFFER_BYTES, pre_buffer=False) as file:
            for batch in file.iter_batches(rows, columns=list(columns), use_threads=False):
                found = checks.take(batch)
                if not checks.faults():
                    yield found
    except (OSError, pa.ArrowException) as error:
        reason = " ".join(str(error).split())
        raise InputError(str(path), f"damaged: {reason}; copy it again") from error
    if faults := checks.faults():
        raise InputError(str(path), faults)


def frames_in_order(
    path: Path, folder: Path | None = None, stretch_rows: int = STRETCH_ROWS
) -> Iterator[Attitudes]:
    """Frames of a file in order, part by part, in memory that does not depend on its size.

    Parameters
    ----------
    folder : Path, optional
        Where rows wait for their place; by default the system's place for temporary files.
    stretch_rows : int
        Rows that are held at once, roughly [count].

    Raises
    ------
    InputError
        If the file is damaged, or names a frame twice; once all parts were given.
    """
    dtypes = {name: np.int64 if name in _WHOLE else np.float64 for name in FRAME_COLUMNS}
    twice, first = 0, -1
    with Sorter(dtypes, 1, folder, stretch_rows) as sorter:
        for columns in _stretches(path, FRAME_COLUMNS, stretch_rows):
            sorter.add(columns)
        for columns in sorter.in_order():
            number = columns["frame"]
            again = repeated(columns, ("frame",))
            if len(again) and not twice:
                first = int(number[again[0]])
            twice += len(again)
            origin, attitude = (
                np.stack([columns[k] for k in names], axis=-1)
                for names in (FRAME_COLUMNS[1:4], FRAME_COLUMNS[4:])
            )
            yield Attitudes(number, origin, attitude)
    if twice:
        raise InputError(
            str(path),
            f"{counted(twice, 'frames', 'are')} there twice, the first is {first}; number frames "
            "through",
        )


_SORTED: Final = {"frame": np.int64, "detector": np.int32, **dict.fromkeys("xyz", np.int64)}


def detections_in_order(
    path: Path, array: ArraySettings, folder: Path | None = None, stretch_rows: int = STRETCH_ROWS
) -> Iterator[Detections]:
    """Detections of a file in order of frame and detector, part by part.

    Memory does not depend on the file's size; all detections of a frame come in one part.

    Parameters
    ----------
    folder : Path, optional
        Where rows wait for their place; by default the system's place for temporary files.
    stretch_rows : int
        Rows that are held at once, roughly [count].

    Raises
    ------
    InputError
        If the file is damaged, names detectors that the array has not, or one twice in a frame;
        the last once all parts were given.
    """
    outside = highest = 0
    with Sorter(_SORTED, 2, folder, stretch_rows) as sorter:
        for columns in _stretches(path, DETECTION_COLUMNS, stretch_rows):
            beyond = columns["detector"] >= array.detectors
            outside += int(beyond.sum())
            highest = max(highest, int(columns["detector"].max(initial=0)))
            if not outside:
                sorter.add({k: _as_sorted(k, v) for k, v in columns.items()})
        if outside:
            raise InputError(
                str(path),
                f"{counted(outside, 'detections')} of detectors up to {highest}, but the array has "
                f"{array.rows} x {array.columns}; set array.rows and array.columns",
            )
        yield from _once_a_frame(path, sorter)


def _as_sorted(name: str, values: NDArray[Any]) -> NDArray[Any]:
    """Integers unchanged, metres on the survey's lattice."""
    return values if name in _WHOLE else np.rint(values * QUANTA_PER_M).astype(np.int64)


def _once_a_frame(path: Path, sorter: Sorter) -> Iterator[Detections]:
    """Detections in order; raises at the end where a detector fired again."""
    twice, first = 0, (0, 0)
    for columns in sorter.in_order():
        frame, detector = columns["frame"], columns["detector"]
        again = repeated(columns, ("frame", "detector"))
        if len(again) and not twice:
            first = int(detector[again[0]]), int(frame[again[0]])
        twice += len(again)
        yield Detections(frame, detector, np.stack([columns[k] for k in "xyz"], axis=-1))
    if twice:
        raise InputError(
            str(path),
            f"{counted(twice, 'times')} a detector fires again in its frame, first detector "
            f"{first[0]} of frame {first[1]}; only the first detection counts",
        )


def write_frames(path: Path, frames: Attitudes) -> None:
    """Write a frames file."""
    places = _named(FRAME_COLUMNS[1:4], frames.origin_m)
    turns = _named(FRAME_COLUMNS[4:], frames.attitude_rad)
    _write(path, {"frame": frames.number, **places, **turns})


def write_detections(path: Path, detections: Detections) -> None:
    """Write a detections file."""
    xyz = detections.xyz / QUANTA_PER_M
    _write(path, {"frame": detections.frame, "detector": detections.detector, **_named("xyz", xyz)})


def _named(names: Sequence[str], columns: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
    return {name: columns[:, k] for k, name in enumerate(names)}


def _write(path: Path, columns: Mapping[str, NDArray[Any]]) -> None:
    with replacing(path) as part:
        pq.write_table(pa.table(dict(columns)), part, compression="zstd")
