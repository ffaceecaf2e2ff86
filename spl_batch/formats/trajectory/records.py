"""Records of trajectory files, some at a time: CSV, Parquet, SBET."""

import csv
import os
import re
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import closing
from pathlib import Path
from typing import BinaryIO, Final

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv
import pyarrow.parquet as pq
from numpy.typing import NDArray

from spl_batch.errors import InputError, as_input_fault, counted, grouped
from spl_batch.formats.declared import bounded, refuse_bomb
from spl_batch.formats.gps_clock import usable_times
from spl_batch.formats.las.header import open_input

Records = tuple[NDArray[np.float64], NDArray[np.float64]]
"""Times (n,) [s] and positions (n, 3) of some records."""

COLUMNS: Final = ("gps_time", "x", "y", "z")
"""Columns of a trajectory in CSV or Parquet."""

PARQUET_SUFFIXES: Final = frozenset({".parquet", ".pq"})
SBET_SUFFIXES: Final = frozenset({".out", ".sbet"})

SBET_RECORD: Final = np.dtype(
    [
        (name, "<f8")
        for name in (
            *("time", "latitude", "longitude", "altitude"),
            *("x_velocity", "y_velocity", "z_velocity"),
            *("roll", "pitch", "platform_heading", "wander_angle"),
            *("x_acceleration", "y_acceleration", "z_acceleration"),
            *("x_angular_rate", "y_angular_rate", "z_angular_rate"),
        )
    ]
)
"""One record of an SBET, as Applanix POSPac writes it: 17 doubles; seconds, radians, metres."""

BATCH_RECORDS: Final = 16_384
"""Records that are read at once, about [count]."""

ASTRAY_S: Final = 366 * 86_400.0
"""Times of a file lie within this of each other [s]."""

FARTHEST_M: Final = 1e8
"""No coordinate on Earth, in metres or degrees, is farther from zero."""

MOST_WRONG: Final = 0.1
"""Share of a file's records that may be left out: one that holds more is damaged as a whole."""

_END_BYTES: Final = 1 << 16
"""Bytes that are read of the end of a CSV [byte]."""

_NUMBER: Final = r"^\s*(?P<number>-?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*$"


def read_records(
    path: Path, warn: Callable[[str], object] | None = None
) -> Generator[Records, None, None]:
    """Records of a file that can be, in its order.

    Parameters
    ----------
    path : Path
        CSV (``gps_time,x,y,z``; any order and case, further columns allowed, comma,
        semicolon or tab), Parquet with the same columns, or SBET (``.out``, ``.sbet``).
    warn : callable, optional
        Called at the end with one sentence on what was left out, where something was.

    Yields
    ------
    time_s, position : (n,) and (n, 3) float64
        As the file has them; of an SBET longitude and latitude [deg] and height [m].

    Raises
    ------
    InputError
        If the file is missing or damaged, or more than :data:`MOST_WRONG` of its records cannot be.
    """
    sieve = _Sieve(path)
    for time, position in _batches(path, sieve):
        records = sieve.sound(time, position)
        if len(records[0]):
            yield records
    left_out = sieve.left_out()
    if left_out and warn is not None:
        warn(left_out)


def has_records(path: Path) -> bool:
    """Whether a file begins with records that can be; the errors are those of `read_records`."""
    return first_records(path) is not None


def first_records(path: Path) -> Records | None:
    """The records that a file begins with, some of them; None where it has none."""
    with closing(read_records(path)) as records:
        return next(records, None)


