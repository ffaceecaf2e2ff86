"""Noise counts of a stretch of returns, interval by interval [W17 5.2.1].

Nothing here looks over an interval's edge, so a flightline may be cut at any of them.
"""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.numerics.compiled import njit

SUMMARY: Final = (
    "signal_z", "signal_range", "cosine", "signal_sd", "range_min", "range_max",
    "z_min", "z_max", "behind_min", "behind_max",
)  # fmt: skip
"""Columns of ``summary``, all in metres but the cosine: means of signal height, slant range to it
and cosine, standard deviation of that height, ends of range, height and slant distance behind the
signal."""

GROUP_RETURNS = 100
"""Returns that make the peak of a group sure [count]. The arc of an interval on the ground, tens of
metres long, is cut into groups, so that on a slope each has its own signal. Half and twice move 221
+ 6 and 238 + 5 labels."""


@njit()
def densest_window(sorted_z: NDArray[np.float64], width: float) -> tuple[float, int]:
    """Middle of the fullest window of a sorted sample, the lowest one of equals, and its count."""
    best, first, left = 0, 0, 0
    for right in range(len(sorted_z)):
        while sorted_z[right] - sorted_z[left] > width:
            left += 1
        if right - left + 1 > best:
            best, first = right - left + 1, left
    return 0.5 * (sorted_z[first] + sorted_z[first + best - 1]), best


@njit()
def _significant(count: int, n: int, width: float, extent: float) -> bool:
    """Whether ``count`` of ``n`` in one window is beyond chance for a uniform sample."""
    expected = n * width / max(extent, width)
    return count >= expected + 5.0 * math.sqrt(expected) + 5.0


