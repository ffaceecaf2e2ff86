"""Room for what a beamlet of one shot sees, which kernels fill again and again."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.simulate.scene.beam_layers import LAYER_FIELDS
from spl_batch.airborne.simulate.scene.ray_trace import SceneArrays


class Beamlet(NamedTuple):
    """Room for the events of a beamlet."""

    axis: NDArray[np.float64]  #: (3,): unit vector.
    #: (m,) float64 and (m, 3) int64: events as in
    #: :func:`~spl_batch.airborne.simulate.detector.add_event`.
    ranges: NDArray[np.float64]
    facts: NDArray[np.int64]
    #: (m,): what it records.
    kept: NDArray[np.int64]
    electrons: NDArray[np.int64]
    layers: NDArray[np.float64]  #: (k, 5): layers of one beam.


def empty_beamlet(scene: SceneArrays, room: int) -> Beamlet:
    """Room for ``room`` events."""
    return Beamlet(
        np.empty(3),
        np.empty(room),
        np.empty((room, 3), dtype=np.int64),
        np.empty(room, dtype=np.int64),
        np.empty(room, dtype=np.int64),
        empty_layers(scene),
    )


def event_room(background: float, signal: float, layers: int) -> int:
    """Events that one beamlet must have room for, far beyond what chance makes likely.

    Parameters
    ----------
    background, signal : float
        Highest expected photo-electrons of background, and of one surface [count].
    layers : int
        Most layers that one beam can meet.
    """
    mean = background + signal
    return int(2 * (mean + 12 * math.sqrt(mean + 1))) + 16 * (layers + 8)


def layer_room(scene: SceneArrays) -> int:
    """Most objects listed for one cell, one more, and a water's surface and column."""
    return 3 + int(np.diff(scene.cell_first, axis=1).max(initial=0))


def empty_layers(scene: SceneArrays) -> NDArray[np.float64]:
    """Room for the layers of one beam."""
    return np.empty((layer_room(scene), LAYER_FIELDS))
