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

In the working store both are kept in order, in row groups that are found by place and by frame.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from spl_batch.constants import QUANTA_PER_M
from spl_batch.errors import InputError
from spl_batch.geiger.coincidence.model import Attitudes, Detections, Frames, Points
from spl_batch.geiger.coincidence.settings import ArraySettings
from spl_batch.io.atomic import replacing
from spl_batch.io.tables import read_between, read_columns, writing

FRAME_COLUMNS: Final = ("frame", "x", "y", "z", "heading", "roll", "pitch")
DETECTION_COLUMNS: Final = ("frame", "detector", "x", "y", "z")
_WHOLE: Final = frozenset({"frame", "detector"})
_FARTHEST_M: Final = 1e8
"""Coordinates beyond this are none of a projected CRS [m]."""


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
        reason = error.strerror or " ".join(str(error).split())
        raise InputError(str(path), f"cannot be read: {reason}") from error
    except pa.ArrowException as error:
        raise InputError(str(path), f"no Parquet file: {' '.join(str(error).split())}") from error
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
        return int(file.metadata.num_rows)


def extent_m(path: Path) -> tuple[float, float, float, float] | None:
    """West, south, east, north of a checked file, where its footer tells them [m]."""
    with pq.ParquetFile(path) as file:
        footer, names = file.metadata, file.schema_arrow.names
        ends = []
        for axis in "xy":
            columns = [
                footer.row_group(g).column(names.index(axis)).statistics
                for g in range(footer.num_row_groups)
            ]
            if not columns or any(c is None or not c.has_min_max for c in columns):
                return None
            ends.append((min(float(c.min) for c in columns), max(float(c.max) for c in columns)))
    (west, east), (south, north) = ends
    return west, south, east, north


def _fits(kind: pa.DataType, name: str) -> bool:
    number = pa.types.is_integer(kind) or pa.types.is_floating(kind)
    return bool(pa.types.is_integer(kind) if name in _WHOLE else number)


def _read(path: Path, columns: Sequence[str]) -> dict[str, NDArray[Any]]:
    """Columns of a file, integers as int64 and numbers as float64; finite all."""
    inspect(path, columns)
    try:
        table = pq.read_table(path, columns=list(columns), use_threads=False)
    except (OSError, pa.ArrowException) as error:
        reason = " ".join(str(error).split())
        raise InputError(str(path), f"damaged: {reason}; copy it again") from error
    faults, found = [], {}
    for name in columns:
        if table[name].null_count:
            faults.append(f"{table[name].null_count} rows have no {name!r}")
            continue
        values = table[name].to_numpy()
        if name in _WHOLE and len(values) and (values.max() > 2**62 or values.min() < 0):
            faults.append(f"{name!r} runs from {values.min()} to {values.max()}; count from 0")
            continue
        found[name] = values.astype(np.int64 if name in _WHOLE else np.float64)
        if name not in _WHOLE:
            bad = int((~(np.abs(found[name]) < _FARTHEST_M)).sum())
            faults += [f"{bad} values of {name!r} are no finite metres or radians"] if bad else []
    if faults:
        raise InputError(str(path), faults)
    return found


def read_frames(path: Path) -> Attitudes:
    """Frames of a file, in order.

    Raises
    ------
    InputError
        If the file is damaged, or names a frame twice.
    """
    columns = _read(path, FRAME_COLUMNS)
    order = np.argsort(columns["frame"], kind="stable")
    number = columns["frame"][order]
    twice = np.flatnonzero(number[1:] == number[:-1])
    if len(twice):
        raise InputError(
            str(path),
            f"{len(twice)} frames are there twice, the first is {number[twice[0]]}; "
            "number frames through",
        )
    origin, attitude = (
        np.stack([columns[k][order] for k in names], axis=-1)
        for names in (FRAME_COLUMNS[1:4], FRAME_COLUMNS[4:])
    )
    return Attitudes(number, origin, attitude)


