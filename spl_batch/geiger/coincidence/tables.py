"""Frames, detections and points: the tables that coincidence processing goes from and to."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from spl_batch.constants import QUANTUM_M
from spl_batch.geiger.coincidence.settings import ArraySettings
from spl_batch.lattice.row_order import lexicographic_order


@dataclass(frozen=True, slots=True)
class Attitudes:
    """Frames as their files have them."""

    number: NDArray[np.int64]  #: (f,): strictly increasing.
    origin_m: NDArray[np.float64]  #: (f, 3): place of the sensor [m].
    #: (f, 3): heading clockwise from north, roll starboard wing down, pitch nose up [rad].
    attitude_rad: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.number)


@dataclass(frozen=True, slots=True)
class Frames:
    """Images of the array, one for each laser pulse, in order of their numbers."""

    number: NDArray[np.int64]  #: (f,): strictly increasing.
    origin_m: NDArray[np.float64]  #: (f, 3): place of the sensor [m].
    #: (f, 3, 3): starboard, nose, up of the array as columns: east, north, up of each.
    turn: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.number)

    def take(self, rows: NDArray[np.bool_] | NDArray[np.intp]) -> "Frames":
        """Some of the frames."""
        return Frames(self.number[rows], self.origin_m[rows], self.turn[rows])

    @classmethod
    def joined(cls, parts: Sequence["Frames"]) -> Self:
        """Frames of several parts, in order."""
        number = np.concatenate([np.empty(0, np.int64), *(p.number for p in parts)])
        order = np.argsort(number, kind="stable")
        return cls(
            number[order],
            np.concatenate([np.empty((0, 3)), *(p.origin_m for p in parts)])[order],
            np.concatenate([np.empty((0, 3, 3)), *(p.turn for p in parts)])[order],
        )


@dataclass(frozen=True, slots=True)
class Detections:
    """Where detectors fired, at most once in a frame."""

    frame: NDArray[np.int64]  #: (n,): number of the frame.
    detector: NDArray[np.int32]  #: (n,): ``row * columns + column``.
    xyz: NDArray[np.int64]  #: (n, 3): places on the survey's lattice [quanta].

    def __len__(self) -> int:
        return len(self.frame)

    def take(self, rows: NDArray[np.bool_] | NDArray[np.intp]) -> "Detections":
        """Some of the detections."""
        return Detections(self.frame[rows], self.detector[rows], self.xyz[rows])

    @classmethod
    def joined(cls, parts: Sequence["Detections"]) -> Self:
        """Detections of several parts, one after the other."""
        return cls(
            np.concatenate([np.empty(0, np.int64), *(p.frame for p in parts)]),
            np.concatenate([np.empty(0, np.int32), *(p.detector for p in parts)]),
            np.concatenate([np.empty((0, 3), np.int64), *(p.xyz for p in parts)]),
        )

    def distinct(self) -> "Detections":
        """In order of frame and detector, each once: of several the first by place."""
        order = np.lexsort((*self.xyz.T[::-1], self.detector, self.frame))
        frame, detector = self.frame[order], self.detector[order]
        first = np.ones(len(order), np.bool_)
        first[1:] = (frame[1:] != frame[:-1]) | (detector[1:] != detector[:-1])
        return self.take(order[first])

    def of(self, frames: Frames) -> "Detections":
        """Those of some frames, out of detections in order of their frames."""
        first = np.searchsorted(self.frame, frames.number)
        count = np.searchsorted(self.frame, frames.number, side="right") - first
        within = np.arange(int(count.sum())) - np.repeat(np.cumsum(count) - count, count)
        return self.take(np.repeat(first, count) + within)

    def ranges_m(self, frames: Frames, array: ArraySettings) -> NDArray[np.float32]:
        """Slant range of each detector's detection in each frame.

        Parameters
        ----------
        frames : Frames
            Detections of other frames are left out.

        Returns
        -------
        (f, rows, columns) float32
            Infinite where there is none [m].
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
class Points:
    """What coincidence processing delivers, in the order of x, y, z."""

    xyz: NDArray[np.int64]  #: (n, 3): places on the survey's lattice [quanta].
    #: (n,): detections for each look that interrogates a voxel there [1/1].
    intensity: NDArray[np.float32]
    kind: NDArray[np.uint8]  #: (n,): 1 surface, 2 ridge, 3 peak; 0 where the method does not tell.

    def __len__(self) -> int:
        return len(self.xyz)

    def in_order(self) -> "Points":
        """The same points in order."""
        order = lexicographic_order([*self.xyz.T, self.kind, self.intensity])
        return Points(self.xyz[order], self.intensity[order], self.kind[order])

    @classmethod
    def joined(cls, parts: Sequence["Points"]) -> Self:
        """Points of several parts, one after the other."""
        return cls(
            np.concatenate([np.empty((0, 3), np.int64), *(p.xyz for p in parts)]),
            np.concatenate([np.empty(0, np.float32), *(p.intensity for p in parts)]),
            np.concatenate([np.empty(0, np.uint8), *(p.kind for p in parts)]),
        )