@njit()
def signal_heights(
    z: NDArray[np.float64],
    order: NDArray[np.int64],
    before: int,
    group: NDArray[np.int64],
    width: float,
    out: NDArray[np.float64],
) -> None:
    """Height of the signal in each group of one interval: fills ``out`` (n_groups,) [m].

    The group's own peak where it is beyond chance, else the interval's, else the median: unlike a
    chance peak it does not select noise.

    ``order``: returns by increasing height, less the rows ``before`` the interval; ``group``: of
    each return.
    """
    everything, n_groups = np.empty(len(z), np.float64), len(out)
    for i in range(len(z)):
        everything[i] = z[order[i] - before]
    extent = everything[-1] - everything[0]
    height, count = densest_window(everything, width)
    if not _significant(count, len(z), width, extent):
        height = everything[len(z) // 2]
    out[0] = height
    if n_groups == 1:
        return
    # Returns by group, in one pass that keeps their order.
    stop = np.zeros(n_groups + 1, dtype=np.int64)
    for g in group:
        stop[g + 1] += 1
    at, grouped = np.empty(n_groups, np.int64), np.empty(len(z), np.float64)
    for g in range(n_groups):
        out[g], at[g] = height, stop[g]
        stop[g + 1] += stop[g]
    for row in order:
        i = row - before
        grouped[at[group[i]]] = z[i]
        at[group[i]] += 1
    for g in range(n_groups):
        own = grouped[stop[g] : stop[g + 1]]
        if len(own) >= 10:
            peak, count = densest_window(own, width)
            if _significant(count, len(own), width, extent):
                out[g] = peak


@njit()
def signal_depths(
    starts: NDArray[np.int64],
    z: NDArray[np.float64],
    order: NDArray[np.int64],
    range_m: NDArray[np.float64],
    cosine: NDArray[np.float64],
    offset: NDArray[np.int64],
    first: NDArray[np.int64],
    interval_shots: int,
    width: float,
    height: NDArray[np.float64],
    summary: NDArray[np.float64],
    below: NDArray[np.float64],
) -> None:
    """Height of the signal in the groups of every interval, and what lies about it.

    ``order``: (n,), rows by interval and increasing height; ``offset``: (n,), shot within the
    interval; ``first``: (m + 1,), where groups of intervals start, then g; ``width``: of the
    sliding height window [m]. Filled: ``height`` (g,), ``summary`` (m, 10), see :data:`SUMMARY`,
    and ``below`` (n,), height of the signal less that of the return [m].
    """
    for m in range(len(starts) - 1):
        rows, n_groups = slice(starts[m], starts[m + 1]), first[m + 1] - first[m]
        group = np.empty(starts[m + 1] - starts[m], np.int64)
        for k in range(len(group)):
            group[k] = offset[starts[m] + k] * n_groups // interval_shots
        heights = height[first[m] : first[m + 1]]
        signal_heights(z[rows], order[rows], starts[m], group, width, heights)
        found = summary[m]
        for c in range(4):
            found[c] = 0.0
        for c in range(4, 10, 2):
            found[c], found[c + 1] = np.inf, -np.inf
        for k in range(len(group)):
            i, signal = starts[m] + k, heights[group[k]]
            below[i] = signal - z[i]
            behind = below[i] / cosine[i]
            found[0] += signal
            found[1] += range_m[i] - behind
            found[2] += cosine[i]
            found[3] += (signal - heights[0]) ** 2
            for c, value in ((4, range_m[i]), (6, z[i]), (8, behind)):
                found[c] = min(found[c], value)
                found[c + 1] = max(found[c + 1], value)
        for c in range(4):
            found[c] /= len(group)
        found[3] = np.sqrt(max(found[3] - (found[0] - heights[0]) ** 2, 0.0))


@njit()
def count_noise(
    starts: NDArray[np.int64],
    below: NDArray[np.float64],
    cosine: NDArray[np.float64],
    channel: NDArray[np.uint8],
    look: NDArray[np.int64],
    counts: NDArray[np.bool_],
    blind_m: NDArray[np.float64],
    buffers: NDArray[np.float64],
    outside: NDArray[np.int32],
    blinded: NDArray[np.float64],
    by_channel: NDArray[np.int64],
) -> None:
    """Noise counts of every interval of a stretch, by the ground that is looked at; added to.

    ``look``: row of ``outside`` for each return. ``counts``: rows that count as noise; the others
    follow a return of their own beamlet. ``blind_m``: length behind each return in which none would
    have counted. ``buffers``: (b,), heights around the signal that are left out, descending [m].
    ``outside``: (k, 2, b), returns that count, more than each buffer above and below the signal;
    ``blinded``: (m, 2, b), what returns there have blinded [m]; ``by_channel``: (2, b, 256).
    """
    for m in range(len(starts) - 1):
        for i in range(starts[m], starts[m + 1]):
            side = 0 if below[i] < 0 else 1
            b = len(buffers) - 1
            while b >= 0 and abs(below[i]) > buffers[b]:
                # In front of the signal the region ends with the buffer. Behind it, what a
                # blinded piece loses beyond the gate comes in over the buffer's edge.
                room = (abs(below[i]) - buffers[b]) / cosine[i] if side == 0 else np.inf
                blinded[m, side, b] += min(blind_m[i], room)
                if counts[i]:
                    outside[look[i], side, b] += 1
                    by_channel[side, b, channel[i]] += 1
                b -= 1


@njit()
def far_beyond(
    starts: NDArray[np.int64],
    z: NDArray[np.float64],
    signal_z: NDArray[np.float64],
    noise: NDArray[np.int32],
    half_m: float,
    rules: tuple[int, int, float, float],
    gate_m: float,
    gone: NDArray[np.bool_],
) -> int:
    """Mark returns behind a gap at an end of their interval that noise does not leave: (n,) bool.

    How many lie where more than ``lone`` do. ``z``: by interval, rising in each; ``noise``: (m, 2),
    returns more than ``half_m`` above and below the signal. ``rules``: noise that shows its
    spacing; returns, or share of the noise, that may lie behind a gap; spacings that are too wide.
    However many lie farther from the signal than the gate that is stated is long.
    """
    support, lone, share, spacings = rules
    strays = 0
    for m in range(len(starts) - 1):
        ends = (starts[m + 1] - 1, starts[m])
        for side in range(2):
            n = noise[m, side]
            if n < support:
                continue
            way, end = 1 - 2 * side, ends[side]
            widest, count = 0.0, 0
            for k in range(1, n):
                away = way * (z[end - way * (k - 1)] - signal_z[m]) - half_m
                if k > max(lone, int(share * n)) and away <= gate_m:
                    break
                gap = way * (z[end - way * (k - 1)] - z[end - way * k])
                if gap > widest:
                    widest, count = gap, k
            spacing = (way * (z[end - way * count] - signal_z[m]) - half_m) / (n - count)
            # Haze crowds one side alone: beyond it noise lies as wide apart as on the other one.
            others = noise[m, 1 - side]
            if others > lone:
                k = max(lone, int(share * others))
                reach = way * (signal_z[m] - z[ends[1 - side] + way * k]) - half_m
                spacing = max(spacing, reach / (others - k))
            # The widest of many gaps is wider than any one of them by their logarithm.
            most = spacings + math.log(max(share * (n - count), 1.0))
            if spacing > 0.0 and widest > most * spacing:
                strays += count if count > lone else 0
                for k in range(count):
                    gone[end - way * k] = True
    return strays
