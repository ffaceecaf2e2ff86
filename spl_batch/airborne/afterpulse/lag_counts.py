"""Counts of afterpulses by lag, behind planes where nothing else can follow, and of these planes.

See :mod:`spl_batch.airborne.afterpulse.afterpulse_law`. Returns on a hard plane spread by the
ranging noise alone, on other planes by more: the least spread of planes gives it. Heath and meadows
have no hard plane: then even the least spreads are unlike, and the sensor's own figure stands.
"""

import math
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.afterpulse.hard_surfaces import (
    STEP_M,
    Rules,
    behind_of,
    candidates,
    fit_surfaces,
    on_surface,
)
from spl_batch.airborne.sensors.sensor import Sensor
from spl_batch.numerics.compiled import njit
from spl_batch.numerics.sorting import first_above

CLEAN = 0.9
"""Least share of a shot's first returns, on its plane and behind it, that lie on it. Half moves 20
+ 2 labels, 1.0 120 + 66 labels."""

PARENTS_MIN = 12
"""Least first returns on that plane [count]. Half and twice move 0 + 4 and 20 + 31 labels."""

BEHIND = 2.5
"""A follower so far behind a plane does not belong to the surface itself [spreads]. Half and twice
move 14 + 7 and 21 + 32 labels."""

TILTED = 0.9
"""Cosine of the angle between a beam and the normal of a plane up to which the plane is taken as it
is: 26 degrees, level ground and usual roofs."""

SPREAD_STEP_M = 0.01
SPREADS = 64
"""Steps in which the spread of planes is counted [m], and how many there are."""

LAG_EDGES_M: Final = np.concatenate([np.arange(81) * STEP_M, np.geomspace(4.0, 60.0, 56)[1:]])
"""Edges of the bins of lags [m]: as fine as the law near the return, far behind it a twentieth of
the lag."""


PLANES_LEAST: Final = 30
"""Planes that make a spread or a tail known [count]: a few of shrubs look alike, and may just have
something behind them."""

QUANTILE: Final = 0.2
"""Quantile of the planes' spreads: in any survey with planes a fifth of them is hard."""

SPREAD_CHANCE: Final = 1.15
"""Spread of hard planes over that quantile, estimated from some twenty returns of a plane. Half
moves nothing, twice 304 + 1063 labels."""

BELIEVED: Final = 1.3
"""Factor to the sensor's spread below which a larger one is roughness of the ground. Half moves 48
+ 131 labels, twice nothing."""

LOW: Final = 0.1
ALIKE: Final = 0.7
"""Spreads of hard planes are alike: of those up to :data:`QUANTILE` no larger share is smaller than
the largest times this. From twenty returns, that is 0.78 on the level and 0.72 on mountains; on
real heath it is 0.35 to 0.66."""


class Counts(NamedTuple):
    """Counts behind the planes of a flightline; parts of it add up.

    They are kept by the planes' spread: which planes are hard depends on the ranging noise, and
    that is known only when all are counted.
    """

    #: (s,): planes by the spread of the returns on them, in steps of :data:`SPREAD_STEP_M`.
    planes: NDArray[np.int64]
    #: (s, b): returns on them, by the shortest lag at which a follower no longer belongs to the
    #: surface itself; bins as in :data:`LAG_EDGES_M`.
    entries: NDArray[np.int64]
    #: (s, b): the beamlet's next returns by lag, where no shorter than that.
    followers: NDArray[np.int64]


def no_counts() -> Counts:
    """Counts before any plane is seen."""
    shape = (SPREADS, len(LAG_EDGES_M) - 1)
    return Counts(np.zeros(SPREADS, np.int64), np.zeros(shape, np.int64), np.zeros(shape, np.int64))


@njit()
def observe_lags(
    starts: NDArray[np.int64], chosen: NDArray[np.int64], u: NDArray[np.float64],
    v: NDArray[np.float64], range_m: NDArray[np.float64], channel: NDArray[np.uint8],
    lag: NDArray[np.float32], rules: Rules, edges: NDArray[np.float64], counts: Counts,
) -> None:  # fmt: skip
    """Count what follows the first returns on a plane that is alone in its shot, of chosen shots.

    Arrays are as in :func:`~spl_batch.airborne.afterpulse.shot_evidence.shot_probabilities`; lags
    reach up to the last edge.
    """
    first = candidates(starts, lag == 0, PARENTS_MIN, range_m, rules)
    found = fit_surfaces(starts, first, u, v, range_m, rules)
    for shot in chosen:
        if found.trusted[shot]:
            rows, plane = slice(starts[shot], starts[shot + 1]), found.plane[shot]
            distance = np.empty(starts[shot + 1] - starts[shot])
            for k in range(len(distance)):
                distance[k] = behind_of(plane, starts[shot] + k, u, v, range_m)
            _observe(
                range_m[rows], channel[rows], lag[rows], distance, found.spread[shot],
                _square(plane), rules, edges, counts,
            )  # fmt: skip


