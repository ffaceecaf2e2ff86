"""Hard surfaces in one shot: robust planes that its returns agree on [W17 ch. 7].

See :mod:`spl_batch.airborne.afterpulse.candidates` for the method and its deviations.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.beams.differential_cell_count import dcc_keep
from spl_batch.numerics.compiled import njit
from spl_batch.numerics.planes.robust_plane import percentile_68_below, spread
from spl_batch.numerics.planes.robust_planes_simd import U0, fit_planes
from spl_batch.numerics.simd import LANES, UL, load, store, where
from spl_batch.numerics.simd import spread as everywhere

STEP_M = 0.05
"""Steps in which a law is tabled [m]."""

SURFACES_MAX = 3
"""Hard surfaces looked for in a shot: a roof, the ground beside it, one between."""

RETURNS_MIN = 6
"""Least returns of a surface [count]."""

SHARP = 3.0
"""Most that the residuals of a hard surface spread [ranging spreads]."""

PASSED_MIN = 2.0
PASSED_SHARE = 0.1
"""A surface is penetrable if more scattered first returns lie behind it [count, share]."""

FOLLOWED = 2.0
"""And so is one that more returns follow than so many times the afterpulses that are due."""

NEAR_M = 1.6
"""How far across the beam returns are looked at to tell whether a place is hard [m]."""


BESIDE_MIN = 4
"""Returns that a surface needs around the place where a beamlet crosses it [count]."""


class Rules(NamedTuple):
    """Numbers of the method; lengths in metres along the beam."""

    gate_m: float
    coarse_m: float
    fine_m: float
    weight_min: float
    p68_max_m: float
    #: Threshold behind the plane, how far behind a surface others are looked for, and dead time.
    below_m: float
    lag_max_m: float
    chain_m: float  #: How far behind a surface its afterpulses go, those of afterpulses among them.
    dead_m: float
    #: Ranging spread, and how many of it behind a surface a return no longer belongs to it.
    sigma_m: float
    apart: float
    longest_m: float  #: The longest lag of an afterpulse.
    beamlets: float
    #: (k,): afterpulses per detection and metre, from the dead time on, every :data:`STEP_M` [1/m].
    law: NDArray[np.float64]


@njit()
def on_surface(distance: float, spread: float, rules: Rules) -> bool:
    """Whether a return is as near to a surface as its own returns are."""
    return abs(distance) <= max(rules.below_m, 4.0 * spread)


@njit()
def fit_surfaces(
    sets: int, first: NDArray[np.int64], member: NDArray[np.uint64], u: NDArray[np.float64],
    v: NDArray[np.float64], w: NDArray[np.float64], rules: Rules, plane: NDArray[np.float64],
    trusted: NDArray[np.bool_], spreads: NDArray[np.float64],
) -> None:  # fmt: skip
    """Robust planes of sets of candidates, and whether they are to be trusted [W17 ch. 7].

    Sets, of :data:`RETURNS_MIN` at least, are as
    :func:`~spl_batch.numerics.planes.robust_planes_simd.fit_planes` takes them. A plane is trusted
    where the 68th percentile of the distances is small, and hard returns are enough; ``spreads`` is
    then filled with the scale of their residuals [m].
    """
    weight = np.empty(first[sets])
    fit_planes(sets, first, member, u, v, w, rules.sigma_m, plane, weight, trusted)
    longest = 0
    for one in range(sets):
        longest = max(longest, first[one + 1] - first[one])
    distance, hard = np.empty(longest), np.empty(longest)
    for one in range(sets):
        if not trusted[one]:
            continue
        a, b, c = plane[one, 0], plane[one, 1], plane[one, 2]
        size = count = 0
        for k in range(first[one], first[one + 1]):
            row = member[k]
            distance[size] = abs(w[row] - (a + b * u[row] + c * v[row]))
            hard[count] = distance[size]
            size += 1
            count += weight[k] > rules.weight_min
        trusted[one] = count >= RETURNS_MIN and percentile_68_below(
            plane[one], distance[:size], rules.p68_max_m
        )
        if trusted[one]:
            spreads[one] = spread(hard[:count], rules.sigma_m)


@njit()
def below_planes(
    shots: NDArray[np.int64], u: NDArray[np.float64], v: NDArray[np.float64],
    w: NDArray[np.float64], rules: Rules, out: NDArray[np.float32],
) -> None:  # fmt: skip
    """The rule as published: one plane for each shot, and all that lies below it [W17 ch. 7].

    ``out`` (n,): 1 for afterpulses, else 0; shots whose plane is not trusted have none.
    """
    n, sets = len(out), 0
    candidate, member = np.zeros(n, np.bool_), np.empty(n + LANES, np.uint64)
    first, owner = np.zeros(len(shots), np.int64), np.empty(len(shots), np.int64)
    for shot in range(len(shots) - 1):
        low, high, end = shots[shot], shots[shot + 1], first[sets]
        dcc_keep(w[low:high], rules.gate_m, rules.coarse_m, rules.fine_m, candidate[low:high])
        for i in range(low, high):
            member[end] = i
            end += candidate[i]
        if end - first[sets] >= RETURNS_MIN:
            owner[sets], first[sets + 1] = shot, end
            sets += 1
    plane, trusted, spreads = np.empty((sets, 3)), np.empty(sets, np.bool_), np.empty(sets)
    fit_surfaces(sets, first, member, u, v, w, rules, plane, trusted, spreads)
    out[:] = 0.0
    for one in range(sets):
        if trusted[one]:
            a, b, c = plane[one, 0], plane[one, 1], plane[one, 2]
            for i in range(shots[owner[one]], shots[owner[one] + 1]):
                out[i] = w[i] - (a + b * u[i] + c * v[i]) > rules.below_m


@njit()
def densest(w, low, high, width):  # type: ignore[no-untyped-def]
    """Start of the fullest range window [m], and its count; the nearest of equals.

    ``w``: ranges, with room for eight more; looked at from row ``low`` on, up to ``high``.
    """
    counts, none, unit = np.empty(LANES), everywhere(0.0), everywhere(1.0)
    first, end, reach = np.uint64(low), np.uint64(high), everywhere(width)
    start, best = np.inf, 0.0
    for i in range(first, end, UL):
        at, count = load(w, i), none
        for j in range(first, end):
            behind = everywhere(w[j]) - at
            count = count + where((behind >= none) & (behind <= reach), unit, none)
        store(counts, U0, count)
        for k in range(min(end - i, UL)):
            if counts[k] > best or (counts[k] == best and w[i + k] < start):
                start, best = w[i + k], counts[k]
    return start, np.int64(best)


@njit()
def returns_behind(
    s: int, rows: tuple[int, int], behind: NDArray[np.float64], spreads: NDArray[np.float64],
    first: NDArray[np.bool_], rules: Rules,
) -> tuple[bool, float]:  # fmt: skip
    """Whether a surface is hard, and start of the depths, ``2 below_m`` wide, that most share.

    Of beamlets that miss it few and scattered returns are background; many at one depth are the
    ground beside a roof; the start is infinite for none. Many and scattered ones mean that the
    surface is penetrable: a crown, water. So do later returns of beamlets, where they are many more
    than afterpulses: all channels see the top of a crown in strong light.
    """
    on, passed, followers, follows = 0, 0, 0, False
    depths = np.empty(rows[1] - rows[0] + LANES)
    for i in range(rows[0], rows[1]):
        if not first[i]:
            followers += follows and 0.5 * rules.dead_m < behind[s, i] <= rules.lag_max_m
            continue
        follows = on_surface(behind[s, i], spreads[s], rules)
        if follows:
            on += 1
        elif 0.0 < behind[s, i] <= rules.lag_max_m:
            other = False
            for k in range(len(behind)):
                other = other or (k != s and on_surface(behind[k, i], spreads[k], rules))
            if not other:
                depths[passed] = behind[s, i]
                passed += 1
    # More than afterpulses, and theirs, can be.
    started = min(np.sum(rules.law) * STEP_M, 0.8)
    if followers > PASSED_MIN + FOLLOWED * on * started / (1.0 - started):
        return False, np.inf
    if passed == 0:
        return True, np.inf
    depth, together = densest(depths, 0, passed, 2.0 * rules.below_m)
    scattered = passed - together
    return scattered <= PASSED_MIN + PASSED_SHARE * on, depth if together > 1 else np.inf


@njit()
def hit_beside(
    i: int, rows: tuple[int, int], behind: NDArray[np.float64], spread: float,
    u: NDArray[np.float64], v: NDArray[np.float64], rules: Rules,
) -> bool:  # fmt: skip
    """Whether a surface has returns all around the place where a return's beamlet crosses it.

    At least :data:`BESIDE_MIN` lie within :data:`NEAR_M` across the beam, on both sides along
    either axis.
    """
    count, left, right, low, high = 0, False, False, False, False
    for j in range(rows[0], rows[1]):
        du, dv = u[j] - u[i], v[j] - v[i]
        if du * du + dv * dv <= NEAR_M**2 and on_surface(behind[j], spread, rules):
            count += 1
            left, right = left or du < 0.0, right or du > 0.0
            low, high = low or dv < 0.0, high or dv > 0.0
    return count >= BESIDE_MIN and left and right and low and high
