"""Bloom: one bright point that lights the whole array, so that all channels see it at its range.

Domain: time. A retro-reflector sends back so much light that it reaches every channel. Its returns
lie on a sphere around the sensor, as wide as the array, and look like a surface. Two things tell
them, and both are asked for in each shot:

- *Nearly all channels* have a return within :data:`WINDOW_M` of range. Level ground does not: beams
  lean, and its ranges spread over the array. Single-photon surfaces seldom fill so many.
- *Light goes on.* Many of these channels have another return close before or behind: the surface
  that is really there. Behind a roof or the ground there are afterpulses only, which are fewer and
  never before it.

No source has a rule for it.
"""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.beams.bloom_shots import mark_bloom
from spl_batch.lattice.tables import BeamTable, PointTable

DOMAIN: Final = "time"

WINDOW_M: Final = 0.5
"""Ranges that are one: ten times the ranging noise of the instrument [m]."""

FILLED: Final = 0.75
"""Least part of the channels in use that have a return there."""

PASSED: Final = 0.35
"""Least part of these with another return: more than afterpulses that a detector may have."""

BESIDE_M: Final = 12.0
"""How far before and behind another return is looked for [m]."""

LEAST: Final = 20
"""Channels in use from which an array can tell [count]."""


class Bloom(NamedTuple):
    """Returns of bloom.

    Parameters
    ----------
    returns : (n,) bool
        Which returns.
    shots : int
        How many shots they are of [count].
    """

    returns: NDArray[np.bool_]
    shots: int


def find_bloom(table: PointTable, beams: BeamTable, starts: NDArray[np.int64]) -> Bloom:
    """Returns of light that reached the whole array.

    Parameters
    ----------
    table : PointTable
        Points in time order, with ``channel``.
    beams : BeamTable
        Their beams.
    starts : (s + 1,) int64
        Where each shot begins, and the end.
    """
    returns = np.zeros(len(table), np.bool_)
    channel = table["channel"]
    used = len(np.unique(channel))
    if used < LEAST or not len(starts):
        return Bloom(returns, 0)
    shots = mark_bloom(
        starts, channel, beams.range_m, FILLED * used, PASSED, (WINDOW_M, BESIDE_M), returns
    )
    return Bloom(returns, int(shots))
