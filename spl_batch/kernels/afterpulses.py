"""Afterpulse evidence of one shot: hard surfaces, and parents in the same channel.

See :mod:`spl_batch.stages.afterpulse` for the method and its source.
"""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spl_batch.kernels.afterpulse_law import beam_axes
from spl_batch.kernels.dcc import dcc_keep
from spl_batch.kernels.hard_surfaces import (
    NEAR_M,
    RETURNS_MIN,
    SHARP,
    SURFACES_MAX,
    Rules,
    find_surfaces,
    on_surface,
    returns_behind,
)
from spl_batch.kernels.robust_plane import bisquare_plane, residual

HARD_SHARE = 0.8
"""Least share of the returns of a hard place that lie on its plane."""

HARD = 0.95
"""Probability of a return behind a parent on a hard surface."""

PLANE_ONLY = 0.9
"""The same where channels are not known and the plane is the only evidence."""

SOFT_CAP = 0.49
"""Most that a parent alone gives: the space domain decides in vegetation."""


@njit(nogil=True, cache=True)
def share_within(rules: Rules) -> float:
    """Share of the afterpulses of an endless law whose lag is not the longest or longer."""
    return -math.expm1(-(rules.longest_m - rules.dead_m) / rules.scale_m)


@njit(nogil=True, cache=True)
def soft_probability(
    i: int, lag: float, within: float, w: NDArray[np.float64], first: NDArray[np.bool_],
    rules: Rules,
) -> float:  # fmt: skip
    """Probability of an afterpulse from its lag and what else returns at its range.

    Density of afterpulses at this lag against that of real returns there, the latter
    from the other beamlets' first returns within 1.5 m. ``within`` is :func:`share_within`.
    """
    lag = max(lag - rules.dead_m, 0.0)
    afterpulse = rules.probability * math.exp(-lag / rules.scale_m) / rules.scale_m
    afterpulse /= within
    others, at = 0, w[i]
    for j in range(len(w)):
        others += first[j] & (abs(w[j] - at) <= 1.5)
    real = (others + 0.5) / (3.0 * rules.beamlets)
    return SOFT_CAP * afterpulse / (afterpulse + real)


@njit(nogil=True, cache=True)
def plane_probability(
    i: int, behind: NDArray[np.float64], spreads: NDArray[np.float64], rules: Rules
) -> float:
    """The published rule, where channels are not known: below a plane and on no other."""
    flagged = False
    for s in range(len(behind)):
        if on_surface(behind[s, i], spreads[s], rules):
            return 0.0
        flagged = flagged or 0.0 < behind[s, i] <= rules.lag_max_m
    return PLANE_ONLY if flagged else 0.0


@njit(nogil=True, cache=True)
def follows_surface(
    i: int, own: tuple[int, int], behind: NDArray[np.float64], spreads: NDArray[np.float64],
    depths: NDArray[np.float64], w: NDArray[np.float64], rules: Rules,
) -> bool:  # fmt: skip
    """Whether a return lies on no surface and behind one that its own beamlet hit.

    ``own`` is :func:`beamlet_of` it; ``depths`` (found,) holds what :func:`returns_behind` gives,
    NaN for penetrable surfaces. A beamlet's second return cannot be of the surface that gave the
    first: the dead time is longer than a hard surface is thick. So half of it is distance enough.
    """
    for s in range(len(behind)):
        if abs(behind[s, i]) <= max(0.5 * rules.dead_m, 2.5 * spreads[s]):
            return False
        if depths[s] <= behind[s, i] <= depths[s] + 2.0 * rules.below_m:
            return False
    for j in range(own[0], own[1]):
        if not 0.0 < w[i] - w[j] <= rules.lag_max_m:
            continue
        for s in range(len(behind)):
            if (
                not np.isnan(depths[s])
                and behind[s, i] > 0.0
                and on_surface(behind[s, j], spreads[s], rules)
            ):
                return True
    return False


@njit(nogil=True, cache=True)
def beamlet_of(i: int, channel: NDArray[np.uint8]) -> tuple[int, int]:
    """First row of a return's beamlet, and the row after its last."""
    begin = end = i
    while begin > 0 and channel[begin - 1] == channel[i]:
        begin -= 1
    while end < len(channel) and channel[end] == channel[i]:
        end += 1
    return begin, end


@njit(nogil=True, cache=True)
def nearest_parent(i: int, own: tuple[int, int], w: NDArray[np.float64], rules: Rules) -> int:
    """The nearest earlier return of the beamlet within ``lag_max_m``; -1 for none."""
    parent = -1
    for j in range(own[0], own[1]):
        behind = 0.0 < w[i] - w[j] <= rules.lag_max_m
        if behind and (parent < 0 or w[j] > w[parent]):
            parent = j
    return parent


@njit(nogil=True, cache=True)
def neighbours(
    at: int, u: NDArray[np.float64], v: NDArray[np.float64], w: NDArray[np.float64],
    first: NDArray[np.bool_], rules: Rules,
) -> NDArray[np.int64]:  # fmt: skip
    """First returns around one of the shot, across the beam and in range: (k,) int64.

    Where they are fewer than :data:`RETURNS_MIN` only their number is right.
    """
    u_at, v_at, w_at, reach = u[at], v[at], w[at], rules.lag_max_m
    # No branch, which would be guessed wrong as often as right.
    enough = 0
    for j in range(len(w)):
        du, dv = u[j] - u_at, v[j] - v_at
        enough += first[j] & (du * du + dv * dv <= NEAR_M**2) & (abs(w[j] - w_at) <= reach)
    # What is not near is written over, but for what comes after the last that is.
    near = np.empty(enough + 1, dtype=np.int64)
    if enough < RETURNS_MIN:
        return near[:enough]
    count = 0
    for j in range(len(w)):
        du, dv = u[j] - u_at, v[j] - v_at
        near[count] = j
        count += first[j] & (du * du + dv * dv <= NEAR_M**2) & (abs(w[j] - w_at) <= reach)
    return near[:enough]


