"""Photons or reference heights as CSV with columns along_track and height, in metres."""

import io
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.csv
from numpy.typing import NDArray

from spl_batch.altimetry.photon_table import Slice
from spl_batch.errors import InputError
from spl_batch.formats.las.header import open_input

NEEDED: Final = ("along_track", "height")
_PLACE: Final = ("latitude", "longitude")
_HEAD_BYTES: Final = 1 << 16

_MOST_PER_M: Final = 500.0
_MANY: Final = 1000
"""Photons of a metre of track that no instrument gives, and photons that show it [1/m, count]."""


def estimate(path: Path, size_bytes: int) -> int:
    """Photons of a file by the length of its first lines [count]; its columns are checked."""
    with open_input(path) as stream:
        head = stream.read(_HEAD_BYTES)
    _names(path, head)
    return max(int(size_bytes / len(head) * max(head.count(b"\n") - 1, 1)), 1)


def is_track(path: Path) -> bool:
    """Whether the first line of a file names the columns that are needed."""
    try:
        return estimate(path, 0) > 0
    except InputError:
        return False


def check_unit(path: Path, photons: int, length_m: float) -> None:
    """Refuse a track whose distances can be no metres: more photons lie on one than are possible.

    In kilometres or degrees a track has a thousand times as many on each and more.

    Raises
    ------
    InputError
        Where more than 500 photons lie on a metre, of 1000 and more.
    """
    if photons < _MANY or photons <= _MOST_PER_M * length_m:
        return
    raise InputError(
        str(path),
        f"column along_track has {photons} photons on {length_m:.4g} of track, which would be "
        f"{photons / max(length_m, 1e-3):.0f} a metre: it is not in metres; give the distance "
        "along the track in metres (kilometres times 1000, no degrees), heights in metres too",
    )


def _names(path: Path, head: bytes) -> dict[str, str]:
    """Known column -> its name in the file."""
    try:
        line = head.split(b"\n", 1)[0].decode("utf-8-sig").strip()
    except UnicodeDecodeError:
        raise InputError(str(path), "is neither HDF5 nor text; name photon files only") from None
    names = {name.strip().strip('"').lower(): name.strip().strip('"') for name in line.split(",")}
    missing = [name for name in NEEDED if name not in names]
    if missing:
        raise InputError(
            str(path),
            f"no column {' and '.join(missing)} (found {line[:120]!r}); rename its columns to"
            " along_track,height, in metres, with commas between; latitude,longitude and others may"
            " follow",
        )
    return {k: names[k] for k in (*NEEDED, *_PLACE) if k in names}


def slices(path: Path) -> Iterator[Slice]:
    """Photons by batches of a MiB of text, 262 144 at most."""
    with open_input(path) as stream:
        names = _names(path, stream.read(_HEAD_BYTES))
        stream.seek(0)
        for batch in _batches(path, stream, names):
            unknown = np.full(batch.num_rows, np.nan)
            columns = (
                batch.column(names[k]).to_numpy(zero_copy_only=False) if k in names else unknown
                for k in (*NEEDED, *_PLACE)
            )
            yield Slice(*columns)


def _batches(path: Path, stream: Any, names: dict[str, str]) -> Iterator[pa.RecordBatch]:
    options = pa.csv.ConvertOptions(
        column_types=dict.fromkeys(names.values(), pa.float64()),
        include_columns=list(names.values()),
    )
    try:
        reader = pa.csv.open_csv(
            stream, read_options=pa.csv.ReadOptions(use_threads=False), convert_options=options
        )
        yield from reader
    except (pa.ArrowException, KeyError) as error:  # of a column that is lost too
        reason = " ".join(str(error).split())
        raise InputError(str(path), _no_number(path, reason)) from None


_CELL: Final = re.compile(r"CSV column #(\d+): (?:Row #(\d+): )?.*invalid value '(.*)'$")


def _no_number(path: Path, reason: str) -> str:
    """Pyarrow's reason for a table that is none of numbers, with the column's name."""
    found = _CELL.search(reason)
    if found is None:
        return f"cannot be read as numbers: {reason[:200]}"
    column, row, value = found.groups()
    with open_input(path) as stream:
        head = stream.readline(_HEAD_BYTES).decode("utf-8-sig", "replace")
    name = head.split(",")[int(column)].strip().strip('"')
    at = f", line {row}" if row else ""
    return (
        f"column {name}{at}: {value[:40]!r} is no number; write numbers with a point, and nothing "
        "or nan where a value is unknown"
    )


def read_profile(path: Path) -> NDArray[np.float64]:
    """Reference heights, in order of distance: (m, 2) float64 [m].

    Raises
    ------
    InputError
        If a column is missing, a value is no number, or there are fewer than two.
    """
    parts = [np.stack([s.along_m, s.height_m], axis=1) for s in slices(path)]
    whole: NDArray[np.float64] = np.concatenate([np.empty((0, 2)), *parts])
    whole = whole[np.isfinite(whole).all(axis=1)]
    if len(whole) < 2:
        raise InputError(str(path), f"{len(whole)} reference heights; at least 2 are needed")
    ordered: NDArray[np.float64] = whole[np.argsort(whole[:, 0], kind="stable")]
    return ordered


def to_text(columns: dict[str, NDArray[Any]]) -> bytes:
    """Columns as the text of a CSV file; NaN is empty."""
    buffer = io.BytesIO()
    values = {name: pa.array(column, from_pandas=True) for name, column in columns.items()}
    pa.csv.write_csv(pa.table(values), buffer)
    return buffer.getvalue()
