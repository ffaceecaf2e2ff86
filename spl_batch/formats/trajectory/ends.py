"""First and last time of a trajectory file, from its ends alone.

A look before the work. Records in between may lie outside; damage there is found when the file is
read (:mod:`spl_batch.formats.trajectory.records`).
"""

import csv
import io
import math
import os
from pathlib import Path
from typing import BinaryIO, Final

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from spl_batch.errors import as_input_fault
from spl_batch.formats.gps_clock import usable_times
from spl_batch.formats.las.header import open_input
from spl_batch.formats.trajectory.records import PARQUET_SUFFIXES, columns_of, csv_head
from spl_batch.formats.trajectory.sbet import SBET_RECORD, SBET_SUFFIXES

_END_BYTES: Final = 1 << 16
"""Bytes that are read of the end of a CSV, and half of those of its start [byte]."""


def ends(path: Path) -> tuple[float, float] | None:
    """First and last time of a trajectory in time order, as far as its ends tell.

    Parameters
    ----------
    path : Path
        CSV, Parquet or SBET.

    Returns
    -------
    (float, float) or None
        As the file has them [s]; None where the ends do not tell, as where rows are in no order.

    Raises
    ------
    InputError
        If the file cannot be opened, or has no such columns.
    """
    with as_input_fault(path):
        times = np.array(_at_both_ends(path))
    usable = usable_times(times)
    known = times[usable]
    tell = len(times) > 0 and bool(usable[[0, -1]].all() and (np.diff(known) >= 0).all())
    return (float(known[0]), float(known[-1])) if tell else None


def _at_both_ends(path: Path) -> list[float]:
    """Times from both ends of a file, in its order."""
    suffix = path.suffix.lower()
    if suffix in PARQUET_SUFFIXES:
        return _of_parquet(path)
    with open_input(path) as file:
        return _of_sbet(file) if suffix in SBET_SUFFIXES else _of_csv(path, file)


def _of_parquet(path: Path) -> list[float]:
    try:
        with open_input(path), pq.ParquetFile(path) as file:
            names = columns_of(path, file.schema_arrow.names)[:1]
            groups = {0, file.num_row_groups - 1} if file.num_row_groups else ()
            time = [file.read_row_group(k, names).column(0).to_numpy() for k in sorted(groups)]
    except (OSError, pa.ArrowException):
        return []  # the run says what is wrong with it
    return [float(value) for values in time for value in values]


def _of_sbet(file: BinaryIO) -> list[float]:
    size, step = file.seek(0, os.SEEK_END), SBET_RECORD.itemsize
    found = []
    for record in (0, size // step - 1) if size >= step else ():
        file.seek(record * step)
        found.append(float(np.frombuffer(file.read(step), SBET_RECORD)["time"][0]))
    return found


def _of_csv(path: Path, file: BinaryIO) -> list[float]:
    given, delimiter = csv_head(file)
    column = given.index(columns_of(path, given)[0])
    text = file.read(2 * _END_BYTES)
    left = os.fstat(file.fileno()).st_size - file.tell()
    if left:
        file.seek(-min(left, _END_BYTES), os.SEEK_END)
        text = text[: text.rfind(b"\n") + 1] + file.read().partition(b"\n")[2]
    rows = csv.reader(io.StringIO(text.decode("utf-8", errors="replace")), delimiter=delimiter)
    return [_number(row[column]) if len(row) > column else math.nan for row in rows if any(row)]


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan
