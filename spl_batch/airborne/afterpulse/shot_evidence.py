"""Evidence for afterpulses within one shot: hard surfaces, and parents in the same channel.

See :mod:`spl_batch.airborne.afterpulse.candidates` for the method and its source.
"""

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.afterpulse.grown_surfaces import Sets, find_surfaces, room_for
from spl_batch.airborne.afterpulse.hard_surfaces import (
    NEAR_M,
    RETURNS_MIN,
    SHARP,
    SURFACES_MAX,
    Rules,
    hit_beside,
    is_behind,
    on_surface,
    returns_behind,
    too_many,
)
from spl_batch.airborne.afterpulse.lag_counts import across_beams, law_at
from spl_batch.airborne.beams.differential_cell_count import dcc_keep
from spl_batch.numerics.compiled import njit
from spl_batch.numerics.planes.robust_planes_simd import fit_planes
from spl_batch.numerics.simd import LANES, UL, absolute, ascending, load, number, pack, spread

TOGETHER = 128
"""Shots whose planes are fitted together; those that finish early hardly matter [count]."""

HARD_SHARE = 0.8
"""Least share of a hard place's returns that lie on its plane."""

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
    i: int, own: tuple[int, int], rows: tuple[int, int], behind: NDArray[np.float64],
    spreads: NDArray[np.float64], depths: NDArray[np.float64], u: NDArray[np.float64],
    v: NDArray[np.float64], w: NDArray[np.float64], rules: Rules,
) -> bool:  # fmt: skip
    """Whether a return lies on no surface, and behind one that its beamlet hit or must have hit.

    ``own`` is :func:`beamlet_of` it; ``depths`` (found,) is what :func:`returns_behind` gives, NaN
    for penetrable surfaces. Unless ranging noise is large, half the dead time is distance enough:
    the dead time is longer than a hard surface is thick. Behind a hard surface with a parent in
    front of it, a return follows the surface only if others have hit that close by.
    """
    for s in range(len(behind)):
        if abs(behind[s, i]) <= max(0.5 * rules.dead_m, rules.apart * spreads[s]):
            return False
        if depths[s] <= behind[s, i] <= depths[s] + 2.0 * rules.below_m:
            return False
    for s in range(len(behind)):
        if np.isnan(depths[s]) or behind[s, i] <= 0.0:
            continue
        before = False
        for j in range(own[0], own[1]):
            if 0.0 < w[i] - w[j] <= rules.chain_m:
                if on_surface(behind[s, j], spreads[s], rules):
                    return True
                before = before or behind[s, j] < 0.0
        if before and hit_beside(i, rows, behind[s], spreads[s], u, v, rules):
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
def nearest_parent(i: int, own: tuple[int, int], w: NDArray[np.float64], rules: Rules) -> int:
    """The nearest earlier return of the beamlet within ``chain_m``; -1 for none."""
    parent = -1
    for j in range(own[0], own[1]):
        behind = 0.0 < w[i] - w[j] <= rules.chain_m
        if behind and (parent < 0 or w[j] > w[parent]):
            parent = j
    return parent


@njit()
def neighbours(at, rows, u, v, w, first, reach_m, out, begin):  # type: ignore[no-untyped-def]
    """First returns of the shot around one of it, across the beam and in range.

    Parameters
    ----------
    rows : (int, int)
        First row of the shot, and the one after its last.
    u, v, w : (n + 8 or more,) float64
        Returns across and along the beam [m].
    first : (n + 8 or more,) bool
        Which are the first ones of their beamlets.
    reach_m : float
        Reach in range [m].
    out : (m,) uint64
        Their rows from ``begin`` on; there must be room for eight more.

    Returns
    -------
    int
        End of what is in ``out``.
    """
    u_at, v_at, w_at = spread(u[at]), spread(v[at]), spread(w[at])
    square, reach = spread(NEAR_M**2), spread(reach_m)
    low, high, end = np.uint64(rows[0]), np.uint64(rows[1]), np.uint64(begin)
    for j in range(low, high, UL):
        du, dv = load(u, j) - u_at, load(v, j) - v_at
        near = load(first, j) & (du * du + dv * dv <= square)
        near = near & (absolute(load(w, j) - w_at) <= reach) & (ascending(j) < spread(high))
        pack(out, end, ascending(j), near)
        end += number(near)
    return np.int64(end)


