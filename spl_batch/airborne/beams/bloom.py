"""Bloom: one bright point that lights the whole array, so that all channels see it at its range.

Domain: time. The returns of a retro-reflector lie on a sphere around the sensor, as wide as the
array, and look like a surface. In a shot of bloom

- *nearly all channels* have a return within :data:`WINDOW_M` of range. On level ground beams lean,
  and ranges spread over the array;
- *light goes on*: many of these channels see the true surface close behind. Behind ground and roofs
  there are only afterpulses, which are fewer. Returns in front may be leaves and say nothing.

A bright surface square to the beam that lets light pass, as water below the sensor, has both. So
these returns are counted and told; they become noise only where the settings ask for it. No source
has a rule for it.
"""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.beams.bloom_shots import mark_bloom
from spl_batch.lattice.tables import BeamTable, PointTable

DOMAIN: Final = "time"

WINDOW_M: Final = 0.5
"""Ranges that are one: ten times the ranging noise of the instrument [m]."""

FILLED: Final = 0.9
"""Least part of the sensor's channels with a return there: 2.3 photo-electrons in each."""

PASSED: Final = 0.35
"""Least part of these with another return behind: more than a detector's afterpulses."""

BEHIND_M: Final = 12.0
"""How far behind another return is looked for [m]."""

LEAST: Final = 20
"""Channels from which an array can tell [count]."""


class Bloom(NamedTuple):
    """Returns of bloom."""

    returns: NDArray[np.bool_]  #: (n,): which returns.
    shots: int  #: How many shots they are of [count].


def find_bloom(
    table: PointTable, beams: BeamTable, starts: NDArray[np.int64], channels: int
) -> Bloom:
    """Returns of light that reached the whole array.

    Parameters
    ----------
    table : PointTable
        Points in time order, with ``channel``.
    starts : (s + 1,) int64
        Where each shot begins, and the end.
    channels : int
        Channels of the sensor, not of these shots: a shot is judged alike in any company [count].
    """
    returns = np.zeros(len(table), np.bool_)
    if channels < LEAST or not len(starts):
        return Bloom(returns, 0)
    shots = mark_bloom(
        starts,
        table["channel"],
        beams.range_m,
        FILLED * channels,
        PASSED,
        (WINDOW_M, BEHIND_M),
        returns,
    )
    return Bloom(returns, int(shots))
