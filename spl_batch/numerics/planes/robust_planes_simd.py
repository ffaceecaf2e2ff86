"""Iteratively re-weighted planes of many sets of returns, eight of them side by side.

Source: [W17 ch. 7]; bisquare of W17 [110]. The plane gives the range as a function of the two
coordinates across the beam, because that is the direction of the ranging noise and of an
afterpulse's lag.

A plane is some ten rounds over a dozen returns, each round a median and nine sums that have to be
added in order: little for a vector instruction to do, and much to wait for. Sets have nothing to
do with each other. So each lane of a register holds a set of its own, and all that a round does is
done for eight sets at once, in the order in which it would be done for one; where a set is
finished the next one takes its lane.

Medians come from networks of comparisons, the same ones whatever the values are [Batcher 1968;
Knuth, vol. 3, 5.2.2 M], written out without a loop. Half of what a set lacks to the length of its
network counts as less than all values, half as more: the median then is in the middle.
"""

import numpy as np
from numpy.typing import NDArray

from spl_batch.numerics.compiled import njit
from spl_batch.numerics.planes.robust_plane import BISQUARE, FLATTEST, GAUSSIAN
from spl_batch.numerics.simd import (
    LANES,
    UL,
    absolute,
    greater,
    load,
    middles,
    spread,
    store,
    where,
)
from spl_batch.numerics.sorting import select

ITERATIONS = 30
"""Most re-weightings."""

SETTLED = 1e-6
"""Change of the coefficients below which a plane is settled."""

NETWORK_MAX = 64
"""Most values that there is a network for; lanes with more are looked at one by one [count]."""

U0, U1 = np.uint64(0), np.uint64(1)
"""Unsigned numbers, as indices of lanes are."""


def _merge_exchange(size: int) -> list[tuple[int, int]]:
    """Comparisons that sort ``size`` values, in order."""
    found: list[tuple[int, int]] = []
    p = top = 1 << ((size - 1).bit_length() - 1)
    while p > 0:
        q, r, d = top, 0, p
        while True:
            found += [(i, i + d) for i in range(size - d) if i & p == r]
            if q == p:
                break
            q, r, d = q // 2, p, q - p
        p //= 2
    return found


_of_8, _of_16, _of_24, _of_32, _of_48, _of_64 = (
    middles(_merge_exchange(size), size) for size in (8, 16, 24, 32, 48, 64)
)


