"""Records of trajectory files, some at a time: CSV, Parquet, SBET; and into another CRS."""

import csv
import io
import math
import re
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import BinaryIO, Final, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet as pq
from numpy.typing import NDArray
from pyproj import CRS, Transformer
from pyproj.exceptions import ProjError

from spl_batch.errors import InputError
from spl_batch.formats.crs import crs_name, crs_problems, horizontal, parse_crs
from spl_batch.formats.declared import bounded, refuse_bomb
from spl_batch.formats.las.header import open_input
from spl_batch.formats.trajectory.sbet import SBET_SUFFIXES, read_sbet
from spl_batch.formats.trajectory.usable import Records, Sieve

COLUMNS: Final = ("gps_time", "x", "y", "z")
"""Columns of a trajectory in CSV or Parquet."""

SBET_CRS: Final = "EPSG:4979"
"""CRS of an SBET unless the workflow names another: WGS 84, ellipsoidal heights."""

BATCH_RECORDS: Final = 65_536
"""Records that are read at once, about [count]."""

_LAST_BYTES: Final = 4096
"""Bytes at the end of a file that hold its last two lines."""

PARQUET_SUFFIXES: Final = frozenset({".parquet", ".pq"})


class CannotConvertError(Exception):
    """PROJ has no way for some position."""


class Conversion(NamedTuple):
    """A way of bringing positions into another CRS."""

    #: Positions (n, 3) to positions (n, 3) [m]; raises :class:`CannotConvertError`.
    convert: Callable[[NDArray[np.float64]], NDArray[np.float64]]
    warning: str  #: What it leaves undone; may be empty.


def read_records(path: Path, tell: Callable[[str], object] | None = None) -> Iterator[Records]:
    """Records of a file that can be, in its order.

    Parameters
    ----------
    path : Path
        CSV (``gps_time,x,y,z``; any order and case, further columns allowed, comma,
        semicolon or tab), Parquet with the same columns, or SBET (``.out``, ``.sbet``).
    tell : callable, optional
        Told at the end, in one sentence, what was left out, where something was.

    Yields
    ------
    time_s, position : (n,) and (n, 3) float64
        As the file has them; of an SBET longitude and latitude [deg] and height [m].

    Raises
    ------
    InputError
        If the file is missing or damaged, or has more records than a few that cannot be.
    """
    sieve = Sieve(path)
    suffix = path.suffix.lower()
    if suffix in SBET_SUFFIXES:
        batches = read_sbet(path)
    elif suffix in PARQUET_SUFFIXES:
        batches = _read_parquet(path)
    else:
        batches = _read_csv(path, sieve)
    for time, position in batches:
        records = sieve.sound(time, position)
        if len(records[0]):
            yield records
    left_out = sieve.told()
    if left_out and tell is not None:
        tell(left_out)


