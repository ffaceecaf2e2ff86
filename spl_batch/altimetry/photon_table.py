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
    """Noise rate that a product states."""

    along_m: NDArray[np.float64]  #: (m,): where, increasing [m].
    #: (m,): noise photons per metre of track and metre of height [1/m2].
    per_m2: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Cells:
    """Cells of the absolute along-track grid that hold photons, in order."""

    index: NDArray[np.int64]  #: (n,): cell number; it covers ``[index, index + 1)`` cell lengths.
    count: NDArray[np.int64]  #: (n,): photons [count].
    #: (n,): ends of the gate [quanta].
    low: NDArray[np.int32]
    high: NDArray[np.int32]
    #: (n,): height of the densest bins: the surface, where there is one [quanta].
    peak: NDArray[np.int32]
    #: (n,): photons, and length of gate, away from it [count, quanta].
    empty_count: NDArray[np.int64]
    empty_length: NDArray[np.int64]
    level: NDArray[np.int32]  #: (n,): water surface [quanta]; the least int32 where there is none.
    #: (n, d): noise by metre of depth below it, from the second metre on [1/m2].
    column: NDArray[np.float32]
    first: NDArray[np.float32]  #: (n,): noise of the first metre below it [1/m2].
    top: NDArray[np.int32]  #: (n,): water surface, not lowered by what lies below it [quanta].
    calm: NDArray[np.bool_]  #: (n,): whether the surface is water: it is too level for land.
    maybe: NDArray[np.bool_]  #: (n,): whether level cells between banks may be a river.
    dark: NDArray[np.bool_]  #: (n,): whether such water shows no light below: it may be a plain.
    #: (n,): steps between the densest layers of cells next to each other, their median, or what
    #: photons show that crowd in long boxes where that is less [m/m].
    slope: NDArray[np.float32]
    fog_low: NDArray[np.int32]  #: (n,): lower end of a cloud [quanta].
    #: (n, b): photons by height above that; 0 where there is no cloud [1/m2].
    fog: NDArray[np.float32]
    #: (n, 3): ends of what may be fog or woods [m], and its photons [count]; 0 where nothing is.
    mist: NDArray[np.float32]
    #: (n, 2): height of a floor in the middle of the cell, and its slope [m, m/m]; NaN where none.
    floor: NDArray[np.float32]

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
    """Noise of the same cells, and how neighbourhoods follow it.

    :mod:`spl_batch.altimetry.noise.planes` makes planes of it in which noise is equally dense.
    """

    index: NDArray[np.int64]  #: (n,): cell numbers.
    usual: NDArray[np.float64]  #: (n,): noise that is usual around [1/m2].
    aspect: NDArray[np.float64]  #: (n,): length over height of a neighbourhood where it is so.
    #: (n,): noise photons expected in the cell, and those of them below a water surface [count].
    noise: NDArray[np.float64]
    below: NDArray[np.float64]
    density: NDArray[np.float64]  #: (n,): noise photons above a water surface, or anywhere [1/m2].
    #: (n,): water surface, noise below it and in a cloud, as of :class:`Cells`.
    level: NDArray[np.int32]
    column: NDArray[np.float32]
    first: NDArray[np.float32]
    top: NDArray[np.int32]
    calm: NDArray[np.bool_]
    fog_low: NDArray[np.int32]
    fog: NDArray[np.float32]
    bed: NDArray[np.float64]  #: (n, 2): heights that neighbourhoods below a surface follow [m].
    neighbours: NDArray[np.int64]  #: (n,): neighbours that count [count].
    #: (n,): noise over the beam's median, water or not, and the start of the cell on that axis [m].
    stretch: NDArray[np.float64]
    stretched_m: NDArray[np.float64]

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """Arrays by name, for a file."""
        return {f.name: np.asarray(getattr(self, f.name)) for f in fields(self)}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> "Scale":
        """What :meth:`to_arrays` gave."""
        return cls(**{f.name: arrays[f.name] for f in fields(cls)})


def along_track(index: NDArray[np.int64], cell_m: float) -> dict[str, float]:
    """How long some cells are, where they lie [m], in how many pieces; empty where there is none.

    ``index``: numbers of the cells, in order.
    """
    if not len(index):
        return {}
    return {
        "length_m": len(index) * cell_m,
        "from_m": float(index[0] * cell_m),
        "to_m": float((index[-1] + 1) * cell_m),
        "pieces": 1.0 + np.count_nonzero(np.diff(index) > 1),
    }
