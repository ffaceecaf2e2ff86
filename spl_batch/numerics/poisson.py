"""Upper tail of the Poisson distribution and its critical count [W18 Eq. 6-8].

====== ==========================================================================
symbol name
====== ==========================================================================
k      ``count``: neighbours inside the ellipsoid, the point itself excluded
rho v  ``expected``: noise density times volume
P      ``tail_by_logs``: P(K >= k | rho v), the tail with k itself
====== ==========================================================================
"""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammainc

from spl_batch.numerics.compiled import njit

SURELY: Final = 1e-9
"""Relative difference beyond which two tails differ, far more than they are off."""


@njit()
def log_factorials(size):  # type: ignore[no-untyped-def]
    """Logarithms of the factorials of 0 to ``size`` - 1: a look at them is a tenth of the work."""
    logs = np.empty(size)
    for i in range(size):
        logs[i] = math.lgamma(i + 1.0)
    return logs


@njit()
def _series(count, expected, log_mean, logs):  # type: ignore[no-untyped-def]
    """Upper tail for a count and a mean above 0, and P(K = count), or -1 where it is not needed."""
    first = count if count > expected else count - 1
    number = np.float64(first)
    log_factorial = logs[first] if first < len(logs) else math.lgamma(number + 1.0)
    term = math.exp(number * log_mean - expected - log_factorial)
    total = term
    if count > expected:
        likely = term
        i = number + 1.0
        while term > 1e-17 * total:
            term *= expected / i
            total += term
            i += 1.0
        return min(total, 1.0), likely
    i = number
    while term > 1e-17 * total and i > 0.0:
        term *= i / expected
        total += term
        i -= 1.0
    return max(1.0 - total, 0.0), -1.0


@njit()
def tail_by_logs(count, expected, log_mean, logs):  # type: ignore[no-untyped-def]
    """Probability of at least ``count`` events where ``expected`` are expected.

    Relative error below 1e-12 in the small tail: the series starts at its largest term and nothing
    is subtracted. ``log_mean``: logarithm of ``expected``; ``logs``: of :func:`log_factorials`.
    """
    if count <= 0:
        return 1.0
    if expected <= 0.0:
        return 0.0
    tail, _ = _series(count, expected, log_mean, logs)
    return tail


@njit()
def critical_by_logs(expected, alpha, start, log_mean, logs):  # type: ignore[no-untyped-def]
    """Smallest count, at least 1, whose upper tail is at most ``alpha``, and that tail.

    Parameters
    ----------
    expected : float
        Mean of the distribution [count]; finite, >= 0.
    alpha : float
        Significance, in (0, 1).
    start : int
        Where to look first, >= 1: the answer for a mean nearby costs one tail. What is
        found does not depend on it.
    log_mean, logs
        As :func:`tail_by_logs` has them.
    """
    count = start
    if expected <= 0.0:
        return 1, 0.0
    tail, likely = _series(count, expected, log_mean, logs)
    if tail > alpha:
        # No less than half of all counts reach the mean's whole part.
        low, step = max(count, int(expected)) if alpha < 0.5 else count, 1
        while tail > alpha:
            count, step = low + step, 2 * step
            tail, likely = _series(count, expected, log_mean, logs)
            if tail > alpha:
                low = count
        while count - low > 1:
            middle = (low + count) // 2
            between, _ = _series(middle, expected, log_mean, logs)
            if between > alpha:
                low = middle
            else:
                count, tail = middle, between
        return count, tail
    while count > 1:
        # One count less is likelier by a known amount, mostly so much that this settles it.
        if likely > 0.0 and tail + likely * count / expected > alpha * (1.0 + SURELY):
            break
        longer, likely = _series(count - 1, expected, log_mean, logs)
        if longer > alpha:
            break
        count, tail = count - 1, longer
    return count, tail


def noise_tail_probability(
    neighbours: NDArray[np.int32], expected: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Probability that background alone gives at least this many neighbours.

    Parameters
    ----------
    neighbours : (n,) int32
        Returns inside each point's ellipsoid, the point itself excluded [count].
    expected : (n,) float64
        Background density times ellipsoid volume [count]; finite, >= 0.

    Returns
    -------
    (n,) float64
        P(K >= k | lambda) in [0, 1]; small means unlikely to be noise.

    References
    ----------
    [W18] Eq. 8; the tail includes k itself, which the source's rule does not.
    """
    return np.where(neighbours > 0, gammainc(np.maximum(neighbours, 1), expected), 1.0)
