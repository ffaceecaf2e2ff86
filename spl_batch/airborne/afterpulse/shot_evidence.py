"""Evidence for afterpulses within one shot: hard surfaces, and parents in the same channel.

See :mod:`spl_batch.airborne.afterpulse.candidates` for the method and its source.
"""

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.afterpulse.hard_surfaces import (
    RETURNS_MIN,
    SHARP,
    Rules,
    behind_of,
    candidates,
    depth_behind,
    hard_surfaces,
    on_surface,
)
from spl_batch.airborne.afterpulse.lag_counts import BEHIND, law_at
from spl_batch.numerics.compiled import njit
from spl_batch.numerics.simd import LANES, TOGETHER

AFTERPULSE_MIN = 0.5
"""Probability from which a return is called an afterpulse, and is no evidence of its own. A parent
alone gives less: the space domain decides in vegetation."""

HARD = 0.95
"""Probability of a return behind a parent on a hard surface, and, where channels are not known, of
one behind such a surface."""


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
    return AFTERPULSE_MIN * afterpulse / (afterpulse + real)


@njit()
def follows_surface(
    i: int, rows: tuple[int, int], channel: NDArray[np.uint8], behind: NDArray[np.float64],
    spread: float, depth: float, w: NDArray[np.float64], rules: Rules,
) -> bool:  # fmt: skip
    """Whether a return lies behind its shot's hard surface, and its beamlet hit that.

    ``rows``: first row of the shot, and the one after its last; ``depth`` is what
    :func:`depth_behind` gives. Unless ranging noise is large, half the dead time is distance
    enough: the dead time is longer than a hard surface is thick.
    """
    if behind[i] <= max(0.5 * rules.dead_m, BEHIND * spread):
        return False
    if depth <= behind[i] <= depth + 2.0 * rules.below_m:
        return False
    for j in range(rows[0], rows[1]):
        near = channel[j] == channel[i] and 0.0 < w[i] - w[j] <= rules.chain_m
        if near and on_surface(behind[j], spread, rules):
            return True
    return False


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
    # Loops compile in half the time that numpy's repeat, diff and where take here.
    first, spread_max = np.empty(len(lag), np.bool_), np.empty(len(known))
    for shot in range(len(known)):
        spread_max[shot] = SHARP * rules.sigma_m if known[shot] else np.inf
        for i in range(shots[shot], shots[shot + 1]):
            # Without channels any return may be the first of its beamlet.
            first[i] = lag[i] == 0 or not known[shot]
    candidate = candidates(shots, first, RETURNS_MIN, w, rules)
    found = hard_surfaces(shots, candidate, u, v, w, rules, spread_max)
    behind = np.empty(len(out))
    for shot in range(len(shots) - 1):
        rows, spread, hard = (shots[shot], shots[shot + 1]), found.spread[shot], found.trusted[shot]
        depth = np.inf
        if hard:
            for i in range(rows[0], rows[1]):
                behind[i] = behind_of(found.plane[shot], i, u, v, w)
            depth = depth_behind(rows, behind, spread, first, rules)
        for i in range(rows[0], rows[1]):
            out[i] = 0.0
            if not known[shot]:
                # The published rule: below the plane, and not on it.
                below = hard and 0.0 < behind[i] <= rules.lag_max_m
                out[i] = HARD * (below and not on_surface(behind[i], spread, rules))
            # One farther behind its nearest parent cannot have been started by any.
            elif 0.0 < lag[i] <= rules.longest_m:
                if hard and follows_surface(i, rows, channel, behind, spread, depth, w, rules):
                    out[i] = HARD
                else:
                    out[i] = soft_probability(i, lag[i], rows, w, first, rules)