def read_detections(path: Path, array: ArraySettings) -> Detections:
    """Detections of a file, in order of frame and detector.

    Raises
    ------
    InputError
        If the file is damaged, names detectors that the array has not, or one twice in a frame.
    """
    columns = _read(path, DETECTION_COLUMNS)
    frame, detector = columns["frame"], columns["detector"]
    outside = int((detector >= array.detectors).sum())
    if outside:
        raise InputError(
            str(path),
            f"{outside} detections of detectors up to {detector.max()}, but the array has "
            f"{array.rows} x {array.columns}; set array.rows and array.columns",
        )
    order = np.lexsort((detector, frame))
    frame, detector = frame[order], detector[order]
    twice = np.flatnonzero((frame[1:] == frame[:-1]) & (detector[1:] == detector[:-1]))
    if len(twice):
        raise InputError(
            str(path),
            f"{len(twice)} times a detector fires again in its frame, first detector "
            f"{detector[twice[0]]} of frame {frame[twice[0]]}; only the first detection counts",
        )
    xyz = np.stack([columns[k][order] for k in "xyz"], axis=-1)
    return Detections(
        frame, detector.astype(np.int32), np.rint(xyz * QUANTA_PER_M).astype(np.int64)
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


_TURN: Final = tuple(f"turn_{i}{j}" for i in range(3) for j in range(3))
_GROUP_FRAMES: Final = 64
_GROUP_ROWS: Final = 65_536


def store_frames(path: Path, frames: Frames) -> None:
    """Keep frames in the working store."""
    columns: dict[str, NDArray[Any]] = {"frame": frames.number, **_named("xyz", frames.origin_m)}
    columns |= _named(_TURN, frames.turn.reshape(-1, 9))
    _store(path, columns, _GROUP_FRAMES)


def stored_frames(
    path: Path, west_m: float, east_m: float, south_m: float, north_m: float
) -> Frames:
    """Frames that were taken over a rectangle; row groups are read whole, so more may come.

    Raises
    ------
    DamagedError
        If the file is missing or damaged.
    """
    # Bounds of a row group are compared as whole numbers.
    spans = {"x": (int(west_m) - 1, int(east_m) + 1), "y": (int(south_m) - 1, int(north_m) + 1)}
    return _frames(path, spans)


def _frames(path: Path, spans: Mapping[str, tuple[int, int]]) -> Frames:
    read, _ = read_between(path, ("frame", *"xyz", *_TURN), spans)
    turn = np.stack([read[k] for k in _TURN], axis=-1).reshape(-1, 3, 3)
    return Frames(read["frame"], np.stack([read[k] for k in "xyz"], axis=-1), turn)


def frames_around(path: Path, number: int) -> Frames:
    """Frames of the row group that a frame lies in; none where the file has it not."""
    return _frames(path, {"frame": (number, number)})


def frame_numbers(path: Path) -> NDArray[np.int64]:
    """Numbers of all frames of a file of the store, increasing: (f,) int64."""
    numbers: NDArray[np.int64] = read_columns(path, ("frame",))["frame"]
    return numbers


def store_detections(path: Path, detections: Detections) -> None:
    """Keep detections in the working store."""
    columns: dict[str, NDArray[Any]] = {
        "frame": detections.frame,
        "detector": detections.detector,
    }
    xyz = {name: detections.xyz[:, k] for k, name in enumerate("xyz")}
    _store(path, {**columns, **xyz}, _GROUP_ROWS)


def stored_detections(path: Path, first: int, last: int) -> Detections:
    """Detections of a span of frames; row groups are read whole, so more may come.

    Raises
    ------
    DamagedError
        If the file is missing or damaged.
    """
    read, _ = read_between(path, DETECTION_COLUMNS, {"frame": (first, last)})
    xyz = np.stack([read[k] for k in "xyz"], axis=-1)
    return Detections(read["frame"], read["detector"], xyz)


def store_points(path: Path, points: Points) -> None:
    """Keep points in the working store."""
    xyz = {name: points.xyz[:, k] for k, name in enumerate("xyz")}
    _store(path, {**xyz, "intensity": points.intensity, "kind": points.kind}, _GROUP_ROWS)


def stored_points(path: Path) -> Points:
    """Points of a file of the store.

    Raises
    ------
    DamagedError
        If the file is missing or damaged.
    """
    read = read_columns(path, (*"xyz", "intensity", "kind"))
    return Points(np.stack([read[k] for k in "xyz"], axis=-1), read["intensity"], read["kind"])


def _store(path: Path, columns: Mapping[str, NDArray[Any]], group: int) -> None:
    n = len(columns["frame"] if "frame" in columns else columns["x"])
    with writing(path, {name: values.dtype for name, values in columns.items()}) as writer:
        for start in range(0, max(n, 1), group):
            writer.write({name: values[start : start + group] for name, values in columns.items()})
