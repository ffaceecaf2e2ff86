"""Evidence for afterpulses within one shot: hard surfaces, and parents in the same channel.

See :mod:`spl_batch.airborne.afterpulse.candidates` for the method and its source.
"""

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.afterpulse.hard_surfaces import (
    RETURNS_MIN,
    SHARP,
    SURFACES_MAX,
    Rules,
    behind_of,
    candidates,
    find_surfaces,
    on_surface,
    returns_behind,
)
from spl_batch.airborne.afterpulse.lag_counts import law_at
from spl_batch.numerics.compiled import njit
from spl_batch.numerics.simd import LANES

TOGETHER = 128
"""Shots whose planes are fitted together; those that finish early hardly matter [count]."""

HARD = 0.95
"""Probability of a return behind a parent on a hard surface."""

PLANE_ONLY = 0.9
"""The same where channels are not known and the plane is the only evidence."""

SOFT_CAP = 0.49
"""Most that a parent alone gives: the space domain decides in vegetation."""


@njit()
def soft_probability(
    i: int, lag: float, rows: tuple[int, int], w: NDArray[np.float64], first: NDArray[np.bool_],
    rules: Rules,
) -> float:  # fmt: skip
    """Probability of an afterpulse from its lag and what else returns at its range.

    It weighs the density of afterpulses at this lag against that of real returns there, by the
    other beamlets' first returns within 1.5 m. ``rows``: first row of the shot, and the one after
    its last.
    """
    afterpulse = law_at(lag, rules.dead_m, rules.law)
    others, at = 0, w[i]
    for j in range(rows[0], rows[1]):
        others += first[j] & (abs(w[j] - at) <= 1.5)
    real = (others + 0.5) / (3.0 * rules.beamlets)
    return SOFT_CAP * afterpulse / (afterpulse + real)


@njit()
def plane_probability(
    i: int, behind: NDArray[np.float64], spreads: NDArray[np.float64], rules: Rules
) -> float:
    """The published rule, for unknown channels: below a plane and on no other."""
    flagged = False
    for s in range(len(behind)):
        if on_surface(behind[s, i], spreads[s], rules):
            return 0.0
        flagged = flagged or 0.0 < behind[s, i] <= rules.lag_max_m
    return PLANE_ONLY if flagged else 0.0


@njit()
def follows_surface(
    i: int, own: tuple[int, int], behind: NDArray[np.float64], spreads: NDArray[np.float64],
    depths: NDArray[np.float64], w: NDArray[np.float64], rules: Rules,
) -> bool:  # fmt: skip
    """Whether a return lies on no surface, and behind a hard one that its beamlet hit.

    ``own`` is :func:`beamlet_of` it; ``depths`` (found,) is what :func:`returns_behind` gives, NaN
    for penetrable surfaces. Unless ranging noise is large, half the dead time is distance enough:
    the dead time is longer than a hard surface is thick.
    """
    for s in range(len(behind)):
        if abs(behind[s, i]) <= max(0.5 * rules.dead_m, rules.apart * spreads[s]):
            return False
        if depths[s] <= behind[s, i] <= depths[s] + 2.0 * rules.below_m:
            return False
    for s in range(len(behind)):
        if np.isnan(depths[s]) or behind[s, i] <= 0.0:
            continue
        for j in range(own[0], own[1]):
            lag = w[i] - w[j]
            if 0.0 < lag <= rules.chain_m and on_surface(behind[s, j], spreads[s], rules):
                return True
    return False


@njit()
def beamlet_of(i: int, rows: tuple[int, int], channel: NDArray[np.uint8]) -> tuple[int, int]:
    """First row of a return's beamlet, and the row after its last, within the shot's ``rows``."""
    begin = end = i
    while begin > rows[0] and channel[begin - 1] == channel[i]:
        begin -= 1
    while end < rows[1] and channel[end] == channel[i]:
        end += 1
    return begin, end


@njit()
def shot_probabilities(
    starts: NDArray[np.int64], u: NDArray[np.float64], v: NDArray[np.float64],
    w: NDArray[np.float64], channel: NDArray[np.uint8], lag: NDArray[np.float32],
    known: NDArray[np.bool_], rules: Rules, out: NDArray[np.float32],
) -> None:  # fmt: skip
    """Probability of being an afterpulse, for each return of each shot: fills ``out`` (n,).

    ``starts`` (m + 1,): rows where shots start, then n; ``known`` (m,): shots that know channels.
    ``u, v, w``: places across and along the beam, with room for eight more [m]. Returns of one
    beamlet follow each other; ``lag`` is the distance behind the nearest earlier one [m], 0 for
    none.
    """
    for begin in range(0, len(starts) - 1, TOGETHER):
        shots = starts[begin : begin + TOGETHER + 1]
        rows = slice(shots[0], shots[-1])
        more = slice(shots[0], shots[-1] + LANES)
        _of_shots(
            shots - shots[0], u[more], v[more], w[more], channel[rows], lag[rows],
            known[begin : begin + TOGETHER], rules, out[rows],
        )  # fmt: skip


@njit()
def _of_shots(shots, u, v, w, channel, lag, known, rules, out):  # type: ignore[no-untyped-def]
    """:func:`shot_probabilities` of a few shots."""
    n = len(out)
    # Without channels any return may be the first of its beamlet.
    first = (lag == 0) | np.repeat(~known, np.diff(shots))
    spread_max = np.where(known, SHARP * rules.sigma_m, np.inf)
    candidate = candidates(shots, first, RETURNS_MIN, w, rules)
    number_of = len(shots) - 1
    planes, spreads = np.empty((number_of, SURFACES_MAX, 3)), np.empty((number_of, SURFACES_MAX))
    found = np.empty(number_of, np.int64)
    find_surfaces(shots, u, v, w, candidate, rules, spread_max, planes, spreads, found)
    behind, depths = np.empty((SURFACES_MAX, n)), np.empty(SURFACES_MAX)
    for shot in range(number_of):
        rows, surfaces = (shots[shot], shots[shot + 1]), behind[: found[shot]]
        _lay_behind(rows, u, v, w, planes[shot], spreads[shot], first, rules, surfaces, depths)
        for i in range(rows[0], rows[1]):
            out[i] = 0.0
            if not known[shot]:
                out[i] = plane_probability(i, surfaces, spreads[shot], rules)
            # One farther behind its nearest parent cannot have been started by any.
            elif 0.0 < lag[i] <= rules.longest_m:
                own = beamlet_of(i, rows, channel)
                if follows_surface(i, own, surfaces, spreads[shot], depths, w, rules):
                    out[i] = HARD
                else:
                    out[i] = soft_probability(i, lag[i], rows, w, first, rules)


@njit()
def _lay_behind(rows, u, v, w, planes, spreads, first, rules, behind, depths):  # type: ignore[no-untyped-def]
    """Fill how far behind each surface of a shot its returns lie, and ``depths``."""
    for s in range(len(behind)):
        for i in range(rows[0], rows[1]):
            behind[s, i] = behind_of(planes[s], i, u, v, w)
    for s in range(len(behind)):
        hard, depth = returns_behind(s, rows, behind, spreads, first, rules)
        depths[s] = depth if hard else np.nan
