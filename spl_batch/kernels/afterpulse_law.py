"""Lags of afterpulses: how often they come where nothing else can, and what follows.

See :mod:`spl_batch.stages.afterpulse_law`.
"""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spl_batch.kernels.dcc import dcc_keep
from spl_batch.kernels.hard_surfaces import SHARP, Rules, fit_surface, on_surface
from spl_batch.kernels.robust_plane import residual

CLEAN = 0.9
"""Share of a shot's first returns on its plane and behind it that must lie on it."""

PARENTS_MIN = 12
"""Least first returns on that plane [count]."""


@njit(nogil=True, cache=True)
def beam_axes(
    direction: NDArray[np.float64], offset: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Coordinates of a shot's points across its first beam: two (n,) float64 [m].

    Any two axes will do, as long as they depend on the beam alone.

    Parameters
    ----------
    direction : (3,) float64
        Unit vector along the beam.
    offset : (n, 3) float64
        Points relative to one of them [m].
    """
    dx, dy, dz = direction
    if abs(dx) < 0.7:
        ux, uy, uz = 0.0, dz, -dy
    else:
        ux, uy, uz = -dz, 0.0, dx
    norm = math.sqrt(ux * ux + uy * uy + uz * uz)
    ux, uy, uz = ux / norm, uy / norm, uz / norm
    vx, vy, vz = dy * uz - dz * uy, dz * ux - dx * uz, dx * uy - dy * ux
    x, y, z = offset[:, 0], offset[:, 1], offset[:, 2]
    return ux * x + uy * y + uz * z, vx * x + vy * y + vz * z


@njit(nogil=True, cache=True)
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
        As in :func:`~spl_batch.kernels.afterpulses.shot_probabilities`.
    bin_m : float
        Width of the lags' bins [m].
    lags : (b,) int64
        Counts are added.

    Returns
    -------
    int
        First returns that could have been followed.
    """
    parents = 0
    plane = np.empty(3)
    for shot in chosen:
        low, high = starts[shot], starts[shot + 1]
        if high - low < PARENTS_MIN:
            continue
        w, behind, channels = range_m[low:high], lag[low:high], channel[low:high]
        first = behind == 0
        keep = np.empty(high - low, dtype=np.bool_)
        dcc_keep(w, rules.gate_m, rules.coarse_m, rules.fine_m, keep)
        at = np.flatnonzero(keep & first)
        u, v = beam_axes(direction[low], offset[low:high])
        trusted, spread = fit_surface(u[at], v[at], w[at], rules, plane)
        if not trusted or spread > SHARP * rules.sigma_m:
            continue
        distance = residual(plane, u, v, w)
        on = near = 0
        for i in range(len(w)):
            if on_surface(distance[i], spread, rules):
                on += first[i]
                continue
            near += first[i] and 0.0 < distance[i] <= rules.lag_max_m
        if on < PARENTS_MIN or on < CLEAN * (on + near):
            continue
        parents += on
        for i in range(len(w)):
            if behind[i] > 0:
                _count(i, w, channels, first, distance, spread, rules, bin_m, lags)
    return parents


@njit(nogil=True, cache=True)
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


@njit(nogil=True, cache=True)
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
