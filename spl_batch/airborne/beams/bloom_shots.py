"""Kernels of :mod:`~spl_batch.airborne.beams.bloom`: shots in which nearly all see one range."""

import numpy as np

from spl_batch.numerics.compiled import njit
from spl_batch.numerics.sorting import sort


@njit()
def mark_bloom(starts, channel, range_m, needed, share, width, out):  # type: ignore[no-untyped-def]
    """Mark the returns of each shot that has bloom; how many shots have."""
    shots, seen = 0, np.zeros(256, np.int32)
    for s in range(len(starts) - 1):
        first, stop = starts[s], starts[s + 1]
        if stop - first < needed:
            continue
        near, of = range_m[first:stop], channel[first:stop]
        low = _fullest(near, width[0])
        held, passed = _channels(near, of, low, width, seen)
        if held >= needed and passed >= share * held:
            shots += 1
            for k in range(first, stop):
                out[k] = low <= range_m[k] <= low + width[0]
    return shots


@njit()
def _fullest(near, window):  # type: ignore[no-untyped-def]
    """Where the window begins that holds most returns of a shot [m]."""
    ordered = np.empty(len(near), np.float64)
    for k in range(len(near)):
        ordered[k] = near[k]
    sort(ordered)
    begin, most, low = 0, 0, ordered[0]
    for k in range(len(ordered)):
        while ordered[k] - ordered[begin] > window:
            begin += 1
        if k + 1 - begin > most:
            most, low = k + 1 - begin, ordered[begin]
    return low


@njit()
def _channels(near, of, low, width, seen):  # type: ignore[no-untyped-def]
    """Channels with a return in the window, and those of them with another one behind it."""
    high, held, passed = low + width[0], 0, 0
    seen[:] = 0
    for k in range(len(near)):
        if low <= near[k] <= high:
            seen[of[k]] |= 1
        elif high < near[k] <= high + width[1]:
            seen[of[k]] |= 2
    for c in range(len(seen)):
        held += seen[c] & 1
        passed += seen[c] == 3
    return held, passed