class _Sieve:
    """Lets those records of a file pass, in its order, that can be, and counts the others."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._records = self._wrong = 0
        self._first = ""
        self._middle_s: float | None = None

    def lose(self) -> None:
        """Count a row that is no record, wherever in the file it is."""
        self._wrong += 1
        self._records += 1

    def sound(self, time: NDArray[np.float64], position: NDArray[np.float64]) -> Records:
        """The records, of some, that can be."""
        sound = usable_times(time) & (np.abs(position) <= FARTHEST_M).all(axis=1)
        if self._middle_s is None and sound.any():
            self._middle_s = float(np.median(time[sound]))
        sound &= np.abs(time - (self._middle_s or 0.0)) <= ASTRAY_S
        wrong = len(time) - int(np.count_nonzero(sound))
        if wrong and not self._first:
            self._first = f"; the first is record {self._records + int(np.argmin(sound))}"
        self._wrong += wrong
        self._records += len(time)
        return time[sound], position[sound]

    def left_out(self) -> str:
        """What was left out of the file; empty where nothing was."""
        if not self._wrong:
            return ""
        share = f"{grouped(self._wrong)} of {counted(self._records, 'records')}"
        why = (
            "(no finite number, a time more than a year from the others, or a position beyond "
            f"{FARTHEST_M:.0e} m){self._first}"
        )
        if self._wrong > MOST_WRONG * self._records:
            raise InputError(str(self._path), f"{share} cannot be used {why}: remove them")
        return f"trajectory {self._path.name}: {share} left out {why}"


def _batches(path: Path, sieve: _Sieve) -> Iterator[Records]:
    """All records of a file; not finite where it has no number."""
    suffix = path.suffix.lower()
    if suffix in SBET_SUFFIXES:
        return _read_sbet(path)
    return _read_parquet(path) if suffix in PARQUET_SUFFIXES else _read_csv(path, sieve)


def _read_sbet(path: Path) -> Iterator[Records]:
    """Longitude and latitude [deg] and ellipsoidal height [m], some records at a time."""
    with open_input(path) as file:
        size, step = os.fstat(file.fileno()).st_size, SBET_RECORD.itemsize
        if size % step:
            raise InputError(
                str(path),
                f"has {size} bytes, an SBET a multiple of {step}: it is cut off or not an SBET,"
                " copy it again",
            )
        for start in range(0, size // step, BATCH_RECORDS):
            records = np.frombuffer(file.read(BATCH_RECORDS * step), SBET_RECORD)
            latitude, longitude = records["latitude"], records["longitude"]
            # Written so that NaN counts as wrong.
            wrong = ~((np.abs(latitude) <= np.pi / 2) & (np.abs(longitude) <= 2 * np.pi))
            if np.count_nonzero(wrong) > MOST_WRONG * len(wrong):
                first = int(np.argmax(wrong))
                raise InputError(
                    str(path),
                    f"record {start + first} has latitude {latitude[first]}, longitude"
                    f" {longitude[first]}; an SBET has radians: it is not an SBET, or name its"
                    " format by .csv or .parquet",
                )
            position = np.column_stack([longitude, latitude, records["altitude"]])
            position[wrong] = np.nan
            position[:, :2] = np.degrees(position[:, :2])
            # Copied, because a record has four times what is wanted of it.
            yield records["time"].astype(np.float64), position


def _read_parquet(path: Path) -> Iterator[Records]:
    with (
        open_input(path),
        as_input_fault(path, "is not a Parquet trajectory"),
        pq.ParquetFile(path) as file,
    ):
        names = columns_of(path, file.schema_arrow.names)
        rows = bounded(path, "records", file.metadata.num_rows, most=2**62)
        refuse_bomb(path, f"{rows} records", 8 * len(names) * rows, path.stat().st_size)
        for batch in file.iter_batches(BATCH_RECORDS, columns=names):
            time, *position = (_numbers(batch.column(name)) for name in names)
            yield time, np.column_stack(position)


def _read_csv(path: Path, sieve: _Sieve) -> Iterator[Records]:
    """Records of a CSV; NaN for what is no number, rows of other lengths are lost."""

    def strange(_row: object) -> str:
        sieve.lose()
        return "skip"

    with open_input(path) as file:
        line = file.readline(65_536).decode("utf-8-sig", errors="replace")
        delimiter = max(",;\t", key=line.count)
        given = next(csv.reader([line.strip().lstrip("#")], delimiter=delimiter), [])
        names = columns_of(path, given)
        _refuse_cut_record(path, file)
        if file.tell() == path.stat().st_size:
            return
        with (
            as_input_fault(path, "is not a CSV trajectory"),
            pyarrow.csv.open_csv(
                file,
                # Of the numbers any bytes are text then, which pyarrow decodes where it loses a
                # row.
                read_options=pyarrow.csv.ReadOptions(
                    column_names=given, use_threads=False, encoding="latin-1"
                ),
                parse_options=pyarrow.csv.ParseOptions(
                    delimiter=delimiter, invalid_row_handler=strange
                ),
                convert_options=pyarrow.csv.ConvertOptions(
                    include_columns=names, column_types=dict.fromkeys(names, pa.string())
                ),
            ) as reader,
        ):
            for batch in reader:
                time, *position = (_numbers_of_text(batch.column(name)) for name in names)
                yield time, np.column_stack(position)


def _refuse_cut_record(path: Path, file: BinaryIO) -> None:
    """Refuse a file that ends within a number: its rest would be taken for a coordinate."""
    here = file.tell()
    file.seek(max(path.stat().st_size - _END_BYTES, here))
    *lines, last = file.read().decode("utf-8", errors="replace").rstrip(" ").split("\n")
    file.seek(here)
    fields = [re.split(r"[,;\t]", line.rstrip())[-1] for line in (*lines[-1:], last)]
    digits = [len(field.partition(".")[2]) for field in fields]
    if last.strip() and digits[-1] < digits[0]:
        raise InputError(
            str(path),
            f"its last line ends without a line break and with fewer digits than the one before:"
            f" {last.strip()[-60:]!r}; it is cut off: copy it again, or end the line",
        )


def columns_of(path: Path, given: Sequence[str]) -> list[str]:
    """The file's own names of :data:`COLUMNS`."""
    by_name = {name.strip().lower(): name for name in reversed(given)}
    missing = [name for name in COLUMNS if name not in by_name]
    if missing:
        raise InputError(
            str(path),
            f"has no column {', '.join(missing)}; a trajectory has the columns"
            f" {', '.join(COLUMNS)}, this one {', '.join(n.strip()[:40] for n in given[:20])};"
            f" rename its columns to {','.join(COLUMNS)} (seconds, metres; in any order, with"
            " others between them)",
        )
    return [by_name[name] for name in COLUMNS]


def _numbers(column: pa.Array) -> NDArray[np.float64]:
    """Values of a column; NaN for what is missing."""
    return np.asarray(column.cast(pa.float64()).to_numpy(zero_copy_only=False), np.float64)


def _numbers_of_text(column: pa.Array) -> NDArray[np.float64]:
    """Numbers that words are; NaN for words that are none."""
    try:
        return _numbers(pc.utf8_trim_whitespace(column))
    except pa.ArrowInvalid:  # one at least is none: four times as slow
        return _numbers(pc.struct_field(pc.extract_regex(column, _NUMBER), "number"))
