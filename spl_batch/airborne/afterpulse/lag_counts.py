"""Lags of afterpulses: how often they come where nothing else can, and what follows.

See :mod:`spl_batch.airborne.afterpulse.afterpulse_law`.
"""

import math

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.afterpulse.hard_surfaces import (
    RETURNS_MIN,
    SHARP,
    Rules,
    fit_surfaces,
    on_surface,
)
from spl_batch.airborne.beams.differential_cell_count import dcc_keep
from spl_batch.numerics.compiled import njit
from spl_batch.numerics.planes.robust_plane import residual

CLEAN = 0.9
"""Share of a shot's first returns on its plane and behind it that must lie on it."""

PARENTS_MIN = 12
"""Least first returns on that plane [count]."""


@njit()
def across_beams(
    shots: NDArray[np.int64],
    direction: NDArray[np.float64],
    offset: NDArray[np.float64],
    u: NDArray[np.float64],
    v: NDArray[np.float64],
) -> None:
    """Coordinates of points across the first beam of their shot.

    Any two axes will do, as long as they depend on the beam alone.

    Parameters
    ----------
    shots : (s + 1,) int64
        First row of each shot, then n.
    direction : (n, 3) float64
        Unit vectors along the beams.
    offset : (n, 3) float64
        Points relative to one of their shot [m].
    u, v : (n or more,) float64
        Filled [m].
    """
    for shot in range(len(shots) - 1):
        at = shots[shot]
        dx, dy, dz = direction[at, 0], direction[at, 1], direction[at, 2]
        if abs(dx) < 0.7:
            ux, uy, uz = 0.0, dz, -dy
        else:
            ux, uy, uz = -dz, 0.0, dx
        norm = math.sqrt(ux * ux + uy * uy + uz * uz)
        ux, uy, uz = ux / norm, uy / norm, uz / norm
        vx, vy, vz = dy * uz - dz * uy, dz * ux - dx * uz, dx * uy - dy * ux
        for i in range(shots[shot], shots[shot + 1]):
            x, y, z = offset[i, 0], offset[i, 1], offset[i, 2]
            u[i] = ux * x + uy * y + uz * z
            v[i] = vx * x + vy * y + vz * z


@njit()
def observe_lags(
    starts: NDArray[np.int64],
    chosen: NDArray[np.int64],
    offset: NDArray[np.float64],
    direction: NDArray[np.float64],
    range_m: NDArray[np.float64],
    channel: NDArray[np.uint8],
    lag: NDArray[np.float32],
    rules: Rules,
    bin_m: float,
    lags: NDArray[np.int64],
) -> int:
    """Lags behind first returns on a hard plane that is alone in its shot.

    Parameters
    ----------
    starts : (m + 1,) int64
        Rows where shots start, then n.
    chosen : (s,) int64
        Shots to look at.
    offset, direction, range_m, channel, lag, rules
        As in :func:`~spl_batch.airborne.afterpulse.shot_evidence.shot_probabilities`.
    bin_m : float
        Width of the lags' bins [m].
    lags : (b,) int64
        Counts are added.

    Returns
    -------
    int
        First returns that could have been followed.
    """
    n = len(range_m)
    u, v = np.empty(n), np.empty(n)
    across_beams(starts, direction, offset, u, v)
    member, first = np.empty(n, np.uint64), np.zeros(len(chosen) + 1, np.int64)
    owner = np.empty(len(chosen), np.int64)
    sets = _candidates(starts, chosen, range_m, lag, rules, member, first, owner)
    plane, trusted, spreads = np.empty((sets, 3)), np.empty(sets, np.bool_), np.empty(sets)
    fit_surfaces(sets, first, member, u, v, range_m, rules, plane, trusted, spreads)
    parents = 0
    for one in range(sets):
        if trusted[one] and spreads[one] <= SHARP * rules.sigma_m:
            rows = slice(starts[owner[one]], starts[owner[one] + 1])
            distance = residual(plane[one], u[rows], v[rows], range_m[rows])
            parents += _observe(
                range_m[rows], channel[rows], lag[rows], distance, spreads[one], rules, bin_m, lags
            )
    return parents


@njit()
def _candidates(starts, chosen, range_m, lag, rules, member, first, owner):  # type: ignore[no-untyped-def]
    """Sets of first returns of chosen shots that may be of a surface: their number."""
    sets = 0
    for shot in chosen:
        low, high = starts[shot], starts[shot + 1]
        if high - low < PARENTS_MIN:
            continue
        keep = np.empty(high - low, dtype=np.bool_)
        dcc_keep(range_m[low:high], rules.gate_m, rules.coarse_m, rules.fine_m, keep)
        end = first[sets]
        for i in range(low, high):
            if keep[i - low] and lag[i] == 0:
                member[end] = i
                end += 1
        if end - first[sets] >= RETURNS_MIN:
            owner[sets], first[sets + 1] = shot, end
            sets += 1
    return sets


@njit()
def _observe(w, channel, lag, distance, spread, rules, bin_m, lags):  # type: ignore[no-untyped-def]
    """Count the lags of a shot if its plane is alone in it: first returns on that, else 0."""
    first = lag == 0
    on = near = 0
    for i in range(len(w)):
        if on_surface(distance[i], spread, rules):
            on += first[i]
        else:
            near += first[i] and 0.0 < distance[i] <= rules.lag_max_m
    if on < PARENTS_MIN or on < CLEAN * (on + near):
        return 0
    for i in range(len(w)):
        if lag[i] > 0:
            _count(i, w, channel, first, distance, spread, rules, bin_m, lags)
    return on


@njit()
def _count(
    i: int, w: NDArray[np.float64], channel: NDArray[np.uint8], first: NDArray[np.bool_],
    distance: NDArray[np.float64], spread: float, rules: Rules, bin_m: float,
    lags: NDArray[np.int64],
) -> None:  # fmt: skip
    """Count the lag of a return whose nearest earlier one is a first one on the surface."""
    parent = -1
    for j in range(len(w)):
        if channel[j] == channel[i] and w[j] < w[i] and (parent < 0 or w[j] > w[parent]):
            parent = j
    if parent >= 0 and first[parent] and on_surface(distance[parent], spread, rules):
        bin_ = int((w[i] - w[parent]) / bin_m)
        if bin_ < len(lags):
            lags[bin_] += 1


@njit()
def rate_behind(
    starts: NDArray[np.int64], range_m: NDArray[np.float64], least_m: float, reach_m: float,
    dead_m: float, probability: float, scale_m: float, rate: NDArray[np.float32],
) -> None:  # fmt: skip
    """Afterpulses per metre expected at each return, of all earlier ones of its beamlet.

    Parameters
    ----------
    starts : (m + 1,) int64
        Rows where beamlets start, then n.
    range_m : (n,) float64
        Slant ranges [m], in any order within a beamlet.
    least_m, reach_m : float
        Lags that count [m].
    dead_m, probability, scale_m : float
        The law: p exp(-(l - dead) / scale) / scale, l up to ``reach_m``.
    rate : (n,) float32
        Filled [1/m]; 0 where no return is in front.
    """
    top = probability / scale_m / (1.0 - math.exp(-(reach_m - dead_m) / scale_m))
    for b in range(len(starts) - 1):
        for i in range(starts[b], starts[b + 1]):
            total = 0.0
            for j in range(starts[b], starts[b + 1]):
                lag = range_m[i] - range_m[j]
                if lag > 0.0 and least_m <= lag <= reach_m:
                    total += top * math.exp(-max(lag - dead_m, 0.0) / scale_m)
            rate[i] = total
