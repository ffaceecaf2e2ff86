"""How many points may lie in a span of time: what stretches are cut by where returns are uneven."""

import math
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.beams.shot_runs import run_starts

BINS_PER_S: Final = 256
"""Bins of a second that points are counted in [1/s]."""

_FAR_BINS: Final = 2.0**60

_MERGE_AT: Final = 64
"""Parts that are kept before they are joined [count]."""


class Rate:
    """Points of a flightline in one file, counted by time."""

    def __init__(self) -> None:
        self._parts: list[tuple[NDArray[np.int64], NDArray[np.int64]]] = []

    def add(self, time_s: NDArray[np.float64]) -> None:
        """Count points in; times are finite [s]."""
        # Times that are none may be anything; they are far from all others, wherever that is.
        bins = np.clip(np.floor(time_s * BINS_PER_S), -_FAR_BINS, _FAR_BINS).astype(np.int64)
        self._parts.append(_counted(bins, None))
        if len(self._parts) > _MERGE_AT:
            self._parts = [self.counted()]

    def join(self, bins: NDArray[np.int64], counts: NDArray[np.int64]) -> None:
        """Add what :meth:`counted` gave of another part of the file."""
        self._parts.append((bins, counts))

    def fullest(self) -> list[int]:
        """Most points within 1, 2, 4, ... bins wherever they begin, up to all points [count]."""
        bins, counts = self.counted()
        before = np.concatenate([[0], np.cumsum(counts)])
        found: list[int] = []
        while not found or found[-1] < before[-1]:
            after = np.searchsorted(bins, bins + 2 ** len(found))
            found.append(int((before[after] - before[:-1]).max()))
        return found

    def counted(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Bins that hold points, in order, and how many [count]."""
        bins, counts = (np.concatenate(columns) for columns in zip(*self._parts, strict=True))
        return _counted(bins, counts)


def most_points(fullest: Sequence[int], span_s: float) -> int:
    """Points that a span of time holds at the most [count]."""
    bins = math.floor(span_s * BINS_PER_S) + 2  # it begins and ends within one
    if bins >= 2 ** (len(fullest) - 1):
        return fullest[-1]
    # Windows side by side make up the span; a longer one has it within.
    parts = sum(most for k, most in enumerate(fullest) if bins >> k & 1)
    return min(parts, fullest[(bins - 1).bit_length()])


def _counted(
    bins: NDArray[np.int64], counts: NDArray[np.int64] | None
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Bins that hold something, and how much."""
    order = np.argsort(bins, kind="stable") if np.any(bins[1:] < bins[:-1]) else slice(None)
    bins = bins[order]
    starts = run_starts(bins)
    if counts is None:
        return bins[starts[:-1]], np.diff(starts)
    return bins[starts[:-1]], np.add.reduceat(counts[order], starts[:-1])