@njit()
def in_hard_place(
    i: int, parent: int, which: int, sets: Sets, u: NDArray[np.float64], v: NDArray[np.float64],
    w: NDArray[np.float64], first: NDArray[np.bool_], end: int, rules: Rules,
) -> bool:  # fmt: skip
    """Whether a return lies behind a parent whose neighbourhood is a piece of hard surface.

    For places that no plane of the whole shot fits: ridges, steps, rough ground. ``sets`` holds the
    neighbours and their plane at ``which``; ``end`` is that of the shot's rows.
    """
    a, b, c = sets.plane[which, 0], sets.plane[which, 1], sets.plane[which, 2]
    own = w[parent] - (a + b * u[parent] + c * v[parent])
    depth = w[i] - (a + b * u[i] + c * v[i])
    if abs(own) > rules.below_m or depth <= max(0.5 * rules.dead_m, rules.apart * rules.sigma_m):
        return False
    low, high = sets.first[which], sets.first[which + 1]
    hard = beside = followers = 0
    for k in range(low, high):
        row = np.int64(sets.member[k])
        distance = w[row] - (a + b * u[row] + c * v[row])
        hard += abs(distance) <= SHARP * rules.sigma_m
        # Another first return at the same depth speaks for something real down there.
        beside += abs(distance - depth) <= rules.below_m
        later = row + 1
        while later < end and not first[later]:
            followers += is_behind(w[later] - (a + b * u[later] + c * v[later]), rules)
            later += 1
    sure = hard >= max(RETURNS_MIN, HARD_SHARE * (high - low)) and beside == 0
    return sure and not too_many(followers, hard, rules)


@njit()
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
    """Probability of being an afterpulse, for each return of each shot.

    Parameters
    ----------
    starts : (m + 1,) int64
        Rows where shots start, then n.
    offset : (n, 3) float64
        Points relative to the first one of their shot [m].
    direction : (n, 3) float64
        Unit vectors along the beams; that of the first return frames its shot.
    range_m : (n,) float64
        Slant ranges [m].
    channel : (n,) uint8
        Beamlet of each return; those of one beamlet follow each other.
    lag : (n,) float32
        Distance behind the nearest earlier return of the beamlet [m]; 0 for none.
    out : (n,) float32
        Filled.
    """
    for begin in range(0, len(starts) - 1, TOGETHER):
        shots = starts[begin : begin + TOGETHER + 1]
        rows = slice(shots[0], shots[-1])
        _of_shots(
            shots - shots[0], offset[rows], direction[rows], range_m[rows], channel[rows],
            lag[rows], rules, out[rows],
        )  # fmt: skip


@njit()
def _of_shots(shots, offset, direction, range_m, channel, lag, rules, out):  # type: ignore[no-untyped-def]
    """:func:`shot_probabilities` of a few shots."""
    n, number_of = len(range_m), len(shots) - 1
    u, v, w = np.zeros(n + LANES), np.zeros(n + LANES), np.zeros(n + LANES)
    for i in range(n):
        w[i] = range_m[i]
    across_beams(shots, direction, offset, u, v)
    first = np.zeros(n + LANES, np.bool_)
    with_channels, spread_max = _first_returns(shots, channel, lag, rules, first)
    candidate = _in_full_bins(shots, w, first, rules)
    planes, spreads = np.empty((number_of, SURFACES_MAX, 3)), np.empty((number_of, SURFACES_MAX))
    found = np.empty(number_of, np.int64)
    find_surfaces(shots, u, v, w, candidate, rules, spread_max, planes, spreads, found)
    behind, depths = np.empty((SURFACES_MAX, n)), np.empty((number_of, SURFACES_MAX))
    for shot in range(number_of):
        surfaces = behind[: found[shot]]
        _lay_behind(
            (shots[shot], shots[shot + 1]), u, v, w, planes[shot], spreads[shot], first, rules,
            surfaces, depths[shot],
        )  # fmt: skip
    asked = np.empty((n, 4), np.int64)
    askers = 0
    for shot in range(number_of):
        rows, surfaces = (shots[shot], shots[shot + 1]), behind[: found[shot]]
        if with_channels[shot]:
            askers = _judge(
                rows, surfaces, spreads[shot], depths[shot], channel, lag, u, v, w, first, rules,
                out, asked, askers,
            )  # fmt: skip
            continue
        for i in range(rows[0], rows[1]):
            out[i] = plane_probability(i, surfaces, spreads[shot], rules)
    _look_around(asked, askers, u, v, w, first, rules, out)


@njit()
def _first_returns(shots, channel, lag, rules, first):  # type: ignore[no-untyped-def]
    """Which shots know channels, and how far hard surfaces may spread there; fills ``first``."""
    with_channels, spread_max = np.zeros(len(shots) - 1, np.bool_), np.empty(len(shots) - 1)
    for shot in range(len(shots) - 1):
        low, high = shots[shot], shots[shot + 1]
        for i in range(low + 1, high):
            with_channels[shot] |= channel[i] != channel[low]
        spread_max[shot] = SHARP * rules.sigma_m if with_channels[shot] else np.inf
        for i in range(low, high):
            first[i] = lag[i] == 0 or not with_channels[shot]
    return with_channels, spread_max