@njit()
def _observe(w, channel, lag, distance, spread, square, rules, edges, counts):  # type: ignore[no-untyped-def]
    """Count what follows the first returns on a plane that is alone in its shot."""
    on, near, total = np.empty(len(w), np.bool_), 0, 0.0
    parents = 0
    for i in range(len(w)):
        on[i] = lag[i] == 0 and on_surface(distance[i], spread, rules)
        if on[i]:
            parents += 1
            total += distance[i] ** 2
        near += lag[i] == 0 and not on[i] and 0.0 < distance[i] <= rules.lag_max_m
    # The plane is alone where the first returns lie on it and next to none behind it.
    if parents < PARENTS_MIN or parents < CLEAN * (parents + near):
        return
    # Standard deviation of the returns on a plane, whose fit takes three of them [m].
    scale = math.sqrt(total / max(parents - 3, 1))
    k = min(int(scale * square / SPREAD_STEP_M), len(counts.planes) - 1)
    counts.planes[k] += 1
    for i in range(len(w)):
        if on[i]:
            # Shorter lags may be those of a second return of the plane itself.
            shortest = max(BEHIND * scale - distance[i], 0.0)
            begin = first_above(edges, shortest)
            begin -= int(begin > 0 and edges[begin - 1] == shortest)  # edges all differ
            follower = next_return(i, w, channel)
            at = len(edges) - 1
            if follower >= 0:
                at = min(first_above(edges, w[follower] - w[i]) - 1, at)
            if at >= begin:
                counts.entries[k, begin] += 1
                if at < len(edges) - 1:
                    counts.followers[k, at] += 1


@njit()
def next_return(i: int, w: NDArray[np.float64], channel: NDArray[np.uint8]) -> int:
    """The next return of a beamlet behind one of it; -1 for none."""
    found = -1
    for j in range(len(w)):
        if channel[j] == channel[i] and w[j] > w[i] and (found < 0 or w[j] < w[found]):
            found = j
    return found


@njit()
def _square(plane):  # type: ignore[no-untyped-def]
    """Factor to the spread of a plane along the beam that leaves what ranging noise does.

    A plane that is tilted off the beam also spreads by the beam's width, which is about as much as
    the noise: beyond :data:`TILTED` its spread square to itself is taken.
    """
    upright = 1.0 / math.sqrt(1.0 + plane[1] ** 2 + plane[2] ** 2)
    return min(upright / TILTED, 1.0)


@njit()
def law_at(lag: float, dead_m: float, law: NDArray[np.float64]) -> float:
    """Afterpulses per detection and metre at a lag, linear between tabled values [1/m]."""
    at = max(lag - dead_m, 0.0) / STEP_M
    k = min(int(at), len(law) - 1)
    up = min(k + 1, len(law) - 1)
    return float(law[k] + min(at - k, 1.0) * (law[up] - law[k]))


@njit()
def rate_behind(
    starts: NDArray[np.int64], range_m: NDArray[np.float64], least_m: float, reach_m: float,
    dead_m: float, law: NDArray[np.float64], rate: NDArray[np.float32],
) -> None:  # fmt: skip
    """Afterpulses per metre expected at each return, of all earlier ones of its beamlet.

    ``starts`` (m + 1,): rows where beamlets start, then n; ranges may be in any order within one.
    ``rate`` (n,) is filled [1/m]; 0 where no return is in front.
    """
    for b in range(len(starts) - 1):
        for i in range(starts[b], starts[b + 1]):
            total = 0.0
            for j in range(starts[b], starts[b + 1]):
                lag = range_m[i] - range_m[j]
                if lag > 0.0 and least_m <= lag <= reach_m:
                    total += law_at(lag, dead_m, law)
            rate[i] = total


def ranging_spread(planes: NDArray[np.int64], sensor: Sensor) -> float:
    """One standard deviation of ranges, never less than the sensor's [m].

    ``planes``: planes by their spread, in steps of :data:`SPREAD_STEP_M` [count].
    """
    stated = sensor.range_sigma_m
    if planes.sum() < PLANES_LEAST or not _alike_spreads(planes):
        return stated
    found = SPREAD_CHANCE * _quantile(planes, QUANTILE)
    return found if found > BELIEVED * stated else stated


def _alike_spreads(planes: NDArray[np.int64]) -> bool:
    """Whether the least spreads are those of hard planes."""
    least, most = (_quantile(planes, share) for share in (LOW * QUANTILE, QUANTILE))
    return least >= ALIKE * most


def _quantile(planes: NDArray[Any], share: float) -> float:
    """Spread below which a share of planes lies [m]."""
    before = np.insert(np.cumsum(planes), 0, 0.0) / planes.sum()
    edges = np.arange(len(planes) + 1) * SPREAD_STEP_M
    return float(np.interp(share, before, edges))
