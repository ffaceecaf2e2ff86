"""Columns of a photon table, and the values that travel between the altimetry stages."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.constants import QUANTA_PER_M

PHOTONS: Final[Mapping[str, type]] = {"row": np.int64, "along": np.int64, "height": np.int32}
"""Position in the file; along-track distance and height [quanta of 1 mm]."""

LABELS: Final[Mapping[str, type]] = {
    "row": np.int64,
    "along": np.int64,
    "height": np.int32,
    "score": np.float32,
    "far": np.uint8,
    "below": np.uint8,
    "baseline": np.uint8,
}
"""Score: mean ln P(noise); far: away from any surface; below: below a water surface;
baseline: signal by mDBSCAN."""

SIGNAL: Final = 1
NOISE: Final = 0
NOT_ASSESSED: Final = 255
"""Values of a photon's label."""


@dataclass(frozen=True, slots=True)
class Background:
    """Noise rate that a product states.

    Parameters
    ----------
    along_m : (m,) float64
        Where, increasing [m].
    per_m2 : (m,) float64
        Noise photons per metre of track and metre of height [1/m2].
    """

    along_m: NDArray[np.float64]
    per_m2: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Cells:
    """Cells of the absolute along-track grid that hold photons, in order.

    Parameters
    ----------
    index : (n,) int64
        Cell number; it covers ``[index, index + 1)`` cell lengths.
    count : (n,) int64
        Photons [count].
    low, high : (n,) int32
        Ends of the gate [quanta].
    peak : (n,) int32
        Height of the densest bins: the surface, where there is one [quanta].
    empty_count, empty_length : (n,) int64
        Photons, and length of gate, away from it [count, quanta].
    level : (n,) int32
        Water surface [quanta]; the least int32 where there is none.
    column : (n, d) float32
        Noise by metre of depth below it [1/m2].
    slope : (n,) float32
        Steps between the densest layers of cells next to each other, their median [m/m].
    """

    index: NDArray[np.int64]
    count: NDArray[np.int64]
    low: NDArray[np.int32]
    high: NDArray[np.int32]
    peak: NDArray[np.int32]
    empty_count: NDArray[np.int64]
    empty_length: NDArray[np.int64]
    level: NDArray[np.int32]
    column: NDArray[np.float32]
    slope: NDArray[np.float32]

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """Arrays by name, for a file."""
        return {f.name: getattr(self, f.name) for f in fields(self)}

    @property
    def gate_m(self) -> NDArray[np.float64]:
        """Length of the gate, (n,) float64 [m]."""
        length: NDArray[np.float64] = (self.high.astype(np.int64) - self.low) / QUANTA_PER_M
        return length


@dataclass(frozen=True, slots=True)
class Scale:
    """The along-track axis scaled by the noise rate, on the same cells.

    One unit of the scaled plane is ``unit_m`` in height and holds ``alpha`` noise photons
    per square; along the track it is as long as that takes.

    Parameters
    ----------
    index : (n,) int64
        Cell numbers.
    start : (n,) float64
        Scaled position of the cell's start [units].
    per_m : (n,) float64
        Units per metre of track within the cell [1/m].
    cap : (n,) float64
        Farthest neighbour that counts; nowhere farther along the track than the reach [units].
    alpha : (n,) float64
        Noise photons per square unit; 1 unless the reach is what limits a unit's length.
    noise, below : (n,) float64
        Noise photons expected in the cell, and those of them below a water surface [count].
    density : (n,) float64
        Noise photons above a water surface, or anywhere [1/m2].
    level, column : (n,) int32, (n, d) float32
        Water surface and noise below it, as of :class:`Cells`.
    stretch, stretched_m : (n,) float64
        Noise over the reference, water or not, and the start of the cell on that axis [m].
    unit_m, reference : float
        Height of a unit [m]; noise density that gives a unit its aspect [1/m2].
    """

    index: NDArray[np.int64]
    start: NDArray[np.float64]
    per_m: NDArray[np.float64]
    cap: NDArray[np.float64]
    alpha: NDArray[np.float64]
    noise: NDArray[np.float64]
    below: NDArray[np.float64]
    density: NDArray[np.float64]
    level: NDArray[np.int32]
    column: NDArray[np.float32]
    stretch: NDArray[np.float64]
    stretched_m: NDArray[np.float64]
    unit_m: float
    reference: float

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """Arrays by name, for a file."""
        return {f.name: np.asarray(getattr(self, f.name)) for f in fields(self)}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> "Scale":
        """What :meth:`to_arrays` gave."""
        values = {f.name: arrays[f.name] for f in fields(cls)}
        return cls(
            **{k: v for k, v in values.items() if v.ndim},
            unit_m=float(values["unit_m"]),
            reference=float(values["reference"]),
        )