@njit(nogil=True, cache=True)
def follows_hard_place(
    i: int, own_rows: tuple[int, int], u: NDArray[np.float64], v: NDArray[np.float64],
    w: NDArray[np.float64], first: NDArray[np.bool_], rules: Rules,
) -> bool:  # fmt: skip
    """Whether a return lies behind a parent whose neighbourhood is a piece of hard surface.

    For what no plane of the whole shot fits: ridges, steps, rough ground.
    """
    parent = nearest_parent(i, own_rows, w, rules)
    if parent < 0:
        return False
    at = neighbours(parent, u, v, w, first, rules)
    count = len(at)
    if count < RETURNS_MIN:
        return False
    plane, weight = np.empty(3), np.empty(count)
    u_at, v_at, w_at = u[at], v[at], w[at]
    if not bisquare_plane(u_at, v_at, w_at, rules.sigma_m, plane, weight):
        return False
    distance = residual(plane, u_at, v_at, w_at)
    own = w[parent] - (plane[0] + plane[1] * u[parent] + plane[2] * v[parent])
    depth = w[i] - (plane[0] + plane[1] * u[i] + plane[2] * v[i])
    hard = beside = 0
    for k in range(count):
        hard += abs(distance[k]) <= SHARP * rules.sigma_m
        # Another first return at the same depth speaks for something real down there.
        beside += abs(distance[k] - depth) <= rules.below_m
    return (
        hard >= max(RETURNS_MIN, HARD_SHARE * count)
        and beside == 0
        and abs(own) <= rules.below_m
        and depth > 0.5 * rules.dead_m
    )


@njit(nogil=True, cache=True)
def shot_probability(
    u: NDArray[np.float64],
    v: NDArray[np.float64],
    w: NDArray[np.float64],
    channel: NDArray[np.uint8],
    lag: NDArray[np.float32],
    rules: Rules,
    out: NDArray[np.float32],
) -> None:
    """Probability of being an afterpulse, for each return of one shot.

    Parameters
    ----------
    u, v, w : (n,) float64
        Returns across and along the beam [m].
    channel : (n,) uint8
        Beamlet of each return; those of one beamlet follow each other.
    lag : (n,) float32
        Distance behind the nearest earlier return of the beamlet [m]; 0 for none.
    rules : Rules
        Numbers of the method.
    out : (n,) float32
        Filled.
    """
    n = len(w)
    with_channels = False
    for i in range(1, n):
        with_channels = with_channels or channel[i] != channel[0]
    first = lag == 0 if with_channels else np.ones(n, dtype=np.bool_)
    out[:] = 0.0
    planes = np.zeros((SURFACES_MAX, 3))
    spreads = np.zeros(SURFACES_MAX)
    found = 0
    if n >= RETURNS_MIN:
        keep = np.empty(n, dtype=np.bool_)
        spread_max = SHARP * rules.sigma_m if with_channels else np.inf
        dcc_keep(w, rules.gate_m, rules.coarse_m, rules.fine_m, keep)
        found = find_surfaces(u, v, w, keep & first, rules, spread_max, planes, spreads)
    behind = np.empty((found, n))
    for s in range(found):
        behind[s] = residual(planes[s], u, v, w)
    within = share_within(rules)
    depths = np.empty(found)
    for s in range(found):
        hard, depth = returns_behind(s, behind, spreads, first, rules)
        depths[s] = depth if hard else np.nan
    for i in range(n):
        if not with_channels:
            out[i] = plane_probability(i, behind, spreads, rules)
        elif 0.0 < lag[i] <= rules.longest_m:
            # One farther behind its nearest parent cannot have been started by any.
            own = beamlet_of(i, channel)
            follows = follows_surface(i, own, behind, spreads, depths, w, rules)
            if not follows:
                follows = follows_hard_place(i, own, u, v, w, first, rules)
            out[i] = HARD if follows else soft_probability(i, lag[i], within, w, first, rules)


@njit(nogil=True, cache=True)
def shot_probabilities(
    starts: NDArray[np.int64],
    offset: NDArray[np.float64],
    direction: NDArray[np.float64],
    range_m: NDArray[np.float64],
    channel: NDArray[np.uint8],
    lag: NDArray[np.float32],
    rules: Rules,
    out: NDArray[np.float32],
) -> None:
    """:func:`shot_probability` for every shot.

    Parameters
    ----------
    starts : (m + 1,) int64
        Rows where shots start, then n.
    offset : (n, 3) float64
        Points relative to the first one of their shot [m].
    direction : (n, 3) float64
        Unit vectors along the beams; that of the first return frames its shot.
    range_m, channel, lag
        Columns of the rows.
    rules : Rules
        Numbers of the method.
    out : (n,) float32
        Filled.
    """
    for m in range(len(starts) - 1):
        rows = slice(starts[m], starts[m + 1])
        u, v = beam_axes(direction[starts[m]], offset[rows])
        shot_probability(u, v, range_m[rows], channel[rows], lag[rows], rules, out[rows])
