"""Tables in the working store: Parquet whose row groups are found by place and frame."""

from collections.abc import Iterable, Mapping
from itertools import chain
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.formats.verified.parquet_npz import groups_between, read_columns, read_with, writing
from spl_batch.geiger.coincidence.tables import Detections, Frames, Points, Table

_GROUP_ROWS: Final[Mapping[type[Table], int]] = {
    Frames: 512,
    Detections: 65_536,
    Points: 65_536,
}
"""Rows of a row group; 512 frames are a quarter of a second of the source's sensor [count]."""


def store(path: Path, kind: type[Table], parts: Iterable[Table]) -> None:
    """Keep parts of a table in the working store."""
    types = {name: dtype for dtype, names in kind.FIELDS.values() for name in names}
    with writing(path, types) as writer:
        for part in chain([kind.joined([])], parts):
            for start in range(0, len(part), _GROUP_ROWS[kind]):
                writer.write(part.take(slice(start, start + _GROUP_ROWS[kind])).columns())


def stored_frames(
    path: Path, west_m: float, east_m: float, south_m: float, north_m: float
) -> Frames:
    """Frames that were taken over a rectangle; row groups are read whole, so more may come."""
    # Bounds of a row group are compared as whole numbers.
    spans = {"x": (int(west_m) - 1, int(east_m) + 1), "y": (int(south_m) - 1, int(north_m) + 1)}
    return Frames.of(groups_between(path, spans).read(Frames.names())[0])


def frames_around(path: Path, number: int) -> Frames:
    """Frames of the row group that a frame lies in; none where the file has it not."""
    return Frames.of(groups_between(path, {"frame": (number, number)}).read(Frames.names())[0])


def known_frames(path: Path, numbers: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Which of some increasing numbers are of frames that a file of the store has: (n,) bool."""
    known = np.zeros(len(numbers), np.bool_)
    for columns in read_with(path, ("frame",), "frame", numbers):
        known |= np.isin(numbers, columns["frame"])
    return known


def stored_detections(path: Path, numbers: NDArray[np.int64]) -> Detections:
    """Detections of some frames, whose numbers increase; a row group is held at a time."""
    parts = []
    for columns in read_with(path, Detections.names(), "frame", numbers):
        part = Detections.of(columns)
        parts.append(part.take(np.isin(part.frame, numbers)))
    return Detections.joined(parts)


def stored_points(path: Path) -> Points:
    """Points of a file of the store."""
    return Points.of(read_columns(path, Points.names()))
