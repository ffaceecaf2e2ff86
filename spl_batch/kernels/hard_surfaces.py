"""Hard surfaces in one shot: robust planes that its returns agree on [W17 ch. 7].

See :mod:`spl_batch.stages.afterpulse` for the method and its deviations.
"""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spl_batch.kernels.robust_plane import (
    bisquare_plane,
    percentile_68_below,
    residual,
    spread,
)

SURFACES_MAX = 3
"""Hard surfaces looked for in a shot: a roof, the ground beside it, one between."""

RETURNS_MIN = 6
"""Least returns of a surface [count]."""

SHARP = 3.0
"""Most that the residuals of a hard surface spread [ranging spreads]."""

PASSED_MIN = 2.0
PASSED_SHARE = 0.1
"""A surface is penetrable when more scattered first returns lie behind it [count, share]."""

NEAR_M = 1.6
"""Reach across the beam of the returns that tell whether a place is hard [m]."""


class Rules(NamedTuple):
    """Numbers of the method; lengths in metres along the beam.

    Parameters
    ----------
    gate_m, coarse_m, fine_m : float
        DCC.
    weight_min, p68_max_m : float
        Hard surface and trust.
    below_m, lag_max_m, dead_m : float
        Threshold behind the plane, longest lag, dead time.
    sigma_m : float
        Ranging spread.
    probability, scale_m, longest_m : float
        Afterpulses per detection, the scale of their lag behind the dead time, the longest lag.
    beamlets : float
        Beamlets fired per shot.
    """

    gate_m: float
    coarse_m: float
    fine_m: float
    weight_min: float
    p68_max_m: float
    below_m: float
    lag_max_m: float
    dead_m: float
    sigma_m: float
    probability: float
    scale_m: float
    longest_m: float
    beamlets: float


@njit(nogil=True, cache=True)
def on_surface(distance: float, spread: float, rules: Rules) -> bool:
    """Whether a return is as near to a surface as its own returns are."""
    return abs(distance) <= max(rules.below_m, 4.0 * spread)


@njit(nogil=True, cache=True)
def fit_surface(
    u: NDArray[np.float64], v: NDArray[np.float64], w: NDArray[np.float64],
    rules: Rules, plane: NDArray[np.float64],
) -> tuple[bool, float]:  # fmt: skip
    """Robust plane of candidates, and whether it is to be trusted [W17 ch. 7].

    Returns
    -------
    trusted : bool
        68th percentile of the distances small, and hard returns enough.
    spread : float
        Scale of the residuals of the hard returns [m].
    """
    weight = np.empty(len(u))
    if len(u) < RETURNS_MIN or not bisquare_plane(u, v, w, rules.sigma_m, plane, weight):
        return False, 0.0
    distance = residual(plane, u, v, w)
    hard, room = np.empty(len(u)), np.empty(len(u))
    count = 0
    for i in range(len(u)):
        hard[count] = abs(distance[i])
        count += weight[i] > rules.weight_min
    if count < RETURNS_MIN:
        return False, 0.0
    sigma = spread(hard[:count], rules.sigma_m, 0.0, room[:count])
    return percentile_68_below(plane, distance, rules.p68_max_m), sigma


@njit(nogil=True, cache=True)
def densest(w: NDArray[np.float64], width: float) -> tuple[float, int]:
    """Start of the fullest range window and its count; the nearest of equals."""
    ordered = w.copy()
    ordered.sort()
    best, first, left = 0, 0, 0
    for right in range(len(ordered)):
        while ordered[right] - ordered[left] > width:
            left += 1
        if right - left + 1 > best:
            best, first = right - left + 1, left
    return ordered[first], best


