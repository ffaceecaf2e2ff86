"""Iteratively re-weighted plane of one shot's returns [W17 ch. 7; bisquare of W17 [110]].

The plane gives the range as a function of the two coordinates across the beam, because
that is the direction of the ranging noise and of an afterpulse's lag.
"""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

BISQUARE = 4.685
"""Tuning constant of the bisquare: 95 % efficiency on Gaussian residuals."""

ITERATIONS = 30
"""Most re-weightings."""


@njit(nogil=True, cache=True)
def weighted_plane(
    u: NDArray[np.float64],
    v: NDArray[np.float64],
    w: NDArray[np.float64],
    weight: NDArray[np.float64],
    plane: NDArray[np.float64],
) -> bool:
    """Weighted least squares of ``w = a + b u + c v``.

    Parameters
    ----------
    u, v, w : (n,) float64
        Coordinates across and along the beam [m].
    weight : (n,) float64
        Weights, >= 0.
    plane : (3,) float64
        Filled with a, b, c.

    Returns
    -------
    bool
        False, with ``plane`` as it was, where the points lie on one line seen along the beam.
    """
    total = weight.sum()
    if total <= 0.0:
        return False
    mu, mv, mw = (weight * u).sum() / total, (weight * v).sum() / total, (weight * w).sum() / total
    uu = uv = vv = uw = vw = 0.0
    for i in range(len(u)):
        du, dv, dw = u[i] - mu, v[i] - mv, w[i] - mw
        uu += weight[i] * du * du
        uv += weight[i] * du * dv
        vv += weight[i] * dv * dv
        uw += weight[i] * du * dw
        vw += weight[i] * dv * dw
    determinant = uu * vv - uv * uv
    # Spread across the narrow direction below about 1 % of the wide one tells no slope.
    if determinant <= 1e-4 * (uu + vv) ** 2:
        return False
    plane[1] = (uw * vv - vw * uv) / determinant
    plane[2] = (vw * uu - uw * uv) / determinant
    plane[0] = mw - plane[1] * mu - plane[2] * mv
    return True


@njit(nogil=True, cache=True)
def residual(
    plane: NDArray[np.float64], u: NDArray[np.float64], v: NDArray[np.float64],
    w: NDArray[np.float64],
) -> NDArray[np.float64]:  # fmt: skip
    """Distance behind the plane along the beam: (n,) float64 [m]."""
    distance: NDArray[np.float64] = w - (plane[0] + plane[1] * u + plane[2] * v)
    return distance


@njit(nogil=True, cache=True)
def bisquare_plane(
    u: NDArray[np.float64],
    v: NDArray[np.float64],
    w: NDArray[np.float64],
    scale_min: float,
    plane: NDArray[np.float64],
    weight: NDArray[np.float64],
) -> bool:
    """Robust plane: all weights one at first, then Tukey's bisquare of the residuals.

    Parameters
    ----------
    u, v, w : (n,) float64
        Coordinates across and along the beam [m].
    scale_min : float
        Least scale of the residuals, so that a perfect fit does not reject all [m].
    plane : (3,) float64
        Filled with a, b, c of ``w = a + b u + c v``.
    weight : (n,) float64
        Filled with the last weights.

    Returns
    -------
    bool
        Whether there is a plane.
    """
    weight[:] = 1.0
    if len(u) < 4 or not weighted_plane(u, v, w, weight, plane):
        return False
    for _ in range(ITERATIONS):
        before = plane.copy()
        distance = np.abs(residual(plane, u, v, w))
        scale = max(np.median(distance) / 0.6745, scale_min)
        for i in range(len(u)):
            ratio = distance[i] / (BISQUARE * scale)
            weight[i] = (1.0 - ratio * ratio) ** 2 if ratio < 1.0 else 0.0
        if not weighted_plane(u, v, w, weight, plane):
            return False
        if np.max(np.abs(plane - before)) < 1e-6:
            break
    return True


@njit(nogil=True, cache=True)
def percentile_68(plane: NDArray[np.float64], distance: NDArray[np.float64]) -> float:
    """68th percentile of the point-to-plane distances [W17 ch. 7].

    Parameters
    ----------
    plane : (3,) float64
        Plane.
    distance : (n,) float64
        Distances along the beam [m]; they are turned perpendicular to the plane here.
    """
    tilt = math.sqrt(1.0 + plane[1] ** 2 + plane[2] ** 2)
    ordered = np.sort(np.abs(distance))
    return float(ordered[min(len(ordered) - 1, int(0.68 * len(ordered)))]) / tilt
