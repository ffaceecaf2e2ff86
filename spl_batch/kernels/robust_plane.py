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

NEAR_MAX = 32
"""Most values around a guessed median that are put in order one by one [count]."""


@njit(nogil=True, cache=True)
def plane_of_moments(
    mu: float, mv: float, mw: float, uu: float, uv: float, vv: float, uw: float, vw: float,
    flattest: float, plane: NDArray[np.float64],
) -> bool:  # fmt: skip
    """Least squares plane w = a + b u + c v of means and centred second moments.

    Parameters
    ----------
    mu, mv, mw : float
        Means.
    uu, uv, vv, uw, vw : float
        Sums of products about the means.
    flattest : float
        Least determinant over the squared trace of the (u, v) moments: below it the points
        lie on a line.
    plane : (3,) float64
        Filled with a, b, c.

    Returns
    -------
    bool
        False where there is no plane.
    """
    determinant = uu * vv - uv * uv
    if determinant <= flattest * (uu + vv) ** 2:
        return False
    plane[1] = (uw * vv - vw * uv) / determinant
    plane[2] = (vw * uu - uw * uv) / determinant
    plane[0] = mw - plane[1] * mu - plane[2] * mv
    return True


@njit(nogil=True, cache=True, inline="always")
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
    total = mu = mv = mw = 0.0
    for i in range(len(u)):
        total += weight[i]
        mu += weight[i] * u[i]
        mv += weight[i] * v[i]
        mw += weight[i] * w[i]
    if total <= 0.0:
        return False
    mu, mv, mw = mu / total, mv / total, mw / total
    uu = uv = vv = uw = vw = 0.0
    for i in range(len(u)):
        du, dv, dw = u[i] - mu, v[i] - mv, w[i] - mw
        uu += weight[i] * du * du
        uv += weight[i] * du * dv
        vv += weight[i] * dv * dv
        uw += weight[i] * du * dw
        vw += weight[i] * dv * dw
    # Spread across the narrow direction below about 1 % of the wide one tells no slope.
    return plane_of_moments(mu, mv, mw, uu, uv, vv, uw, vw, 1e-4, plane)


@njit(nogil=True, cache=True)
def residual(
    plane: NDArray[np.float64], u: NDArray[np.float64], v: NDArray[np.float64],
    w: NDArray[np.float64],
) -> NDArray[np.float64]:  # fmt: skip
    """Distance behind the plane along the beam: (n,) float64 [m]."""
    distance = np.empty(len(w), dtype=np.float64)
    for i in range(len(w)):
        distance[i] = w[i] - (plane[0] + plane[1] * u[i] + plane[2] * v[i])
    return distance


@njit(nogil=True, cache=True)
def select(values: NDArray[np.float64], k: int) -> float:
    """Value that a sort would put at place ``k``; what is not larger ends up before it.

    Parameters
    ----------
    values : (n,) float64
        Finite; their order is changed.
    k : int
        Place, 0 to n - 1.
    """
    low, high = 0, len(values) - 1
    while low < high:
        # A pivot from the middle of three stays off the quadratic case of sorted values.
        a, b, c = values[low], values[(low + high) // 2], values[high]
        pivot = max(min(a, b), min(max(a, b), c))
        i, j = low, high
        while i <= j:
            while values[i] < pivot:
                i += 1
            while values[j] > pivot:
                j -= 1
            if i <= j:
                values[i], values[j] = values[j], values[i]
                i += 1
                j -= 1
        if k <= j:
            high = j
        elif k >= i:
            low = i
        else:
            break
    return float(values[k])


@njit(nogil=True, cache=True)
def _median(values: NDArray[np.float64]) -> float:
    """Median of at least one value, whose order is changed."""
    half = len(values) // 2
    upper = select(values, half)
    if len(values) % 2:
        return upper
    lower = values[0]
    for i in range(1, half):
        lower = max(lower, values[i])
    return float(0.5 * (upper + lower))


@njit(nogil=True, cache=True, inline="always")
def _median_near(values: NDArray[np.float64], guess: float, room: NDArray[np.float64]) -> float:
    """Median of at least one value >= 0, quickly where it lies near a guess.

    Parameters
    ----------
    values : (n,) float64
        As they are.
    guess : float
        Where the median may lie.
    room : (n,) float64
        Room.
    """
    n = len(values)
    upper, low, high = n // 2, 0.8 * guess, 1.25 * guess
    lower = upper - 1 + n % 2
    below = near = 0
    for i in range(n):
        room[near] = values[i]
        below += values[i] < low
        near += low <= values[i] <= high
    if not (below <= lower and upper < below + near <= below + NEAR_MAX):
        room[:] = values
        return _median(room)
    for i in range(1, near):
        value, k = room[i], i
        while k > 0 and room[k - 1] > value:
            room[k] = room[k - 1]
            k -= 1
        room[k] = value
    if n % 2:
        return float(room[upper - below])
    return float(0.5 * (room[upper - below] + room[lower - below]))


@njit(nogil=True, cache=True, inline="always")
def spread(
    distance: NDArray[np.float64], least: float, guess: float, room: NDArray[np.float64]
) -> float:
    """Robust spread of residuals: the median of their sizes, as that of a Gaussian.

    Parameters
    ----------
    distance : (n,) float64
        Sizes of the residuals, at least one [m].
    least : float
        Least spread [m].
    guess : float
        A spread that it may be near to, or 0: makes it quicker, not different [m].
    room : (n,) float64
        Room.
    """
    # Where more than half is surely below, the median need not be known.
    sure = 0.6745 * least * (1.0 - 1e-9)
    below = 0
    for i in range(len(distance)):
        below += distance[i] < sure
    if below > len(distance) // 2:
        return least
    return max(_median_near(distance, 0.6745 * guess, room) / 0.6745, least)


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
    for i in range(len(u)):
        weight[i] = 1.0
    if len(u) < 4 or not weighted_plane(u, v, w, weight, plane):
        return False
    distance, room, sigma = np.empty(len(u)), np.empty(len(u)), 0.0
    for _ in range(ITERATIONS):
        a, b, c = plane[0], plane[1], plane[2]
        for i in range(len(u)):
            distance[i] = abs(w[i] - (a + b * u[i] + c * v[i]))
        sigma = spread(distance, scale_min, sigma, room)
        scale = BISQUARE * sigma
        for i in range(len(u)):
            ratio = distance[i] / scale
            weight[i] = (1.0 - ratio * ratio) ** 2 if ratio < 1.0 else 0.0
        if not weighted_plane(u, v, w, weight, plane):
            return False
        if max(abs(plane[0] - a), abs(plane[1] - b), abs(plane[2] - c)) < 1e-6:
            break
    return True


@njit(nogil=True, cache=True)
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
