"""Hard surfaces of many shots: planes grown from seeds, each step for all shots side by side.

See :mod:`spl_batch.airborne.afterpulse.candidates` for the method and its deviations.
"""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.afterpulse.hard_surfaces import (
    NEAR_M,
    RETURNS_MIN,
    SURFACES_MAX,
    Rules,
    densest,
    fit_surfaces,
    on_surface,
)
from spl_batch.numerics.compiled import njit
from spl_batch.numerics.simd import LANES, UL, absolute, ascending, load, number, pack, spread

GROWN: Final = 2
"""How often a surface is fitted again to the candidates that lie on it [count]."""


class Left(NamedTuple):
    """Candidates of some shots that no surface holds yet; a shot's begin at its first row."""

    row: NDArray[np.uint64]  #: (n + 8,): their rows.
    #: (n + 8,): their coordinates across and along the beam [m].
    u: NDArray[np.float64]
    v: NDArray[np.float64]
    w: NDArray[np.float64]
    size: NDArray[np.int64]  #: (s,): how many a shot has.


class Sets(NamedTuple):
    """Sets of candidates that planes are fitted to, and these."""

    #: (k + 1,): where the rows of each start in ``member``, then where the last ones end.
    first: NDArray[np.int64]
    member: NDArray[np.uint64]  #: (m,): their rows; there is room for eight more.
    owner: NDArray[np.int64]  #: (k,): shot of each.
    #: What :func:`fit_surfaces` fills.
    plane: NDArray[np.float64]
    trusted: NDArray[np.bool_]
    spread: NDArray[np.float64]


@njit()
def room_for(sets: int, members: int) -> Sets:
    """Empty :class:`Sets`."""
    return Sets(
        np.zeros(sets + 1, np.int64), np.empty(members + LANES, np.uint64),
        np.empty(sets, np.int64), np.empty((sets, 3)), np.empty(sets, np.bool_), np.empty(sets),
    )  # fmt: skip


@njit()
def _added(count, end, shot, sets):  # type: ignore[no-untyped-def]
    """Close the open set before row ``end`` if it is large enough; the number of sets."""
    if end - sets.first[count] < RETURNS_MIN:
        return count
    sets.owner[count], sets.first[count + 1] = shot, end
    return count + 1


@njit()
def seed(shot: int, begin: int, left: Left, rules: Rules, count: int, sets: Sets) -> int:
    """Sets of candidates to start surfaces from: four corners at most, then the fullest window.

    The shot, from row ``begin`` on, has at least one candidate. Returns the number of sets.
    """
    low, high = np.uint64(begin), np.uint64(begin + left.size[shot])
    rows, u, v, w = left.row, left.u, left.v, left.w
    corners = (
        _farthest(low, high, u, v, 1.0, 1.0), _farthest(low, high, u, v, -1.0, 1.0),
        _farthest(low, high, u, v, 1.0, -1.0), _farthest(low, high, u, v, -1.0, -1.0),
    )  # fmt: skip
    square, reach = spread(NEAR_M**2), spread(NEAR_M)
    for corner in corners:
        end = np.uint64(sets.first[count])
        u_at, v_at, w_at = spread(u[corner]), spread(v[corner]), spread(w[corner])
        for k in range(low, high, UL):
            du, dv = load(u, k) - u_at, load(v, k) - v_at
            near = (du * du + dv * dv <= square) & (absolute(load(w, k) - w_at) <= reach)
            near = near & (ascending(k) < spread(high))
            pack(sets.member, end, load(rows, k), near)
            end += number(near)
        count = _added(count, np.int64(end), shot, sets)
    width = 2.0 * rules.p68_max_m
    start, _ = densest(w, low, high, width)
    end = np.uint64(sets.first[count])
    for k in range(low, high, UL):
        at = load(w, k)
        within = (at >= spread(start)) & (at <= spread(start + width))
        within = within & (ascending(k) < spread(high))
        pack(sets.member, end, load(rows, k), within)
        end += number(within)
    total: int = _added(count, np.int64(end), shot, sets)
    return total


@njit()
def _farthest(low, high, u, v, su: float, sv: float):  # type: ignore[no-untyped-def]
    """The first of the rows that lie farthest towards a corner of the shot."""
    corner, most = low, su * u[low] + sv * v[low]
    for k in range(low, high):
        here = su * u[k] + sv * v[k]
        if here > most:
            corner, most = k, here
    return corner


@njit()
def grown(
    shots: NDArray[np.int64], left: Left, rules: Rules, count: int, sets: Sets
) -> int:  # fmt: skip
    """Refill the sets of trusted planes with the candidates on them; how many sets remain."""
    kept = 0
    for one in range(count):
        if not sets.trusted[one]:
            continue
        shot = sets.owner[one]
        low, high = np.uint64(shots[shot]), np.uint64(shots[shot] + left.size[shot])
        a, b, c = spread(sets.plane[one, 0]), sets.plane[one, 1], sets.plane[one, 2]
        slope_u, slope_v = spread(b), spread(c)
        reach = spread(max(rules.below_m, 3.0 * sets.spread[one]))
        end = np.uint64(sets.first[kept])
        for k in range(low, high, UL):
            level = a + slope_u * load(left.u, k) + slope_v * load(left.v, k)
            on = absolute(load(left.w, k) - level) <= reach
            on = on & (ascending(k) < spread(high))
            pack(sets.member, end, load(left.row, k), on)
            end += number(on)
        kept = _added(kept, np.int64(end), shot, sets)
    return kept


