"""Interface of the noise filters of the space domain: what each is given and gives back."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray


def near_box(
    axes: Sequence[NDArray[np.integer[Any]]], chosen: NDArray[np.bool_], margin: int
) -> NDArray[np.bool_]:
    """Points within ``margin`` of the box of the chosen ones, by their coordinates: (n,) bool."""
    rows = np.flatnonzero(chosen)
    near = np.full(len(chosen), len(rows) > 0)
    for values in axes if len(rows) else ():
        low, high = int(values[rows].min()) - margin, int(values[rows].max()) + margin
        near &= (values >= low) & (values <= high)
    return near


@dataclass(frozen=True, slots=True)
class Cloud:
    """Independent returns of a block and its halo, in canonical order.

    Without withheld points, afterpulses and followers of other returns.
    """

    xyz: NDArray[np.int32]  #: (n, 3): coordinates relative to ``anchor`` [quanta]; >= 0.
    anchor: tuple[int, int, int]  #: Smallest x, y, z on the survey's absolute lattice [quanta].
    #: (n,): expected background at each point [1/m3]; finite, >= 0. Of the part of its voxel that
    #: is listened to, or of the whole voxel for filters that add it up
    #: (:func:`~spl_batch.airborne.filter.denoise.asks_for_means`).
    density: NDArray[np.float64]
    asked: NDArray[np.bool_]  #: (n,): points to decide.
    #: (n,): points that the filter of single shots (DCC) calls noise; False where it did not run.
    shot_noise: NDArray[np.bool_]

    def around(self, margin: int, axes: tuple[int, ...]) -> NDArray[np.bool_]:
        """Points within ``margin`` of the box of all asked for, along some axes: (n,) bool."""
        return near_box([self.xyz[:, axis] for axis in axes], self.asked, margin)


@dataclass(frozen=True, slots=True)
class Verdict:
    """Decision about the m points asked for, in their order."""

    signal: NDArray[np.bool_]  #: (m,): true where the point is a signal.
    #: (m,): probability of as much evidence if it is noise; NaN where the method has none.
    p_value: NDArray[np.float32]


def without_p(signal: NDArray[np.bool_]) -> Verdict:
    """Verdict of a method that knows no probabilities."""
    return Verdict(signal, np.full(len(signal), np.nan, dtype=np.float32))
