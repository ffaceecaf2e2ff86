"""First and last time of a trajectory file, from its ends alone.

A look before the work: records in between may lie outside, and what is damaged there is found
when the file is read (:mod:`spl_batch.formats.trajectory.records`).
"""

import csv
import io
import os
from pathlib import Path
from typing import BinaryIO, Final

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from spl_batch.errors import as_input_fault
from spl_batch.formats.las.header import open_input
from spl_batch.formats.trajectory.records import PARQUET_SUFFIXES, columns_of, csv_head
from spl_batch.formats.trajectory.sbet import SBET_RECORD, SBET_SUFFIXES

_END_BYTES: Final = 1 << 16
"""What is read of each end of a CSV [byte]."""


def ends(path: Path) -> tuple[float, float] | None:
    """Smaller and larger of the first and the last time of a trajectory.

    Parameters
    ----------
    path : Path
        CSV, Parquet or SBET.

    Returns
    -------
    (float, float) or None
        As the file has them [s]; None where the ends do not tell.

    Raises
    ------
    InputError
        If the file cannot be opened, or has no such columns.
    """
    with as_input_fault(path):
        found = _first_and_last(path)
    times = [time for time in found if np.isfinite(time)]
    return (min(times), max(times)) if len(times) > 1 else None


def _first_and_last(path: Path) -> list[float]:
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
    return [float(values[k]) for values in time if len(values) for k in (0, -1)]


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
    first = file.read(_END_BYTES)
    start = max(file.seek(0, os.SEEK_END) - _END_BYTES, 0)
    file.seek(start)
    last = file.read()
    lines = [first.split(b"\n", 1)[0], last.rstrip().rsplit(b"\n", 1)[-1]]
    found = []
    for line in lines:
        text = line.decode("utf-8", errors="replace")
        row = next(csv.reader(io.StringIO(text), delimiter=delimiter), [])
        try:
            found.append(float(row[column]))
        except (IndexError, ValueError):
            continue
    return found
