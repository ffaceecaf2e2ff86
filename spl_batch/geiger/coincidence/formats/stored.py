"""Frames, detections and points in the working store: Parquet in order, found by place and frame.

Frames lie in row groups that are found by the place of the sensor, detections in row groups that
are found by frame.
"""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.formats.verified.parquet_npz import read_between, read_columns, read_with, writing
from spl_batch.geiger.coincidence.tables import Detections, Frames, Points

_TURN: Final = tuple(f"turn_{i}{j}" for i in range(3) for j in range(3))
_FRAMES: Final = ("frame", *"xyz", *_TURN)
_DETECTIONS: Final = ("frame", "detector", *"xyz")

_GROUP_FRAMES: Final = 512
"""A quarter of a second of the source's sensor, 25 m of flight [count]."""

_GROUP_ROWS: Final = 65_536


def store_frames(path: Path, parts: Iterable[Frames]) -> None:
    """Keep frames in the working store; parts come in order."""
    dtypes: dict[str, Any] = dict.fromkeys(_FRAMES, np.float64) | {"frame": np.int64}
    with writing(path, dtypes) as writer:
        for part in parts:
            turn = part.turn.reshape(-1, 9)
            for start in range(0, len(part), _GROUP_FRAMES):
                rows = slice(start, start + _GROUP_FRAMES)
                columns: dict[str, NDArray[Any]] = {"frame": part.number[rows]}
                columns |= {k: part.origin_m[rows, i] for i, k in enumerate("xyz")}
                columns |= {k: turn[rows, i] for i, k in enumerate(_TURN)}
                writer.write(columns)


def stored_frames(
    path: Path, west_m: float, east_m: float, south_m: float, north_m: float
) -> Frames:
    """Frames that were taken over a rectangle; row groups are read whole, so more may come."""
    # Bounds of a row group are compared as whole numbers.
    spans = {"x": (int(west_m) - 1, int(east_m) + 1), "y": (int(south_m) - 1, int(north_m) + 1)}
    return _frames(path, spans)


def _frames(path: Path, spans: Mapping[str, tuple[int, int]]) -> Frames:
    read, _ = read_between(path, _FRAMES, spans)
    turn = np.stack([read[k] for k in _TURN], axis=-1).reshape(-1, 3, 3)
    return Frames(read["frame"], np.stack([read[k] for k in "xyz"], axis=-1), turn)


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
    """Keep detections in the working store; parts come in order."""
    dtypes: dict[str, Any] = dict.fromkeys(_DETECTIONS, np.int64) | {"detector": np.int32}
    with writing(path, dtypes) as writer:
        for part in parts:
            for start in range(0, len(part), _GROUP_ROWS):
                rows = slice(start, start + _GROUP_ROWS)
                columns: dict[str, NDArray[Any]] = {
                    "frame": part.frame[rows],
                    "detector": part.detector[rows],
                }
                columns |= {name: part.xyz[rows, k] for k, name in enumerate("xyz")}
                writer.write(columns)


def stored_detections(path: Path, numbers: NDArray[np.int64]) -> Detections:
    """Detections of some frames, whose numbers increase; a row group is held at a time."""
    parts = []
    for read in read_with(path, _DETECTIONS, "frame", numbers):
        rows = np.isin(read["frame"], numbers)
        xyz = np.stack([read[k][rows] for k in "xyz"], axis=-1)
        parts.append(Detections(read["frame"][rows], read["detector"][rows], xyz))
    return Detections.joined(parts)


def store_points(path: Path, points: Points) -> None:
    """Keep points in the working store."""
    columns: dict[str, NDArray[Any]] = {name: points.xyz[:, k] for k, name in enumerate("xyz")}
    columns |= {"intensity": points.intensity, "kind": points.kind}
    with writing(path, {name: values.dtype for name, values in columns.items()}) as writer:
        for start in range(0, max(len(points), 1), _GROUP_ROWS):
            rows = slice(start, start + _GROUP_ROWS)
            writer.write({name: values[rows] for name, values in columns.items()})


def stored_points(path: Path) -> Points:
    """Points of a file of the store."""
    read = read_columns(path, (*"xyz", "intensity", "kind"))
    return Points(np.stack([read[k] for k in "xyz"], axis=-1), read["intensity"], read["kind"])
