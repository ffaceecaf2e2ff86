"""Planes of least squares, robust spreads and percentiles of distances from them [W17 ch. 7]."""

import math

import numpy as np
from numpy.typing import NDArray

from spl_batch.numerics.compiled import njit
from spl_batch.numerics.sorting import select

BISQUARE = 4.685
"""Tuning constant of the bisquare: 95 % efficiency on Gaussian residuals."""

GAUSSIAN = 0.6745
"""Median size of what is normally distributed, in standard deviations."""

FLATTEST = 1e-4
"""Least determinant over the squared trace: a spread across the narrow direction below about 1 %
of the wide one shows no slope."""


@njit()
def spread(distance: NDArray[np.float64], least: float) -> float:
    """Robust spread of residuals: the median of their sizes, as that of a Gaussian.

    Parameters
    ----------
    distance : (n,) float64
        Sizes of the residuals, at least one; their order is changed [m].
    least : float
        Least spread [m].
    """
    # Where more than half is surely below, the median need not be known.
    sure = GAUSSIAN * least * (1.0 - 1e-9)
    below = 0
    for i in range(len(distance)):
        below += distance[i] < sure
    if below > len(distance) // 2:
        return least
    half = len(distance) // 2
    median = lower = select(distance, half)
    if len(distance) % 2 == 0:
        lower = distance[0]
        for i in range(1, half):
            lower = max(lower, distance[i])
        median = 0.5 * (median + lower)
    return max(median / GAUSSIAN, least)


@njit()
def percentile_68_below(
    plane: NDArray[np.float64], distance: NDArray[np.float64], limit: float
) -> bool:
    """Whether the 68th percentile of the point-to-plane distances is small [W17 ch. 7].

    Parameters
    ----------
    plane : (3,) float64
        Plane.
    distance : (n,) float64
        Distances along the beam [m]; they are turned perpendicular to the plane here.
    limit : float
        What it is to be below [m].
    """
    tilt = math.sqrt(1.0 + plane[1] ** 2 + plane[2] ** 2)
    below = 0
    for i in range(len(distance)):
        below += abs(distance[i]) / tilt < limit
    return below > min(len(distance) - 1, int(0.68 * len(distance)))
