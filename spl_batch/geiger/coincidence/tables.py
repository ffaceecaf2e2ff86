"""Frames, detections and points: the tables that coincidence processing goes from and to."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from types import MappingProxyType
from typing import Any, Final, Self

import numpy as np
from numpy.typing import NDArray

from spl_batch.constants import QUANTUM_M
from spl_batch.geiger.coincidence.settings import ArraySettings
from spl_batch.lattice.row_order import lexicographic_order
from spl_batch.numerics.attitude import rotations

Rows = NDArray[np.bool_] | NDArray[np.intp] | slice

COLUMNS: Final[Mapping[str, tuple[Any, tuple[str, ...]]]] = MappingProxyType(
    {
        "number": (np.int64, ("frame",)),
        "origin_m": (np.float64, ("x", "y", "z")),
        "attitude_rad": (np.float64, ("heading", "roll", "pitch")),
        "frame": (np.int64, ("frame",)),
        "detector": (np.int32, ("detector",)),
        "xyz": (np.int64, ("x", "y", "z")),
        "intensity": (np.float32, ("intensity",)),
        "kind": (np.uint8, ("kind",)),
    }
)
"""Type of each field of a table, and its columns in files: one, or three that belong together."""


@dataclass(frozen=True, slots=True)
class Table:
    """Fields of as many rows each."""

    @classmethod
    def types(cls) -> dict[str, Any]:
        """Type of each column of a file, in order."""
        return {name: COLUMNS[f.name][0] for f in fields(cls) for name in COLUMNS[f.name][1]}

    def __len__(self) -> int:
        return len(getattr(self, fields(self)[0].name))

    @classmethod
    def of(cls, columns: Mapping[str, NDArray[Any]]) -> Self:
        """The table that a file's columns make."""
        parts = [[columns[name] for name in COLUMNS[field.name][1]] for field in fields(cls)]
        return cls(*(one[0] if len(one) == 1 else np.stack(one, -1) for one in parts))

    def columns(self) -> dict[str, NDArray[Any]]:
        """What a file's columns hold, by name."""
        found: dict[str, NDArray[Any]] = {}
        for field in fields(self):
            names, values = COLUMNS[field.name][1], getattr(self, field.name)
            found |= zip(names, values.T if len(names) > 1 else (values,), strict=True)
        return found

    def take(self, rows: Rows) -> Self:
        """Some of the rows."""
        return type(self)(*(getattr(self, field.name)[rows] for field in fields(self)))

    @classmethod
    def joined(cls, parts: Sequence[Self]) -> Self:
        """Rows of several parts, one after the other."""
        parts = [cls.of({name: np.empty(0, t) for name, t in cls.types().items()}), *parts]
        return cls(*(np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(cls)))


@dataclass(frozen=True, slots=True)
class Frames(Table):
    """Images of the array, one for each laser pulse, in order of their numbers."""

    number: NDArray[np.int64]  #: (f,): strictly increasing.
    origin_m: NDArray[np.float64]  #: (f, 3): position of the sensor [m].
    #: (f, 3): heading clockwise from north, roll starboard wing down, pitch nose up [rad].
    attitude_rad: NDArray[np.float64]

    @property
    def turn(self) -> NDArray[np.float64]:
        """Starboard, nose, up of the array as columns: east, north, up of each, (f, 3, 3)."""
        return rotations(*self.attitude_rad.T)

    def in_order(self) -> "Frames":
        """The same frames in order."""
        return self.take(np.argsort(self.number, kind="stable"))


@dataclass(frozen=True, slots=True)
class Detections(Table):
    """Where detectors fired, at most once in a frame."""

    frame: NDArray[np.int64]  #: (n,): number of the frame.
    detector: NDArray[np.int32]  #: (n,): ``row * columns + column``.
    xyz: NDArray[np.int64]  #: (n, 3): points on the survey's lattice [quanta].

    def distinct(self) -> "Detections":
        """In order of frame and detector, each once: of several the first by position."""
        order = np.lexsort((*self.xyz.T[::-1], self.detector, self.frame))
        frame, detector = self.frame[order], self.detector[order]
        first = np.ones(len(order), np.bool_)
        first[1:] = (frame[1:] != frame[:-1]) | (detector[1:] != detector[:-1])
        return self.take(order[first])

    def seen_from(
        self, frames: Frames
    ) -> tuple["Detections", NDArray[np.intp], NDArray[np.float64]]:
        """Those of some frames, the row of each one's frame, and its way from there, (n, 3) [m]."""
        own = self.take(np.isin(self.frame, frames.number))
        row = np.searchsorted(frames.number, own.frame)
        return own, row, own.xyz * QUANTUM_M - frames.origin_m[row]

    def ranges_m(self, frames: Frames, array: ArraySettings) -> NDArray[np.float32]:
        """Slant range of each detector's detection in each frame, (f, rows, columns) float32 [m].

        Infinite where there is none; detections of other frames are left out.
        """
        image = np.full((len(frames), array.detectors), np.inf, np.float32)
        own, row, away = self.seen_from(frames)
        image[row, own.detector] = np.sqrt((away * away).sum(axis=1))
        return image.reshape(len(frames), array.rows, array.columns)


@dataclass(frozen=True, slots=True)
class Points(Table):
    """What coincidence processing delivers, in the order of x, y, z."""

    xyz: NDArray[np.int64]  #: (n, 3): points on the survey's lattice [quanta].
    #: (n,): detections for each look that interrogates a voxel there [1/1].
    intensity: NDArray[np.float32]
    kind: NDArray[np.uint8]  #: (n,): 1 surface, 2 ridge, 3 peak.

    def in_order(self) -> "Points":
        """The same points in order."""
        return self.take(lexicographic_order([*self.xyz.T, self.kind, self.intensity]))
