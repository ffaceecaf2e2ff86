"""Frames, detections and points: the tables that coincidence processing goes from and to."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from spl_batch.constants import QUANTUM_M
from spl_batch.geiger.coincidence.settings import ArraySettings
from spl_batch.lattice.row_order import lexicographic_order
from spl_batch.numerics.attitude import rotations

Rows = NDArray[np.bool_] | NDArray[np.intp] | slice


@dataclass(frozen=True, slots=True)
class Table:
    """Fields of as many rows each; a field is a column of a file, or three that belong together."""

    #: Type of each field, and its columns in files.
    FIELDS: ClassVar[Mapping[str, tuple[Any, tuple[str, ...]]]]

    def __len__(self) -> int:
        return len(getattr(self, next(iter(self.FIELDS))))

    @classmethod
    def names(cls) -> tuple[str, ...]:
        """Names of all columns."""
        return tuple(name for _, names in cls.FIELDS.values() for name in names)

    @classmethod
    def of(cls, columns: Mapping[str, NDArray[Any]]) -> Self:
        """The table that a file's columns make."""
        return cls(
            *(
                columns[names[0]] if len(names) == 1 else np.stack([columns[n] for n in names], -1)
                for _, names in cls.FIELDS.values()
            )
        )

    def columns(self) -> dict[str, NDArray[Any]]:
        """What a file's columns hold, by name."""
        return {
            name: getattr(self, field) if len(names) == 1 else getattr(self, field)[:, k]
            for field, (_, names) in self.FIELDS.items()
            for k, name in enumerate(names)
        }

    def take(self, rows: Rows) -> Self:
        """Some of the rows."""
        return type(self)(*(getattr(self, field)[rows] for field in self.FIELDS))

    @classmethod
    def joined(cls, parts: Sequence[Self]) -> Self:
        """Rows of several parts, one after the other."""
        none = {n: np.empty(0, dtype) for dtype, names in cls.FIELDS.values() for n in names}
        parts = [cls.of(none), *parts]
        return cls(*(np.concatenate([getattr(p, field) for p in parts]) for field in cls.FIELDS))


@dataclass(frozen=True, slots=True)
class Frames(Table):
    """Images of the array, one for each laser pulse, in order of their numbers."""

    number: NDArray[np.int64]  #: (f,): strictly increasing.
    origin_m: NDArray[np.float64]  #: (f, 3): place of the sensor [m].
    #: (f, 3): heading clockwise from north, roll starboard wing down, pitch nose up [rad].
    attitude_rad: NDArray[np.float64]

    FIELDS: ClassVar = MappingProxyType(
        {
            "number": (np.int64, ("frame",)),
            "origin_m": (np.float64, ("x", "y", "z")),
            "attitude_rad": (np.float64, ("heading", "roll", "pitch")),
        }
    )

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
    xyz: NDArray[np.int64]  #: (n, 3): places on the survey's lattice [quanta].

    FIELDS: ClassVar = MappingProxyType(
        {
            "frame": (np.int64, ("frame",)),
            "detector": (np.int32, ("detector",)),
            "xyz": (np.int64, ("x", "y", "z")),
        }
    )

    def distinct(self) -> "Detections":
        """In order of frame and detector, each once: of several the first by place."""
        order = np.lexsort((*self.xyz.T[::-1], self.detector, self.frame))
        frame, detector = self.frame[order], self.detector[order]
        first = np.ones(len(order), np.bool_)
        first[1:] = (frame[1:] != frame[:-1]) | (detector[1:] != detector[:-1])
        return self.take(order[first])

    def of_frames(self, frames: Frames) -> "Detections":
        """Those of some frames, out of detections in order of their frames."""
        first = np.searchsorted(self.frame, frames.number)
        count = np.searchsorted(self.frame, frames.number, side="right") - first
        within = np.arange(int(count.sum())) - np.repeat(np.cumsum(count) - count, count)
        return self.take(np.repeat(first, count) + within)

    def ranges_m(self, frames: Frames, array: ArraySettings) -> NDArray[np.float32]:
        """Slant range of each detector's detection in each frame, (f, rows, columns) float32 [m].

        Infinite where there is none; detections of other frames are left out.
        """
        image = np.full((len(frames), array.detectors), np.inf, np.float32)
        row = np.searchsorted(frames.number, self.frame)
        known = row < len(frames)
        known[known] = frames.number[row[known]] == self.frame[known]
        row = row[known]
        away = self.xyz[known] * QUANTUM_M - frames.origin_m[row]
        image[row, self.detector[known]] = np.sqrt((away * away).sum(axis=1))
        return image.reshape(len(frames), array.rows, array.columns)


@dataclass(frozen=True, slots=True)
class Points(Table):
    """What coincidence processing delivers, in the order of x, y, z."""

    xyz: NDArray[np.int64]  #: (n, 3): places on the survey's lattice [quanta].
    #: (n,): detections for each look that interrogates a voxel there [1/1].
    intensity: NDArray[np.float32]
    kind: NDArray[np.uint8]  #: (n,): 1 surface, 2 ridge, 3 peak; 0 where the method does not tell.

    FIELDS: ClassVar = MappingProxyType(
        {
            "xyz": (np.int64, ("x", "y", "z")),
            "intensity": (np.float32, ("intensity",)),
            "kind": (np.uint8, ("kind",)),
        }
    )

    def in_order(self) -> "Points":
        """The same points in order."""
        return self.take(lexicographic_order([*self.xyz.T, self.kind, self.intensity]))
