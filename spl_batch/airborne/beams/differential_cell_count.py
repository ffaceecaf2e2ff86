"""Differential cell count of one shot [Degnan 2002, cited as [23] in W17 3.2.3; W17 Eq. 3.3].

Deviation: with W17's own N_s and N_b the logarithm of Eq. 3.3 is always -ln 2. The
likelihood ratio of "signal and noise" against "noise" for a count K in a fine bin is

    K = (N_s + ln N_bin) / ln(1 + N_s / N_b)

with N_s the signal expected in the bin, N_b the noise expected in a *fine* bin.
"""

import math

import numpy as np
from numpy.typing import NDArray

from spl_batch.numerics.compiled import njit


@njit()
def dcc_threshold(signal: float, noise: float, bins: float) -> float:
    """Least count of a fine bin that is more likely signal than noise: the K above.

    ``signal`` and ``noise`` are N_s and N_b [count], > 0; ``bins``: fine bins in the gate, N_bin.
    """
    return (signal + math.log(bins)) / math.log(1.0 + signal / noise)


@njit()
def _sharing(bins: NDArray[np.int64], inside: NDArray[np.bool_], count: NDArray[np.int64]) -> None:
    """How many of the returns inside share the bin of each one: ``count`` (n,), filled."""
    first, last = bins[0], bins[0]
    for taken in bins:
        first, last = min(first, taken), max(last, taken)
    span = last - first + 1
    if span > len(bins) ** 2:  # it is quicker to compare all of them
        for i in range(len(bins)):
            count[i] = 0
            for k in range(len(bins)):
                count[i] += inside[k] and bins[k] == bins[i]
        return
    total = np.zeros(span, dtype=np.int64)
    for i in range(len(bins)):
        total[bins[i] - first] += inside[i]
    for i in range(len(bins)):
        count[i] = total[bins[i] - first]


@njit()
def dcc_keep(
    range_m: NDArray[np.float64],
    gate_m: float,
    coarse_m: float,
    fine_m: float,
    keep: NDArray[np.bool_],
) -> None:
    """Which returns of a shot lie in fine bins that hold signal.

    The fullest coarse bin (the nearest of equals) and its two neighbours hold the signal,
    the rest of the gate gives the noise; no noise there counts as half a return.

    Parameters
    ----------
    range_m : (n,) float64
        Slant ranges of the shot's returns [m], in any order.
    keep : (n,) bool
        Filled.
    """
    n = len(range_m)
    if n == 0:
        return
    bins, count = np.empty(n, dtype=np.int64), np.empty(n, dtype=np.int64)
    for i in range(n):
        bins[i] = math.floor(range_m[i] / coarse_m)
        keep[i] = True
    _sharing(bins, keep, count)
    best_count, best = 0, 0
    for i in range(n):
        if count[i] > best_count or (count[i] == best_count and bins[i] < best):
            best_count, best = count[i], bins[i]
    near = 0
    for i in range(n):
        keep[i] = abs(bins[i] - best) <= 1
        near += keep[i]
        bins[i] = math.floor(range_m[i] / fine_m)
    rest = max(gate_m - 3.0 * coarse_m, coarse_m)
    noise = max(n - near, 0.5) * fine_m / rest
    threshold = dcc_threshold(near / 3.0, noise, max(gate_m / fine_m, 1.0))
    _sharing(bins, keep, count)
    for i in range(n):
        keep[i] = keep[i] and count[i] >= threshold