@njit(nogil=True, cache=True)
def seed(
    number: int, u: NDArray[np.float64], v: NDArray[np.float64], w: NDArray[np.float64],
    left: NDArray[np.int64], rules: Rules,
) -> NDArray[np.int64]:  # fmt: skip
    """Candidates to start a surface from: around a corner of the shot, or at one depth.

    Parameters
    ----------
    number : int
        0 to 3 are the corners, 4 is the fullest range window.
    u, v, w, rules
        As in :func:`find_surfaces`.
    left : (m,) int64
        Candidates that no surface holds yet, m >= 1.

    Returns
    -------
    (k,) int64
        Some of ``left``.
    """
    chosen = np.empty(len(left), dtype=np.int64)
    count = 0
    if number == 4:
        width = 2.0 * rules.p68_max_m
        start, _ = densest(w[left], width)
        for i in left:
            if start <= w[i] <= start + width:
                chosen[count] = i
                count += 1
        return chosen[:count]
    su, sv = 1.0 - 2.0 * (number % 2), 1.0 - 2.0 * (number // 2)
    corner = left[0]
    for i in left:
        if su * u[i] + sv * v[i] > su * u[corner] + sv * v[corner]:
            corner = i
    for i in left:
        square = (u[i] - u[corner]) ** 2 + (v[i] - v[corner]) ** 2
        if square <= NEAR_M**2 and abs(w[i] - w[corner]) <= NEAR_M:
            chosen[count] = i
            count += 1
    return chosen[:count]


@njit(nogil=True, cache=True)
def grow(
    start: NDArray[np.int64], u: NDArray[np.float64], v: NDArray[np.float64],
    w: NDArray[np.float64], left: NDArray[np.int64], rules: Rules, plane: NDArray[np.float64],
) -> tuple[int, float]:  # fmt: skip
    """Surface from a seed: number of candidates on it (0 if not trusted) and its spread."""
    trusted, spread = fit_surface(u[start], v[start], w[start], rules, plane)
    on = np.empty(len(left), dtype=np.int64)
    count = 0
    for _ in range(2):
        if not trusted:
            return 0, 0.0
        count = 0
        for i in left:
            distance = w[i] - (plane[0] + plane[1] * u[i] + plane[2] * v[i])
            if abs(distance) <= max(rules.below_m, 3.0 * spread):
                on[count] = i
                count += 1
        near = on[:count]
        trusted, spread = fit_surface(u[near], v[near], w[near], rules, plane)
    return (count, spread) if trusted else (0, 0.0)


@njit(nogil=True, cache=True)
def find_surfaces(
    u: NDArray[np.float64], v: NDArray[np.float64], w: NDArray[np.float64],
    candidate: NDArray[np.bool_], rules: Rules,
    spread_max: float, planes: NDArray[np.float64], spreads: NDArray[np.float64],
) -> int:  # fmt: skip
    """Hard surfaces of a shot: one plane as published, else several.

    Where one plane does not do (roof beside ground, a ridge, ground under a tree), planes
    are grown from the corners of the shot and from its fullest range; the largest one is
    taken if it stands out from an even spread of the candidates, then the next.

    Parameters
    ----------
    u, v, w : (n,) float64
        Returns of the shot across and along the beam [m].
    candidate : (n,) bool
        Returns that may be of a surface.
    rules : Rules
        Numbers of the method.
    spread_max : float
        Most that the residuals of a surface spread [m]; infinite as published, where the
        68th percentile alone decides. Those of a crown spread more than a roof's.
    planes : (SURFACES_MAX, 3) float64
        Filled.
    spreads : (SURFACES_MAX,) float64
        Filled with the scale of the residuals [m].

    Returns
    -------
    int
        Number of surfaces.
    """
    left = np.flatnonzero(candidate)
    trusted, spread = fit_surface(u[left], v[left], w[left], rules, planes[0])
    if trusted and spread <= spread_max:
        spreads[0] = spread
        return 1
    found = 0
    plane = np.empty(3)
    while found < SURFACES_MAX and len(left) >= RETURNS_MIN:
        best = 0
        for number in range(5):
            start = seed(number, u, v, w, left, rules)
            count, spread = grow(start, u, v, w, left, rules, plane)
            if spread <= spread_max and count > best:
                best, spreads[found] = count, spread
                for k in range(3):
                    planes[found, k] = plane[k]
        rest, extent = beyond(planes[found], spreads[found], u, v, w, left, rules)
        even = len(left) * 2.0 * rules.below_m / max(extent, 2.0 * rules.p68_max_m)
        if best < RETURNS_MIN + 2.0 * even:
            break
        found += 1
        left = rest
    return found


@njit(nogil=True, cache=True)
def beyond(
    plane: NDArray[np.float64], spread: float, u: NDArray[np.float64], v: NDArray[np.float64],
    w: NDArray[np.float64], left: NDArray[np.int64], rules: Rules,
) -> tuple[NDArray[np.int64], float]:  # fmt: skip
    """Candidates that are not on a plane, and the range that all of them span [m]."""
    rest = np.empty(len(left), dtype=np.int64)
    count = 0
    low = high = w[left[0]]
    for i in left:
        low, high = min(low, w[i]), max(high, w[i])
        distance = w[i] - (plane[0] + plane[1] * u[i] + plane[2] * v[i])
        if not on_surface(distance, spread, rules):
            rest[count] = i
            count += 1
    return rest[:count], high - low


@njit(nogil=True, cache=True)
def returns_behind(
    s: int, behind: NDArray[np.float64], spreads: NDArray[np.float64],
    first: NDArray[np.bool_], rules: Rules,
) -> tuple[bool, float]:  # fmt: skip
    """What beamlets that miss a surface return behind it.

    Few and scattered are background, many at one depth are the ground beside a roof;
    many and scattered mean that the surface is penetrable: a crown, water.

    Returns
    -------
    hard : bool
        Whether the surface is not penetrable.
    depth : float
        Start of the depths, ``2 below_m`` wide, that most of them share; inf for none [m].
    """
    on, passed = 0, 0
    depths = np.empty(len(first))
    for i in range(len(first)):
        if not first[i]:
            continue
        if on_surface(behind[s, i], spreads[s], rules):
            on += 1
        elif 0.0 < behind[s, i] <= rules.lag_max_m:
            other = False
            for k in range(len(behind)):
                other = other or (k != s and on_surface(behind[k, i], spreads[k], rules))
            if not other:
                depths[passed] = behind[s, i]
                passed += 1
    if passed == 0:
        return True, np.inf
    depth, together = densest(depths[:passed], 2.0 * rules.below_m)
    scattered = passed - together
    return scattered <= PASSED_MIN + PASSED_SHARE * on, depth if together > 1 else np.inf
