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

from spl_batch.lattice.tables import BeamTable, PointTable
from spl_batch.numerics.compiled import njit

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
    shots = _find(starts, channel, beams.range_m, FILLED * used, returns)
    return Bloom(returns, int(shots))


@njit()
def _find(starts, channel, range_m, needed, out):  # type: ignore[no-untyped-def]
    """Mark the returns of each shot that has bloom; how many shots have."""
    shots, seen = 0, np.zeros(256, np.int32)
    for s in range(len(starts) - 1):
        first, stop = starts[s], starts[s + 1]
        if stop - first < needed:
            continue
        near, of = range_m[first:stop], channel[first:stop]
        low = _fullest(near)
        held, passed = _channels(near, of, low, seen)
        if held >= needed and passed >= PASSED * held:
            shots += 1
            for k in range(first, stop):
                out[k] = low <= range_m[k] <= low + WINDOW_M
    return shots


@njit()
def _fullest(near):  # type: ignore[no-untyped-def]
    """Where the window begins that holds most returns of a shot [m]."""
    ordered = np.sort(near)
    begin, most, low = 0, 0, ordered[0]
    for k in range(len(ordered)):
        while ordered[k] - ordered[begin] > WINDOW_M:
            begin += 1
        if k + 1 - begin > most:
            most, low = k + 1 - begin, ordered[begin]
    return low


@njit()
def _channels(near, of, low, seen):  # type: ignore[no-untyped-def]
    """Channels with a return in the window, and those of them with another one beside it."""
    high, held, passed = low + WINDOW_M, 0, 0
    seen[:] = 0
    for k in range(len(near)):
        if low <= near[k] <= high:
            seen[of[k]] |= 1
        elif low - BESIDE_M <= near[k] <= high + BESIDE_M:
            seen[of[k]] |= 2
    for c in range(len(seen)):
        held += seen[c] & 1
        passed += seen[c] == 3
    return held, passed
