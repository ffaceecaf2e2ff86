"""Log posterior of being noise from the areas that the first neighbours reach [W17 Eq. 4.4-4.6]."""

import math

import numpy as np
from numpy.typing import NDArray

from spl_batch.altimetry.filter.likelihood import Ratios
from spl_batch.numerics.compiled import njit

_LARGE: float = 40.0  # 1 is nothing beside its exponential
_FULL: float = 1e280  # the next factor still fits


def noise_posterior(
    area_m2: NDArray[np.float64],
    reach_m2: float,
    noise: NDArray[np.float64],
    log_prior: float,
    table: Ratios,
) -> NDArray[np.float64]:
    """Mean over k of ln P(noise | area within the k-th neighbour), (q,) float64; 0 and below.

    Parameters
    ----------
    area_m2 : (q, K) float64
        Areas [m2]; infinite where a neighbour lies beyond the reach.
    reach_m2 : float
        Area within the reach [m2].
    noise : (q,) float64
        Noise density at each place [1/m2].
    log_prior : float
        ln of P(signal) / P(noise).
    table : Ratios
        ln of the likelihood of signal over that of noise.
    """
    out = np.empty(len(noise))
    _posterior(
        area_m2, reach_m2, noise, log_prior, table.within, table.beyond, table.first, table.step,
        out,
    )  # fmt: skip
    return out


@njit(inline="always")
def _at(table, k, position):  # type: ignore[no-untyped-def]
    """Value of a row between its columns, the ends continued."""
    last = table.shape[1] - 1
    if position <= 0.0:
        return table[k, 0]
    if position >= last:
        return table[k, last]
    i = int(position)
    share = position - i
    return table[k, i] * (1.0 - share) + table[k, i + 1] * share


@njit()
def _posterior(area, reach, noise, log_prior, within, beyond, first, step, out):  # type: ignore[no-untyped-def]
    """Logarithms of 1 + exp(ratio) are taken of products: they cost most."""
    counted = area.shape[1]
    for q in range(len(noise)):
        total, product = 0.0, 1.0
        for k in range(counted):
            if area[q, k] < np.inf:
                ratio = _at(within, k, (math.log(area[q, k] * noise[q]) - first) * step)
            else:
                ratio = _at(beyond, k, (math.log(reach * noise[q]) - first) * step)
            ratio += log_prior
            if ratio > _LARGE:
                total -= ratio
                continue
            product *= 1.0 + math.exp(ratio)
            if product > _FULL:
                total -= math.log(product)
                product = 1.0
        out[q] = (total - math.log(product)) / counted