@njit()
def _in_full_bins(shots, w, first, rules):  # type: ignore[no-untyped-def]
    """First returns that may be of a surface, by DCC: (n,) bool; none in shots of few returns."""
    keep = np.zeros(len(first), np.bool_)
    for shot in range(len(shots) - 1):
        low, high = shots[shot], shots[shot + 1]
        if high - low >= RETURNS_MIN:
            dcc_keep(w[low:high], rules.gate_m, rules.coarse_m, rules.fine_m, keep[low:high])
    for i in range(len(first)):
        keep[i] &= first[i]
    return keep


@njit()
def _lay_behind(rows, u, v, w, planes, spreads, first, rules, behind, depths):  # type: ignore[no-untyped-def]
    """Fill how far behind each surface of a shot its returns lie, and ``depths``."""
    for s in range(len(behind)):
        a, b, c = planes[s, 0], planes[s, 1], planes[s, 2]
        for i in range(rows[0], rows[1]):
            behind[s, i] = w[i] - (a + b * u[i] + c * v[i])
    for s in range(len(behind)):
        hard, depth = returns_behind(s, rows, behind, spreads, first, rules)
        depths[s] = depth if hard else np.nan


@njit()
def _judge(  # type: ignore[no-untyped-def]
    rows, behind, spreads, depths, channel, lag, u, v, w, first, rules, out, asked, askers
):
    """Probabilities of a shot's returns by its surfaces and lags; how many are listed.

    Listed in ``asked`` from ``askers`` on are returns that may lie behind a hard place: row,
    parent's row, and ``rows``.
    """
    for i in range(rows[0], rows[1]):
        out[i] = 0.0
        # One farther behind its nearest parent cannot have been started by any.
        if not 0.0 < lag[i] <= rules.longest_m:
            continue
        own = beamlet_of(i, rows, channel)
        if follows_surface(i, own, rows, behind, spreads, depths, u, v, w, rules):
            out[i] = HARD
            continue
        out[i] = soft_probability(i, lag[i], rows, w, first, rules)
        parent = nearest_parent(i, own, w, rules)
        if parent >= 0:
            asked[askers, 0], asked[askers, 1] = i, parent
            asked[askers, 2], asked[askers, 3] = rows
            askers += 1
    return askers


@njit()
def _look_around(asked, askers, u, v, w, first, rules, out):  # type: ignore[no-untyped-def]
    """Raise the probability of returns behind hard places, as :func:`_judge` lists them."""
    room = 4 * len(u)
    sets, which = room_for(askers, room), np.empty(askers, np.int64)
    count = begin = 0
    for k in range(askers):
        parent, rows = asked[k, 1], (asked[k, 2], asked[k, 3])
        low = sets.first[count]
        if low + rows[1] - rows[0] > room:
            _raise(begin, k, asked, which, count, sets, u, v, w, first, rules, out)
            begin, count, low = k, 0, 0
        end = neighbours(parent, rows, u, v, w, first, rules.lag_max_m, sets.member, low)
        which[k] = -1
        if end - low >= RETURNS_MIN:
            sets.first[count + 1] = end
            which[k] = _same(count, rows[0], sets)
            count += which[k] == count
    _raise(begin, askers, asked, which, count, sets, u, v, w, first, rules, out)


@njit()
def _same(last: int, begin: int, sets: Sets) -> int:
    """The earlier set of the shot that equals the last one: often there is one."""
    low, size = sets.first[last], sets.first[last + 1] - sets.first[last]
    one = last
    while one > 0 and sets.member[sets.first[one - 1]] >= begin:
        one -= 1
        start, k = sets.first[one], 0
        if sets.first[one + 1] - start == size:
            while k < size and sets.member[start + k] == sets.member[low + k]:
                k += 1
        if k == size:
            return one
    return last


@njit()
def _raise(begin, end, asked, which, count, sets, u, v, w, first, rules, out):  # type: ignore[no-untyped-def]
    """Fit the places around parents, and raise the probability of what follows hard ones."""
    weight = np.empty(sets.first[count])
    fit_planes(
        count, sets.first, sets.member, u, v, w, rules.sigma_m, sets.plane, weight, sets.trusted
    )
    for k in range(begin, end):
        i, parent, one = asked[k, 0], asked[k, 1], which[k]
        if one < 0 or not sets.trusted[one]:
            continue
        if in_hard_place(i, parent, one, sets, u, v, w, first, asked[k, 3], rules):
            out[i] = HARD