def conversions(path: Path, survey_crs: CRS | None, trajectory_crs: str | None) -> list[Conversion]:
    """Ways of bringing a file's positions into the survey's CRS, the best one first.

    Parameters
    ----------
    survey_crs : CRS or None
        CRS that positions are wanted in; none leaves them as they are.
    trajectory_crs : str or None
        CRS of the file; by default EPSG:4979 for SBET and the survey's for others.

    Raises
    ------
    InputError
        If there is none.
    """
    crs = _crs_of(path, trajectory_crs)
    if crs is None:
        return [Conversion(lambda position: position, "")]
    if survey_crs is None:
        raise InputError(
            str(path), f"is in {crs_name(crs)}, the survey has no CRS: name it in survey.crs"
        )
    problems = crs_problems(survey_crs, None, None)
    if problems:
        raise InputError(str(path), problems)
    found, warning = [], ""
    if len(crs.axis_info) == 3 and len(survey_crs.axis_info) == 3:
        found.append(Conversion(_projection(crs, survey_crs, best=True), ""))
        warning = (
            f"trajectory: heights stay those of {crs_name(crs)}; what converts them to"
            f" {crs_name(survey_crs)} is not installed (PROJ grids)"
        )
    flat = _projection(horizontal(crs), horizontal(survey_crs), best=False)
    # Heights beside degrees alone are in metres; beside feet they are in feet.
    counted = len(crs.axis_info) == 3 or not crs.is_geographic
    unit_m = crs.axis_info[-1].unit_conversion_factor if counted else 1.0

    def keep_heights(position: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.column_stack([flat(position)[:, :2], position[:, 2] * unit_m])

    return [*found, Conversion(keep_heights, warning)]


def _crs_of(path: Path, trajectory_crs: str | None) -> CRS | None:
    named = None
    if trajectory_crs is not None:
        named = parse_crs(trajectory_crs, "survey.trajectory_crs")
    if path.suffix.lower() not in SBET_SUFFIXES:
        return named
    crs = named or CRS.from_user_input(SBET_CRS)
    if not crs.is_geographic:
        raise InputError(
            str(path),
            f"an SBET has latitude and longitude, survey.trajectory_crs is {crs_name(crs)}:"
            " name a geographic CRS or leave it out",
        )
    return crs


def _projection(
    source: CRS, target: CRS, *, best: bool
) -> Callable[[NDArray[np.float64]], NDArray[np.float64]]:
    made: list[Transformer] = []

    def project(position: NDArray[np.float64]) -> NDArray[np.float64]:
        try:
            if not made:
                made.append(
                    Transformer.from_crs(
                        source, target, always_xy=True, only_best=best, allow_ballpark=not best
                    )
                )
            x, y, z = position.T
            xyz = np.column_stack(made[0].transform(x, y, z, errcheck=True))
        except ProjError as error:
            raise CannotConvertError from error
        if not np.isfinite(xyz).all():
            raise CannotConvertError
        return xyz

    return project


def _read_parquet(path: Path) -> Iterator[Records]:
    with open_input(path):
        pass
    try:
        with pq.ParquetFile(path) as file:
            names = columns_of(path, file.schema_arrow.names)
            rows = bounded(path, "records", file.metadata.num_rows, most=2**62)
            refuse_bomb(path, f"{rows} records", 8 * len(names) * rows, path.stat().st_size)
            for batch in file.iter_batches(BATCH_RECORDS, columns=names):
                yield _arrays(batch, names)
    except (OSError, pa.ArrowException) as error:
        raise InputError(str(path), f"is not a Parquet trajectory: {_line(error)}") from None


def _read_csv(path: Path, sieve: Sieve) -> Iterator[Records]:
    with open_input(path) as file:
        given, delimiter = csv_head(file)
        names = columns_of(path, given)
        _refuse_cut_record(path, file)
        done, begin = 0, file.tell()
        try:
            for batch in _csv_batches(file, given, names, delimiter):
                done += len(batch)
                yield _arrays(batch, names)
        except pa.ArrowException as error:
            sieve.reason = f"is not a CSV trajectory: {_line(error)}"
        else:
            return
    # A row is no record, or a word no number: value by value, which takes longer.
    with open_input(path) as file:
        file.seek(begin)
        text = io.TextIOWrapper(file, encoding="latin-1", newline="")
        rows = csv.reader(text, delimiter=delimiter)
        try:
            yield from _row_by_row(rows, [given.index(name) for name in names], done, sieve)
        except csv.Error:
            raise InputError(str(path), sieve.reason) from None


def _row_by_row(
    rows: Iterator[list[str]], columns: Sequence[int], done: int, sieve: Sieve
) -> Iterator[Records]:
    """Records of rows, from that one on that so many precede; NaN for what is no number."""
    found: list[list[float]] = []
    count = 0
    for row in rows:
        if len(row) <= max(columns):
            sieve.lose(bool(row))
            continue
        count += 1
        if count > done:
            found.append([_number(row[k]) for k in columns])
        if len(found) == BATCH_RECORDS:
            yield _columns(found)
            found.clear()
    if found:
        yield _columns(found)


def _columns(found: list[list[float]]) -> Records:
    values = np.array(found)
    return values[:, 0], values[:, 1:]


def _number(text: str) -> float:
    try:
        return math.nan if "_" in text else float(text)
    except ValueError:
        return math.nan


def _refuse_cut_record(path: Path, file: BinaryIO) -> None:
    """Refuse a file that ends within a number: what is left of it would be taken for a place."""
    here = file.tell()
    file.seek(max(path.stat().st_size - _LAST_BYTES, here))
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


def csv_head(file: BinaryIO) -> tuple[list[str], str]:
    """Columns that the first line of an open CSV names, and what parts them."""
    head = file.readline(65_536).decode("utf-8-sig", errors="replace")
    delimiter = max(",;\t", key=head.count)
    return next(
        csv.reader(io.StringIO(head.strip().lstrip("#")), delimiter=delimiter), []
    ), delimiter


def _csv_batches(
    file: BinaryIO, given: Sequence[str], names: Sequence[str], delimiter: str
) -> Iterator[pa.RecordBatch]:
    with pyarrow.csv.open_csv(
        file,
        read_options=pyarrow.csv.ReadOptions(column_names=given),
        parse_options=pyarrow.csv.ParseOptions(delimiter=delimiter),
        convert_options=pyarrow.csv.ConvertOptions(
            include_columns=names,
            column_types=dict.fromkeys(names, pa.float64()),
            null_values=[""],
        ),
    ) as reader:
        yield from reader


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


def _arrays(batch: pa.RecordBatch, names: Sequence[str]) -> Records:
    time, *position = (_numbers(batch.column(name)) for name in names)
    return time, np.column_stack(position)


def _numbers(column: pa.Array) -> NDArray[np.float64]:
    """Values of a column; NaN for what is missing."""
    values = column.cast(pa.float64()).to_numpy(zero_copy_only=False)
    return np.asarray(values, np.float64)


def _line(error: Exception) -> str:
    return " ".join(str(error).split())
