"""Log posterior of being noise from the areas that the first neighbours reach [W17 Eq. 4.4-4.6].

Noise [W17 Eq. 4.4]: with x = alpha pi r^2 the noise expected within r, the k-th neighbour
lies at x with density x^(k-1) e^-x / (k-1)!, a gamma law.

Signal: the source takes the same law with the density of the signal, which "cannot be
estimated directly because the area of the signal is unknown", and leaves its choice open.
A track holds signal of many densities at once (bright and dark ground, canopy, slopes that
spread it), so no single one is chosen here: the contrast c, signal and noise together over
noise, is taken as unknown between 1 and C with equal probability per order of magnitude.
That integral has a closed form,

    p_k(x | signal) = [Q(k, x) - Q(k, C x)] / (x ln C),

with Q the regularised upper incomplete gamma function, which is the chance of fewer than k
noise photons within x.

A neighbour that is not found within the reach is censored: its likelihood is the chance
that it lies beyond, P_k(X > x) = Q(k, x) for noise, and the integral of its density for signal.
"""

from functools import lru_cache
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import integrate, special

from spl_batch.numerics.compiled import njit

_FIRST: Final = float(np.log(1e-7))
_LAST: Final = float(np.log(100.0))
_COLUMNS: Final = 1024


class Ratios(NamedTuple):
    """Logarithms of the likelihood of signal over that of noise."""

    #: (K, m): for neighbour k at x, and beyond x.
    within: NDArray[np.float64]
    beyond: NDArray[np.float64]
    first: float  #: ln x of the first column.
    step: float  #: Columns per unit of ln x.


@lru_cache(maxsize=8)
def ratios(neighbours: int, contrast_max: float) -> Ratios:
    """Tables for :func:`noise_posterior`; ``contrast_max``: C, largest signal over noise."""
    log_x = np.linspace(_FIRST, _LAST, _COLUMNS)
    x, step = np.exp(log_x), log_x[1] - log_x[0]
    tiny, log_c = np.finfo(np.float64).tiny, np.log(contrast_max)
    within, beyond = np.empty((2, neighbours, _COLUMNS))
    for k in range(1, neighbours + 1):
        # From the tail in which the difference does not cancel.
        upper = special.gammaincc(k, x) - special.gammaincc(k, contrast_max * x)
        lower = special.gammainc(k, contrast_max * x) - special.gammainc(k, x)
        share = np.maximum(np.where(x < k, lower, upper), tiny)
        log_noise = (k - 1) * log_x - x - special.gammaln(k)
        within[k - 1] = np.log(share / log_c) - log_x - log_noise
        # Its integral over ln x from x on; past the last column it falls by e in 1 / x.
        left = integrate.cumulative_simpson(share[::-1], dx=step, initial=share[-1] / x[-1])[::-1]
        beyond[k - 1] = np.log(np.maximum(left / log_c, tiny))
        beyond[k - 1] -= np.log(np.maximum(special.gammaincc(k, x), tiny))
    return Ratios(within, beyond, _FIRST, (_COLUMNS - 1) / (_LAST - _FIRST))


def with_prior(table: Ratios, log_prior: float) -> Ratios:
    """ln(1 + exp(ratio)) of a table: what a neighbour takes from ln P(noise).

    ``log_prior``: ln of P(signal) / P(noise).
    """
    within, beyond = (np.logaddexp(0.0, rows + log_prior) for rows in table[:2])
    return table._replace(within=within, beyond=beyond)


def noise_posterior(
    log_area: NDArray[np.float64], reach_m2: float, noise: NDArray[np.float64], table: Ratios
) -> NDArray[np.float64]:
    """Mean over k of ln P(noise | area within the k-th neighbour), (q,) float64; 0 and below.

    ``log_area``: (q, K), ln of areas [m2], infinite where a neighbour lies beyond ``reach_m2``;
    ``noise``: (q,), density at each point [1/m2]; ``table``: by :func:`with_prior`.
    """
    out = np.empty(len(noise))
    ends = float(np.log(reach_m2)), table.first, table.step
    _posterior(log_area, np.log(noise), table.within, table.beyond, ends, out)
    return out


@njit()
def _posterior(log_area, log_noise, within, beyond, ends, out):  # type: ignore[no-untyped-def]
    log_reach, first, step = ends
    counted, last = within.shape[0], within.shape[1] - 1
    for q in range(len(log_noise)):
        total = 0.0
        for k in range(counted):
            found = log_area[q, k] < np.inf
            log_x = (log_area[q, k] if found else log_reach) + log_noise[q]
            # The ends of a row are continued.
            position = min(max((log_x - first) * step, 0.0), float(last))
            i = min(np.int64(position), last - 1)
            share = position - i
            if found:
                total += within[k, i] * (1.0 - share) + within[k, i + 1] * share
            else:
                total += beyond[k, i] * (1.0 - share) + beyond[k, i + 1] * share
        out[q] = -total / counted