@njit()
def two_in_the_middle(values, size):  # type: ignore[no-untyped-def]
    """The two in the middle of as many values as the network of :func:`_lengths` sorts, by lane."""
    if size <= 16:
        return _of_8(values, U0) if size == 8 else _of_16(values, U0)
    if size <= 32:
        return _of_24(values, U0) if size == 24 else _of_32(values, U0)
    if size <= NETWORK_MAX:
        return _of_48(values, U0) if size == 48 else _of_64(values, U0)
    lower, upper, room = np.empty(LANES), np.empty(LANES), np.empty(size)
    for lane in range(LANES):
        for k in range(size):
            room[k] = values[k * LANES + lane]
        upper[lane] = select(room, size // 2)
        lower[lane] = room[0]
        for k in range(1, size // 2):
            lower[lane] = max(lower[lane], room[k])
    return load(lower, U0), load(upper, U0)


@njit()
def fit_planes(
    sets: int,
    first: NDArray[np.int64],
    member: NDArray[np.uint64],
    u: NDArray[np.float64],
    v: NDArray[np.float64],
    w: NDArray[np.float64],
    scale_min: float,
    plane: NDArray[np.float64],
    weight: NDArray[np.float64],
    there: NDArray[np.bool_],
) -> None:
    """Robust planes: all weights one at first, then Tukey's bisquare of the residuals.

    Parameters
    ----------
    first : (sets + 1 or more,) int64
        Where the rows of each set start in ``member``, and where the last ones end; at least four.
    member : (m,) uint64
        Rows of the returns of each set.
    u, v, w : (n,) float64
        Coordinates of all returns across and along the beam [m].
    scale_min : float
        Least scale of the residuals, so that a perfect fit does not reject all [m].
    plane : (sets or more, 3) float64
        Filled with a, b, c of ``w = a + b u + c v``.
    weight : (m,) float64
        Filled with the last weights.
    there : (sets or more,) bool
        Filled: whether there is a plane; there is none of points on one line, seen along the beam.
    """
    longest = 0
    for one in range(sets):
        longest = max(longest, first[one + 1] - first[one])
    order = _by_length(sets, longest, first)
    room = (longest + 15) // 16 * 16 * LANES
    x, y, z, weights = np.zeros(room), np.zeros(room), np.zeros(room), np.empty(room)
    distance, sorting = np.empty(room), np.empty(room)
    own, rounds = np.full(LANES, -1, np.int64), np.zeros(LANES, np.int64)
    size, sizes = np.zeros(LANES, np.int64), np.zeros(3 * LANES, np.uint64)
    fresh, now = np.zeros(LANES), np.zeros(3 * LANES)
    news, failed = np.empty(4 * LANES), np.empty(LANES)
    waiting, held = _fill(0, order, first, member, u, v, w, own, rounds, fresh, size, x, y, z)
    while held > 0:
        steps = _lengths(size, sizes)
        _weigh(steps, x, y, z, now, sizes, fresh, scale_min, distance, sorting, weights)
        _solve(steps, x, y, z, weights, now, news, failed)
        if _finish(first, own, rounds, fresh, size, weights, now, news, failed,
                   plane, weight, there):  # fmt: skip
            waiting, held = _fill(
                waiting, order, first, member, u, v, w, own, rounds, fresh, size, x, y, z
            )


@njit()
def _fill(waiting, order, first, member, u, v, w, own, rounds, fresh, size, x, y, z):  # type: ignore[no-untyped-def]
    """Give lanes that hold none the next sets: how many have had their turn, and lanes held."""
    held = 0
    for lane in range(LANES):
        if own[lane] < 0 and waiting < len(order):
            one = order[waiting]
            waiting += 1
            low, count = first[one], first[one + 1] - first[one]
            own[lane], rounds[lane], fresh[lane] = one, 0, 1.0
            for k in range(count):
                row, at = member[low + k], k * LANES + lane
                x[at], y[at], z[at] = u[row], v[row], w[row]
            for k in range(count, size[lane]):
                at = k * LANES + lane
                x[at] = y[at] = z[at] = 0.0
            size[lane] = count
        held += own[lane] >= 0
    return waiting, held


@njit()
def _finish(first, own, rounds, fresh, size, weights, now, news, failed, plane, weight, there):  # type: ignore[no-untyped-def]
    """Take over the new coefficients, and give out what is finished: whether there is any."""
    any_done = False
    for lane in range(LANES):
        one = own[lane]
        if one < 0:
            continue
        lost = failed[lane] > 0.0
        done = lost or (fresh[lane] == 0.0 and news[3 * LANES + lane] < SETTLED)
        if not lost:
            for k in range(3):
                now[k * LANES + lane] = news[k * LANES + lane]
            rounds[lane] += 1
            done = done or rounds[lane] > ITERATIONS
        fresh[lane] = 0.0
        if done:
            any_done, there[one] = True, not lost
            for k in range(3):
                plane[one, k] = now[k * LANES + lane]
            low = first[one]
            for k in range(size[lane]):
                weight[low + k] = weights[k * LANES + lane]
            own[lane] = -1
    return any_done


@njit()
def _by_length(sets: int, longest: int, first: NDArray[np.int64]) -> NDArray[np.int64]:
    """Sets from the longest to the shortest one: those of about one length come together."""
    slot = np.zeros(longest + 2, np.int64)
    for one in range(sets):
        slot[longest - (first[one + 1] - first[one]) + 1] += 1
    for k in range(longest + 1):
        slot[k + 1] += slot[k]
    order = np.empty(sets, np.int64)
    for one in range(sets):
        k = longest - (first[one + 1] - first[one])
        order[slot[k]] = one
        slot[k] += 1
    return order


@njit()
def _lengths(size: NDArray[np.int64], sizes: NDArray[np.uint64]) -> tuple[int, int, int]:
    """Least and largest number of returns of the lanes, and that of the network.

    ``sizes`` (24,) is filled with the numbers, with what then counts as less than all values up to
    this row, and with whether a number is odd.
    """
    fewest = most = size[0]
    for lane in range(LANES):
        fewest, most = min(fewest, size[lane]), max(most, size[lane])
    # The shortest network that takes them; a multiple of 16 where there is none.
    network = (max(most, 1) + 7) // 8 * 8 if most <= 32 else (most + 15) // 16 * 16
    for lane in range(LANES):
        sizes[lane] = size[lane]
        sizes[LANES + lane] = size[lane] + (network - size[lane]) // 2
        sizes[2 * LANES + lane] = size[lane] % 2
    return fewest, most, network


@njit()
def _weigh(steps, x, y, z, now, sizes, fresh, scale_min, distance, sorting, weights):  # type: ignore[no-untyped-def]
    """Weights of the returns by their residuals; one in lanes that are fresh, 0 beyond sizes."""
    a, b, c = load(now, U0), load(now, UL), load(now, UL + UL)
    none, most, least, unit = spread(0.0), spread(np.inf), spread(-np.inf), spread(1.0)
    size, lacking, odd = load(sizes, U0), load(sizes, UL), load(sizes, UL + UL)
    filled, end, whole = (
        np.uint64(steps[0]) * UL,
        np.uint64(steps[1]) * UL,
        np.uint64(steps[2]) * UL,
    )
    for at in range(U0, filled, UL):
        away = absolute(load(z, at) - (a + b * load(x, at) + c * load(y, at)))
        store(distance, at, away)
        store(sorting, at, away)
    for at in range(filled, end, UL):
        row = spread(at // UL)
        away = absolute(load(z, at) - (a + b * load(x, at) + c * load(y, at)))
        inside = row < size
        store(distance, at, where(inside, away, most))
        store(sorting, at, where(inside, away, where(row < lacking, least, most)))
    for at in range(end, whole, UL):
        store(sorting, at, where(spread(at // UL) < lacking, least, most))
    lower, upper = two_in_the_middle(sorting, steps[2])
    median = where(odd == spread(U1), lower, spread(0.5) * (upper + lower))
    scale = spread(BISQUARE) * greater(median / spread(GAUSSIAN), spread(scale_min))
    # All are within an endless scale, but for what lies beyond: that is no number of it.
    scale = where(load(fresh, U0) > none, most, scale)
    for at in range(U0, end, UL):
        ratio = load(distance, at) / scale
        rest = unit - ratio * ratio
        store(weights, at, where(ratio < unit, rest * rest, none))


@njit()
def _solve(steps, x, y, z, weights, now, news, failed):  # type: ignore[no-untyped-def]
    """Planes of least squares: new coefficients, the largest change, and where there are none."""
    none, end = spread(0.0), np.uint64(steps[1]) * UL
    total = mu = mv = mw = none
    for at in range(U0, end, UL):
        g = load(weights, at)
        total = total + g
        mu = mu + g * load(x, at)
        mv = mv + g * load(y, at)
        mw = mw + g * load(z, at)
    mu, mv, mw = mu / total, mv / total, mw / total
    uu = uv = vv = uw = vw = none
    for at in range(U0, end, UL):
        g = load(weights, at)
        du, dv, dw = load(x, at) - mu, load(y, at) - mv, load(z, at) - mw
        gu, gv = g * du, g * dv
        uu = uu + gu * du
        uv = uv + gu * dv
        vv = vv + gv * dv
        uw = uw + gu * dw
        vw = vw + gv * dw
    determinant = uu * vv - uv * uv
    trace = uu + vv
    flat = (determinant <= spread(FLATTEST) * (trace * trace)) | (total <= none)
    b = (uw * vv - vw * uv) / determinant
    c = (vw * uu - uw * uv) / determinant
    a = mw - b * mu - c * mv
    store(failed, U0, where(flat, spread(1.0), none))
    most = absolute(a - load(now, U0))
    most = greater(most, absolute(b - load(now, UL)))
    most = greater(most, absolute(c - load(now, UL + UL)))
    store(news, U0, a)
    store(news, UL, b)
    store(news, UL + UL, c)
    store(news, UL + UL + UL, most)
