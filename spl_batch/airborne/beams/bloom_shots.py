"""Kernels of :mod:`~spl_batch.airborne.beams.bloom`: shots in which many see one range."""

import math
from typing import Final

import numpy as np

from spl_batch.numerics.compiled import njit
from spl_batch.numerics.sorting import sort

ONE_RANGE: Final = 1
PASSED: Final = 2
"""What a shot shows: one range of many channels, and light that goes on behind it."""

PART: Final = 0.35
"""Least part of the channels with another return behind: more than a detector's afterpulses."""

BINS: Final = 1024
WIDER: Final = 1.001
"""Counts of ranges, and width of a bin [windows], by which most shots are told to hold no bloom;
speed only."""

OFTEN: Final = 0.25
SURE: Final = 2.5
"""Part that afterpulses reach at the most, and standard deviations of chance beyond it: few
channels tell less than many."""


@njit()
def one_range(starts, channel, range_m, rules, low, seen):  # type: ignore[no-untyped-def]
    """What each shot shows, and where its window begins.

    ``rules``: least channels with a return in the window [count], its width, largest standard
    deviation in it, and how far behind another return is looked for [m].
    """
    has, bins = np.zeros(256, np.int32), np.zeros(BINS, np.int32)
    needed, width, spread, reach = rules
    for s in range(len(starts) - 1):
        first, stop = starts[s], starts[s + 1]
        if stop - first < needed:
            continue
        near, of = range_m[first:stop], channel[first:stop]
        if _most_in_two(near, width, bins) < needed:
            continue
        low[s], deviation = _fullest(near, width)
        if deviation > spread:
            continue
        held, passed = _channels(near, of, low[s], width, reach, has)
        if held >= needed:
            due = OFTEN * held + SURE * math.sqrt(OFTEN * (1.0 - OFTEN) * held)
            seen[s] = PASSED if passed >= max(PART * held, due) else ONE_RANGE


@njit()
def _most_in_two(near, width, bins):  # type: ignore[no-untyped-def]
    """No fewer returns of a shot than any window holds, without sorting them.

    A window lies within two bins side by side that are wider by more than rounding. Bins far apart
    share a count, and all counts are zero before and after.
    """
    most, each = 0, 1.0 / (width * WIDER)
    for k in range(len(near)):
        at = np.int64(math.floor(near[k] * each))
        own = at & (BINS - 1)
        bins[own] += 1
        beside = max(bins[(at - 1) & (BINS - 1)], bins[(at + 1) & (BINS - 1)])
        most = max(most, bins[own] + beside)
    for k in range(len(near)):
        bins[np.int64(math.floor(near[k] * each)) & (BINS - 1)] = 0
    return most


@njit()
def _fullest(near, width):  # type: ignore[no-untyped-def]
    """Where the window begins that holds most returns of a shot, and their spread [m]."""
    ordered = np.empty(len(near), np.float64)
    for k in range(len(near)):
        ordered[k] = near[k]
    sort(ordered)
    begin, most, at = 0, 0, 0
    for k in range(len(ordered)):
        while ordered[k] - ordered[begin] > width:
            begin += 1
        if k + 1 - begin > most:
            most, at = k + 1 - begin, begin
    held = ordered[at : at + most] - ordered[at]
    return ordered[at], math.sqrt(max(np.mean(held * held) - np.mean(held) ** 2, 0.0))


@njit()
def _channels(near, of, low, width, reach, has):  # type: ignore[no-untyped-def]
    """Channels with a return in the window, and those of them with another one behind it."""
    high, held, passed = low + width, 0, 0
    has[:] = 0
    for k in range(len(near)):
        if low <= near[k] <= high:
            has[of[k]] |= 1
        elif high < near[k] <= high + reach:
            has[of[k]] |= 2
    for c in range(len(has)):
        held += has[c] & 1
        passed += has[c] == 3
    return held, passed
