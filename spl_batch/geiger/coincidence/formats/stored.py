"""Frames, detections and points in the working store: Parquet, found by place and frame.

Frames lie in row groups that are found by the place of the sensor, detections in row groups that
are found by frame.
"""

from collections.abc import Iterable, Mapping
from itertools import chain
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.formats.verified.parquet_npz import groups_between, read_columns, read_with, writing
from spl_batch.geiger.coincidence.tables import Detections, Frames, Points

_TURN: Final = tuple(f"turn_{i}{j}" for i in range(3) for j in range(3))
_FRAMES: Final = ("frame", *"xyz", *_TURN)
_DETECTIONS: Final = ("frame", "detector", *"xyz")

_GROUP_FRAMES: Final = 512
"""A quarter of a second of the source's sensor, 25 m of flight [count]."""

_GROUP_ROWS: Final = 65_536


def _store(path: Path, parts: Iterable[Mapping[str, NDArray[Any]]], group_rows: int) -> None:
    """Keep columns in the working store, in row groups of so many rows at most."""
    parts = iter(parts)
    first = next(parts)
    with writing(path, {name: values.dtype for name, values in first.items()}) as writer:
        for columns in chain([first], parts):
            for start in range(0, len(columns[next(iter(columns))]), group_rows):
                rows = slice(start, start + group_rows)
                writer.write({name: values[rows] for name, values in columns.items()})


def store_frames(path: Path, frames: Frames) -> None:
    """Keep frames in the working store."""
    turn = frames.turn.reshape(-1, 9)
    columns: dict[str, NDArray[Any]] = {"frame": frames.number}
    columns |= {name: frames.origin_m[:, k] for k, name in enumerate("xyz")}
    columns |= {name: turn[:, k] for k, name in enumerate(_TURN)}
    _store(path, [columns], _GROUP_FRAMES)


def stored_frames(
    path: Path, west_m: float, east_m: float, south_m: float, north_m: float
) -> Frames:
    """Frames that were taken over a rectangle; row groups are read whole, so more may come."""
    # Bounds of a row group are compared as whole numbers.
    spans = {"x": (int(west_m) - 1, int(east_m) + 1), "y": (int(south_m) - 1, int(north_m) + 1)}
    return _frames(path, spans)


def _frames(path: Path, spans: Mapping[str, tuple[int, int]]) -> Frames:
    read, _ = groups_between(path, spans).read(_FRAMES)
    turn = np.stack([read[k] for k in _TURN], axis=-1).reshape(-1, 3, 3)
    return Frames(read["frame"], _xyz(read), turn)


def _xyz(read: Mapping[str, NDArray[Any]]) -> NDArray[Any]:
    return np.stack([read[k] for k in "xyz"], axis=-1)


def frames_around(path: Path, number: int) -> Frames:
    """Frames of the row group that a frame lies in; none where the file has it not."""
    return _frames(path, {"frame": (number, number)})


def known_frames(path: Path, numbers: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Which of some increasing numbers are of frames that a file of the store has: (n,) bool."""
    known = np.zeros(len(numbers), np.bool_)
    for columns in read_with(path, ("frame",), "frame", numbers):
        known |= np.isin(numbers, columns["frame"])
    return known


def store_detections(path: Path, parts: Iterable[Detections]) -> None:
    """Keep detections in the working store."""
    _store(path, map(_columns, chain([Detections.joined([])], parts)), _GROUP_ROWS)


def _columns(part: Detections) -> dict[str, NDArray[Any]]:
    columns: dict[str, NDArray[Any]] = {"frame": part.frame, "detector": part.detector}
    return columns | {name: part.xyz[:, k] for k, name in enumerate("xyz")}


def stored_detections(path: Path, numbers: NDArray[np.int64]) -> Detections:
    """Detections of some frames, whose numbers increase; a row group is held at a time."""
    parts = []
    for read in read_with(path, _DETECTIONS, "frame", numbers):
        part = Detections(read["frame"], read["detector"], _xyz(read))
        parts.append(part.take(np.isin(part.frame, numbers)))
    return Detections.joined(parts)


def store_points(path: Path, points: Points) -> None:
    """Keep points in the working store."""
    columns: dict[str, NDArray[Any]] = {name: points.xyz[:, k] for k, name in enumerate("xyz")}
    _store(path, [columns | {"intensity": points.intensity, "kind": points.kind}], _GROUP_ROWS)


def stored_points(path: Path) -> Points:
    """Points of a file of the store."""
    read = read_columns(path, (*"xyz", "intensity", "kind"))
    return Points(_xyz(read), read["intensity"], read["kind"])
