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
"""Steps in which a law is tabled [m]. Half and twice move 648 + 849 and 788 + 665 labels."""

RETURNS_MIN = 6
"""Least returns of a surface [count]. Half and twice move 13 + 30 and 22 + 40 labels."""

SHARP = 3.0
"""Most that the residuals of a hard surface spread [ranging spreads]. Half and twice move 8 + 40
and 8 + 9 labels."""


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
    sigma_m: float  #: Ranging spread.
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
    for i in range(len(first)):
        keep[i] &= first[i]
    return keep


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
            found.trusted[shot] = True
            for i in range(3):
                found.plane[shot, i] = plane[one, i]
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
def hard_surfaces(
    shots: NDArray[np.int64], candidate: NDArray[np.bool_], u: NDArray[np.float64],
    v: NDArray[np.float64], w: NDArray[np.float64], rules: Rules, spread_max: NDArray[np.float64],
) -> Surfaces:  # fmt: skip
    """Hard surface of each shot: the plane as published, else one from the fullest range.

    Where the plane of all candidates does not do (roof beside ground, a ridge, ground under a
    tree), one grows from the fullest range of the shot. It is taken if it stands out from an even
    spread of the candidates. Shots do not affect each other; they come together because their
    planes are fitted together.

    ``spread_max`` (s,) bounds the spread of a surface's residuals [m], which keeps crowns out; it
    is infinite as published, where the 68th percentile alone decides.
    """
    found = fit_surfaces(shots, candidate, u, v, w, rules)
    for shot in range(len(spread_max)):
        found.trusted[shot] &= found.spread[shot] <= spread_max[shot]
    chosen = _fullest(shots, w, candidate, found.trusted, 2.0 * rules.p68_max_m)
    grown = fit_surfaces(shots, chosen, u, v, w, rules)
    chosen = _on_planes(shots, u, v, w, candidate, grown, rules)
    grown = fit_surfaces(shots, chosen, u, v, w, rules)
    for shot in range(len(shots) - 1):
        if not grown.trusted[shot] or grown.spread[shot] > spread_max[shot]:
            continue
        count, low, high = 0, np.inf, -np.inf
        for row in range(shots[shot], shots[shot + 1]):
            if candidate[row]:
                count, low, high = count + 1, min(low, w[row]), max(high, w[row])
        # Candidates that an even spread would give a surface.
        even = count * 2.0 * rules.below_m / max(high - low, 2.0 * rules.p68_max_m)
        if grown.size[shot] >= RETURNS_MIN + 2.0 * even:
            found.trusted[shot] = True
            for i in range(3):
                found.plane[shot, i] = grown.plane[shot, i]
            found.spread[shot], found.size[shot] = grown.spread[shot], grown.size[shot]
    return found


@njit()
def _fullest(shots, w, candidate, settled, width):  # type: ignore[no-untyped-def]
    """Candidates in the fullest range window of shots that are not settled: (n,) bool."""
    chosen, ranges = np.zeros(len(candidate), np.bool_), np.empty(len(candidate) + LANES)
    for shot in range(len(settled)):
        if not settled[shot]:
            count = 0
            for i in range(shots[shot], shots[shot + 1]):
                ranges[count] = w[i]
                count += candidate[i]
            start, _ = densest(ranges, 0, count, width)
            for i in range(shots[shot], shots[shot + 1]):
                chosen[i] = candidate[i] and start <= w[i] <= start + width
    return chosen


@njit()
def _on_planes(shots, u, v, w, candidate, fitted, rules):  # type: ignore[no-untyped-def]
    """Candidates near the planes of their shots: (n,) bool."""
    chosen = np.zeros(len(candidate), np.bool_)
    for shot in range(len(shots) - 1):
        if fitted.trusted[shot]:
            reach = max(rules.below_m, 3.0 * fitted.spread[shot])
            for i in range(shots[shot], shots[shot + 1]):
                near = abs(behind_of(fitted.plane[shot], i, u, v, w)) <= reach
                chosen[i] = candidate[i] and near
    return chosen


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
def depth_behind(
    rows: tuple[int, int], behind: NDArray[np.float64], spread: float, first: NDArray[np.bool_],
    rules: Rules,
) -> float:  # fmt: skip
    """Start of the depths behind a surface, ``2 below_m`` wide, that most beamlets miss it by.

    Many first returns at one depth are the ground beside a roof, or a bed that only some beamlets
    reach; the start is infinite where none shares its depth with another one.
    """
    passed, depths = 0, np.empty(rows[1] - rows[0] + LANES)
    for i in range(rows[0], rows[1]):
        missed = 0.0 < behind[i] <= rules.lag_max_m and not on_surface(behind[i], spread, rules)
        if first[i] and missed:
            depths[passed] = behind[i]
            passed += 1
    depth, together = densest(depths, 0, passed, 2.0 * rules.below_m)
    return depth if together > 1 else np.inf
