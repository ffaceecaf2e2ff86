"""Hard surfaces of shots: robust planes that their returns agree on [W17 ch. 7].

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

GROWN = 2
"""How often a surface is fitted again to the candidates that lie on it [count]."""

RETURNS_MIN = 6
"""Least returns of a surface [count]."""

SHARP = 3.0
"""Most that the residuals of a hard surface spread [ranging spreads]."""

PASSED_MIN = 2.0
PASSED_SHARE = 0.1
"""A surface is penetrable if more scattered first returns lie behind it [count, share]."""

FOLLOWED = 2.0
"""And so is one that more returns follow than so many times the afterpulses that are due."""


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


class Surfaces(NamedTuple):
    """Planes of shots, by shot."""

    plane: NDArray[np.float64]  #: (s, 3): range where u and v are 0 [m], and slopes to them.
    trusted: NDArray[np.bool_]  #: (s,): whether there is one.
    spread: NDArray[np.float64]  #: (s,): scale of its residuals [m].
    size: NDArray[np.int64]  #: (s,): returns that it was fitted to [count].


@njit()
def on_surface(distance: float, spread: float, rules: Rules) -> bool:
    """Whether a return is as near to a surface as its own returns are."""
    return abs(distance) <= max(rules.below_m, 4.0 * spread)


@njit()
def candidates(
    shots: NDArray[np.int64], first: NDArray[np.bool_], least: int, w: NDArray[np.float64],
    rules: Rules,
) -> NDArray[np.bool_]:  # fmt: skip
    """First returns that may be of a surface, by DCC: (n,); none in shots of fewer returns."""
    keep = np.zeros(len(first), np.bool_)
    for shot in range(len(shots) - 1):
        low, high = shots[shot], shots[shot + 1]
        if high - low >= least:
            dcc_keep(w[low:high], rules.gate_m, rules.coarse_m, rules.fine_m, keep[low:high])
    return keep & first


@njit()
def fit_surfaces(
    shots: NDArray[np.int64], chosen: NDArray[np.bool_], u: NDArray[np.float64],
    v: NDArray[np.float64], w: NDArray[np.float64], rules: Rules,
) -> Surfaces:  # fmt: skip
    """Robust planes of shots, through their chosen returns [W17 ch. 7].

    ``u, v, w``: places across and along the beam [m]. A plane is trusted where
    :data:`RETURNS_MIN` returns are hard, and the 68th percentile of the distances is small.
    """
    number_of, sets = len(shots) - 1, 0
    found = Surfaces(
        np.empty((number_of, 3)), np.zeros(number_of, np.bool_), np.empty(number_of),
        np.zeros(number_of, np.int64),
    )  # fmt: skip
    member, begin = np.empty(len(chosen) + LANES, np.uint64), np.zeros(number_of + 1, np.int64)
    owner = np.empty(number_of, np.int64)
    for shot in range(number_of):
        end = begin[sets]
        for i in range(shots[shot], shots[shot + 1]):
            member[end] = i
            end += chosen[i]
        if end - begin[sets] >= RETURNS_MIN:
            owner[sets], begin[sets + 1] = shot, end
            sets += 1
    plane, settled, weight = np.empty((sets, 3)), np.empty(sets, np.bool_), np.empty(begin[sets])
    fit_planes(sets, begin, member, u, v, w, rules.sigma_m, plane, weight, settled)
    distance, hard = np.empty(len(chosen)), np.empty(len(chosen))
    for one in range(sets):
        if not settled[one]:
            continue
        size = count = 0
        for k in range(begin[one], begin[one + 1]):
            distance[size] = abs(behind_of(plane[one], member[k], u, v, w))
            hard[count] = distance[size]
            size += 1
            count += weight[k] > rules.weight_min
        if count >= RETURNS_MIN and percentile_68_below(
            plane[one], distance[:size], rules.p68_max_m
        ):
            shot = owner[one]
            found.trusted[shot], found.plane[shot] = True, plane[one]
            found.spread[shot], found.size[shot] = spread(hard[:count], rules.sigma_m), size
    return found


@njit()
def behind_of(plane, row, u, v, w):  # type: ignore[no-untyped-def]
    """How far behind a plane a row lies [m]."""
    return w[row] - (plane[0] + plane[1] * u[row] + plane[2] * v[row])


@njit()
def below_planes(
    shots: NDArray[np.int64], u: NDArray[np.float64], v: NDArray[np.float64],
    w: NDArray[np.float64], rules: Rules, out: NDArray[np.float32],
) -> None:  # fmt: skip
    """The rule as published: all that lies below the plane of its shot is 1, else 0 [W17 ch. 7]."""
    chosen = candidates(shots, np.ones(len(out), np.bool_), 0, w, rules)
    found = fit_surfaces(shots, chosen, u, v, w, rules)
    out[:] = 0.0
    for shot in range(len(shots) - 1):
        if found.trusted[shot]:
            for i in range(shots[shot], shots[shot + 1]):
                out[i] = behind_of(found.plane[shot], i, u, v, w) > rules.below_m


@njit()
def find_surfaces(
    shots: NDArray[np.int64], u: NDArray[np.float64], v: NDArray[np.float64],
    w: NDArray[np.float64], candidate: NDArray[np.bool_], rules: Rules,
    spread_max: NDArray[np.float64], planes: NDArray[np.float64], spreads: NDArray[np.float64],
    found: NDArray[np.int64],
) -> None:  # fmt: skip
    """Hard surfaces of shots: one plane as published, else several.

    Where one plane does not do (roof beside ground, a ridge, ground under a tree), a plane grows
    from the fullest range of the shot. It is taken if it stands out from an even spread of the
    candidates, and then the next is looked for. Shots do not affect each other; they come together
    because their planes are fitted together.

    ``spread_max`` (s,) bounds the spread of a surface's residuals [m], which keeps crowns out; it
    is infinite as published, where the 68th percentile alone decides. ``planes`` (s, SURFACES_MAX,
    3), ``spreads`` [m] and ``found`` (s,), their number, are filled.
    """
    left, pending = candidate.copy(), np.zeros(len(found), np.bool_)
    fitted = fit_surfaces(shots, left, u, v, w, rules)
    for shot in range(len(found)):
        found[shot] = fitted.trusted[shot] and fitted.spread[shot] <= spread_max[shot]
        pending[shot] = found[shot] == 0
        planes[shot, 0], spreads[shot, 0] = fitted.plane[shot], fitted.spread[shot]
    for at in range(SURFACES_MAX):
        chosen = _fullest(shots, w, left, pending, 2.0 * rules.p68_max_m)
        fitted = fit_surfaces(shots, chosen, u, v, w, rules)
        for _ in range(GROWN):
            chosen = _on_planes(shots, u, v, w, left, fitted, rules)
            fitted = fit_surfaces(shots, chosen, u, v, w, rules)
        for shot in range(len(found)):
            pending[shot] = (
                fitted.trusted[shot]
                and fitted.spread[shot] <= spread_max[shot]
                and _stands_out(fitted.size[shot], (shots[shot], shots[shot + 1]), w, left, rules)
            )
            if pending[shot]:
                planes[shot, at], spreads[shot, at] = fitted.plane[shot], fitted.spread[shot]
                found[shot] += 1
                for i in range(shots[shot], shots[shot + 1]):
                    behind = behind_of(fitted.plane[shot], i, u, v, w)
                    left[i] = left[i] and not on_surface(behind, fitted.spread[shot], rules)


@njit()
def _fullest(shots, w, left, pending, width):  # type: ignore[no-untyped-def]
    """Candidates in the fullest range window of pending shots: (n,) bool."""
    chosen, ranges = np.zeros(len(left), np.bool_), np.empty(len(left) + LANES)
    for shot in range(len(pending)):
        if pending[shot]:
            count = 0
            for i in range(shots[shot], shots[shot + 1]):
                ranges[count] = w[i]
                count += left[i]
            start, _ = densest(ranges, 0, count, width)
            for i in range(shots[shot], shots[shot + 1]):
                chosen[i] = left[i] and start <= w[i] <= start + width
    return chosen


@njit()
def _on_planes(shots, u, v, w, left, fitted, rules):  # type: ignore[no-untyped-def]
    """Candidates near the planes of their shots: (n,) bool."""
    chosen = np.zeros(len(left), np.bool_)
    for shot in range(len(shots) - 1):
        if fitted.trusted[shot]:
            reach = max(rules.below_m, 3.0 * fitted.spread[shot])
            for i in range(shots[shot], shots[shot + 1]):
                chosen[i] = left[i] and abs(behind_of(fitted.plane[shot], i, u, v, w)) <= reach
    return chosen


@njit()
def _stands_out(size, rows, w, left, rules):  # type: ignore[no-untyped-def]
    """Whether a surface holds more candidates than an even spread would give it."""
    count, low, high = 0, np.inf, -np.inf
    for i in range(rows[0], rows[1]):
        if left[i]:
            count, low, high = count + 1, min(low, w[i]), max(high, w[i])
    even = count * 2.0 * rules.below_m / max(high - low, 2.0 * rules.p68_max_m)
    return size >= RETURNS_MIN + 2.0 * even


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