@njit()
def find_surfaces(
    shots: NDArray[np.int64], u: NDArray[np.float64], v: NDArray[np.float64],
    w: NDArray[np.float64], candidate: NDArray[np.bool_], rules: Rules,
    spread_max: NDArray[np.float64], planes: NDArray[np.float64], spreads: NDArray[np.float64],
    found: NDArray[np.int64],
) -> None:  # fmt: skip
    """Hard surfaces of shots: one plane as published, else several.

    Where one plane does not do (roof beside ground, a ridge, ground under a tree), planes grow from
    the corners of the shot and from its fullest range. The largest is taken if it stands out from
    an even spread of the candidates, then the next. Shots do not affect each other; they come
    together because their planes are fitted together.

    ``spread_max`` (s,) bounds the spread of a surface's residuals [m], which keeps crowns out; it
    is infinite as published, where the 68th percentile alone decides. ``planes`` (s, SURFACES_MAX,
    3), ``spreads`` [m] and ``found`` (s,), their number, are filled.
    """
    left = _candidates(shots, u, v, w, candidate)
    sets = room_for(5 * len(found), 5 * len(u))
    pending = np.empty(len(found), np.int64)
    count = waiting = 0
    for shot in range(len(found)):
        found[shot] = 0
        end = sets.first[count]
        for k in range(shots[shot], shots[shot] + left.size[shot]):
            sets.member[end] = left.row[k]
            end += 1
        count = _added(count, end, shot, sets)
    # One call for all steps is one copy of all that is called.
    step = GROWN
    while count > 0 or waiting > 0:
        fit_surfaces(
            count, sets.first, sets.member, u, v, w, rules, sets.plane, sets.trusted, sets.spread
        )
        if step < GROWN:
            count, step = grown(shots, left, rules, count, sets), step + 1
            continue
        if waiting == 0:
            waiting = _take_whole(count, sets, spread_max, planes, spreads, found, pending)
        else:
            waiting = _take_best(
                pending, waiting, shots, left, rules, spread_max, count, sets,
                planes, spreads, found,
            )  # fmt: skip
        count = step = 0
        for k in range(waiting):
            count = seed(pending[k], shots[pending[k]], left, rules, count, sets)


@njit()
def _take_whole(count, sets, spread_max, planes, spreads, found, pending):  # type: ignore[no-untyped-def]
    """Take planes fitted to all candidates of a shot; how many shots need more."""
    waiting = 0
    for one in range(count):
        shot = sets.owner[one]
        if sets.trusted[one] and sets.spread[one] <= spread_max[shot]:
            _keep(one, sets, shot, 0, planes, spreads)
            found[shot] = 1
        else:
            pending[waiting] = shot
            waiting += 1
    return waiting


@njit()
def _keep(one, sets, shot, at, planes, spreads):  # type: ignore[no-untyped-def]
    """Keep the plane of a set as a surface of its shot."""
    spreads[shot, at] = sets.spread[one]
    for k in range(3):
        planes[shot, at, k] = sets.plane[one, k]


@njit()
def _candidates(shots, u, v, w, candidate):  # type: ignore[no-untyped-def]
    """:class:`Left` before any surface is found."""
    room = len(u) + LANES
    left = Left(
        np.zeros(room, np.uint64), np.zeros(room), np.zeros(room), np.zeros(room),
        np.zeros(len(shots) - 1, np.int64),
    )  # fmt: skip
    for shot in range(len(shots) - 1):
        end = shots[shot]
        for row in range(shots[shot], shots[shot + 1]):
            left.row[end], left.u[end], left.v[end], left.w[end] = row, u[row], v[row], w[row]
            end += candidate[row]
        left.size[shot] = end - shots[shot]
    return left


@njit()
def _take_best(  # type: ignore[no-untyped-def]
    pending, waiting, shots, left, rules, spread_max, count, sets, planes, spreads, found
):
    """Take the largest of each shot's surfaces, if it stands out; how many shots go on."""
    one = going = 0
    for k in range(waiting):
        shot = pending[k]
        best, which = 0, 0
        while one < count and sets.owner[one] == shot:
            size = sets.first[one + 1] - sets.first[one]
            if sets.trusted[one] and sets.spread[one] <= spread_max[shot] and size > best:
                best, which = size, one
            one += 1
        if best == 0 or not _stands_out(best, shots[shot], shot, left, rules):
            continue
        at = found[shot]
        _keep(which, sets, shot, at, planes, spreads)
        found[shot] += 1
        _leave(planes[shot, at], spreads[shot, at], shots[shot], shot, left, rules)
        if found[shot] < SURFACES_MAX and left.size[shot] >= RETURNS_MIN:
            pending[going] = shot
            going += 1
    return going


@njit()
def _stands_out(best, begin, shot, left, rules):  # type: ignore[no-untyped-def]
    """Whether a surface holds more candidates than an even spread would give it."""
    size = left.size[shot]
    low = high = left.w[begin]
    for k in range(begin, begin + size):
        low, high = min(low, left.w[k]), max(high, left.w[k])
    even = size * 2.0 * rules.below_m / max(high - low, 2.0 * rules.p68_max_m)
    return best >= RETURNS_MIN + 2.0 * even


@njit()
def _leave(plane, spread, begin: int, shot: int, left: Left, rules: Rules) -> None:  # type: ignore[no-untyped-def]
    """Take the candidates on a plane off the list."""
    end = begin
    for k in range(begin, begin + left.size[shot]):
        u, v, w = left.u[k], left.v[k], left.w[k]
        left.row[end], left.u[end], left.v[end], left.w[end] = left.row[k], u, v, w
        end += not on_surface(w - (plane[0] + plane[1] * u + plane[2] * v), spread, rules)
    left.size[shot] = end - begin
