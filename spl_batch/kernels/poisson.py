"""Upper tail of the Poisson distribution and its critical count [W18 Eq. 6-8].

====== ==========================================================================
symbol name
====== ==========================================================================
k      ``count``: neighbours inside the ellipsoid, the point itself excluded
rho v  ``expected``: noise density times volume
P      ``poisson_tail``: P(K >= k | rho v), the tail with k itself
====== ==========================================================================
"""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray


@njit(nogil=True, cache=True)
def poisson_tail(count, expected):  # type: ignore[no-untyped-def]
    """Probability of at least ``count`` events where ``expected`` are expected.

    Parameters
    ----------
    count : int
        Events [count]; >= 0.
    expected : float
        Mean of the distribution [count]; finite, >= 0.

    Returns
    -------
    float
        P(K >= count) in [0, 1]; relative error below 1e-12 in the small tail, because
        the series starts at its largest term and nothing is subtracted.
    """
    if count <= 0:
        return 1.0
    if expected <= 0.0:
        return 0.0
    log_mean = math.log(expected)
    if count > expected:
        term = math.exp(count * log_mean - expected - math.lgamma(count + 1.0))
        total = term
        i = count + 1.0
        while term > 1e-17 * total:
            term *= expected / i
            total += term
            i += 1.0
        return min(total, 1.0)
    i = count - 1.0
    term = math.exp(i * log_mean - expected - math.lgamma(i + 1.0))
    total = term
    while term > 1e-17 * total and i > 0.0:
        term *= i / expected
        total += term
        i -= 1.0
    return max(1.0 - total, 0.0)


@njit(nogil=True, cache=True)
def poisson_critical(expected, alpha, start):  # type: ignore[no-untyped-def]
    """Smallest count whose upper tail is at most ``alpha``.

    Parameters
    ----------
    expected : float
        Mean of the distribution [count]; finite, >= 0.
    alpha : float
        Significance, in (0, 1).
    start : int
        Where to look first, >= 1: the answer for a mean nearby costs two tails. What is
        found does not depend on it.

    Returns
    -------
    count : int
        Smallest k with P(K >= k) <= alpha; at least 1.
    tail : float
        P(K >= count).
    """
    count = start
    tail = poisson_tail(count, expected)
    if tail > alpha:
        while tail > alpha:
            count += 1
            tail = poisson_tail(count, expected)
        return count, tail
    while count > 1:
        longer = poisson_tail(count - 1, expected)
        if longer > alpha:
            break
        count, tail = count - 1, longer
    return count, tail


@njit(nogil=True, cache=True)
def _tails(count, expected, out):  # type: ignore[no-untyped-def]
    for i in range(len(out)):
        out[i] = poisson_tail(count[i], expected[i])


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
    out = np.empty(len(neighbours), dtype=np.float64)
    _tails(neighbours, expected, out)
    return out
