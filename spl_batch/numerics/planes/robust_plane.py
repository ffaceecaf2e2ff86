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
def residual(
    plane: NDArray[np.float64], u: NDArray[np.float64], v: NDArray[np.float64],
    w: NDArray[np.float64],
) -> NDArray[np.float64]:  # fmt: skip
    """Distance behind the plane along the beam: (n,) float64 [m]."""
    distance = np.empty(len(w), dtype=np.float64)
    for i in range(len(w)):
        distance[i] = w[i] - (plane[0] + plane[1] * u[i] + plane[2] * v[i])
    return distance


@njit()
def median(values: NDArray[np.float64]) -> float:
    """Median of at least one value, whose order is changed."""
    half = len(values) // 2
    upper = select(values, half)
    if len(values) % 2:
        return upper
    lower = values[0]
    for i in range(1, half):
        lower = max(lower, values[i])
    return float(0.5 * (upper + lower))


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
    return max(median(distance) / GAUSSIAN, least)


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
