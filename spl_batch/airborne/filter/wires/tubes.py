r"""Tubes along lines of returns: what they hold, how they agree, and what is around them.

A conductor is longer than a tube, and seldom alone: tubes along it point along one another, those
of its neighbours lie side by side. Chance tubes point anywhere.

====== ==========================================================================
symbol name
====== ==========================================================================
x, y, v offset from a tube's hanging line: along, across, upwards [quanta]
d       max(|y|, |v|): distance off the line, in square rings [quanta]
====== ==========================================================================
"""

import math
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.lattice.lattice_columns import Columns, first_above, stretch_of
from spl_batch.numerics.compiled import njit
from spl_batch.numerics.neighbours.kdtree import U0, U1, U2
from spl_batch.numerics.simd import LANES, UL, absolute, ascending, load, number, pack, spread

PARTS: Final = 8
"""Equal parts of a tube that are distinguished [count]."""

ROUNDED: Final = math.sqrt(3.0)
"""Farthest that middles of two tubes move when they are rounded, half a quantum along each axis
[quanta]."""


class Tubes(NamedTuple):
    """Tubes through points: m of them."""

    row: NDArray[np.intp]  #: (m,): point that each goes through.
    middle: NDArray[np.float64]  #: (m, 3): point of its line beside that one [quanta].
    #: (m,): direction [rad, rise/run] and half-length [quanta].
    azimuth: NDArray[np.float64]
    slope: NDArray[np.float64]
    length: NDArray[np.float64]
    p: NDArray[np.float64]  #: (m,): directions tried x P(K >= k), at most 1.

    def take(self, rows: NDArray[Any]) -> "Tubes":
        """Some of the tubes."""
        return Tubes(*(values[rows] for values in self))


@njit()
def _room(made: Columns):  # type: ignore[no-untyped-def]
    """Room for the slots of a tube's points, uint64, and for their places: x, y, v, float64."""
    room = made.points.shape[1] + LANES
    return np.empty(room, np.uint64), np.empty((3, room))


@njit()
def _in_tube(  # type: ignore[no-untyped-def]
    made: Columns, tubes: Tubes, s: int, reach, aside, above, bend, slots, places
):
    """List the points of a tube drawn out to ``reach`` along its line; how many they are.

    ``aside, above``: its half-widths. ``slots`` and ``places``: :func:`_room`.
    """
    east, north = math.cos(tubes.azimuth[s]), math.sin(tubes.azimuth[s])
    x0, y0, z0 = tubes.middle[s, 0], tubes.middle[s, 1], tubes.middle[s, 2]
    slope, edge, points = tubes.slope[s], made.edge, made.points
    nx, ny = made.shape
    long, deep = abs(east) * reach + abs(north) * aside, abs(north) * reach + abs(east) * aside
    i0, i1 = stretch_of(x0 - made.corner[0], long, edge, nx)
    j0, j1 = stretch_of(y0 - made.corner[1], deep, edge, ny)
    size = U0
    for i in range(i0, i1):
        for j in range(j0, j1):
            # A column whose axis is farther off than its half diagonal holds nothing.
            cx = made.corner[0] + (i + 0.5) * edge - x0
            cy = made.corner[1] + (j + 0.5) * edge - y0
            if abs(cy * east - cx * north) > aside + 0.71 * edge:
                continue
            x = cx * east + cy * north
            far = abs(x) + edge
            rise = abs(slope) * edge + above
            low, high = z0 + slope * x - rise, z0 + slope * x + rise + bend * far * far
            first, stop = made.start[i * ny + j], made.start[i * ny + j + 1]
            first = first_above(points, first, stop, low)
            end = np.uint64(first_above(points, first, stop, math.floor(high) + 1.0))
            for slot in range(np.uint64(first), end, UL):
                dx = load(points, (U0, slot)) - spread(x0)
                dy = load(points, (U1, slot)) - spread(y0)
                dz = load(points, (U2, slot)) - spread(z0)
                along = dx * spread(east) + dy * spread(north)
                across = dy * spread(east) - dx * spread(north)
                up = dz - spread(slope) * along - spread(bend) * along * along
                taken = (absolute(along) <= spread(reach)) & (ascending(slot) < spread(end))
                taken = taken & (absolute(across) <= spread(aside))
                taken = taken & (absolute(up) <= spread(above))
                pack(slots, size, ascending(slot), taken)
                pack(places, (U0, size), along, taken)
                pack(places, (U1, size), across, taken)
                pack(places, (U2, size), up, taken)
                size += number(taken)
    return size


@njit()
def refine(
    made: Columns, tubes: Tubes, radius: float, bend: float, flank: NDArray[np.int32]
) -> None:
    """Lay a line through the returns of each tube, by least squares: replaces line and middle.

    ``flank`` (m,) receives the returns beside or above and below the tube, whichever are more, out
    to three times its half-width, less those inside. A plane has twice as many.
    """
    slots, places = _room(made)
    wide = 3.0 * radius
    for s in range(len(tubes.length)):
        size = _in_tube(made, tubes, s, tubes.length[s], wide, wide, bend, slots, places)
        n, beside, above = 0, 0, 0
        sx = sy = sv = sxx = sxy = sxv = 0.0
        for k in range(size):
            x, y, v = places[0, k], places[1, k], places[2, k]
            if abs(y) > radius:
                beside += abs(v) <= radius
            elif abs(v) > radius:
                above += 1
            else:
                n += 1
                sx, sy, sv = sx + x, sy + y, sv + v
                sxx, sxy, sxv = sxx + x * x, sxy + x * y, sxv + x * v
        flank[s] = max(beside, above) - n
        if n < 2:
            continue
        long = n * sxx - sx * sx
        turn = rise = 0.0
        if long > 0.0:
            turn, rise = (n * sxy - sx * sy) / long, (n * sxv - sx * sv) / long
        aside = (sy - turn * sx) / n
        tubes.middle[s, 0] -= math.sin(tubes.azimuth[s]) * aside
        tubes.middle[s, 1] += math.cos(tubes.azimuth[s]) * aside
        tubes.middle[s, 2] += (sv - rise * sx) / n
        tubes.azimuth[s] += math.atan(turn)
        tubes.slope[s] += rise


@njit()
def agreeing(  # type: ignore[no-untyped-def]
    made, tubes, stretch, radius, beside, turn_max, bend, agree, against
):
    """Count the tubes that prolong each one, and those beside it that point the same way.

    ``made`` lists the tubes' middles, rounded. Tubes count as far as ``stretch`` half-lengths
    along, ``beside`` off the line, across and upwards, and turned by ``turn_max`` [rad; rise/run].
    ``agree`` (m,) receives agreeing tubes off its line, or beyond the own half-length: they share
    no return with it. ``against`` receives the tubes on its line that point elsewhere, less those
    that agree.
    """
    slots, places = _room(made)
    for s in range(len(tubes.length)):
        reach, wide = stretch * tubes.length[s], beside + ROUNDED
        east, north = math.cos(tubes.azimuth[s]), math.sin(tubes.azimuth[s])
        size = _in_tube(made, tubes, s, reach + ROUNDED, wide, wide, bend, slots, places)
        for k in range(size):
            t = made.points[3, slots[k]]
            dx, dy = (
                tubes.middle[t, 0] - tubes.middle[s, 0],
                tubes.middle[t, 1] - tubes.middle[s, 1],
            )
            x, y = dx * east + dy * north, dy * east - dx * north
            v = tubes.middle[t, 2] - tubes.middle[s, 2] - tubes.slope[s] * x - bend * x * x
            if t == s or abs(x) > reach or abs(y) > beside or abs(v) > beside:
                continue
            on_line = abs(y) <= radius and abs(v) <= radius
            apart = tubes.azimuth[t] - tubes.azimuth[s]
            turn = abs(apart) % math.pi
            rise = tubes.slope[t] if math.cos(apart) >= 0.0 else -tubes.slope[t]
            rise -= tubes.slope[s] + 2.0 * bend * x
            if min(turn, math.pi - turn) > turn_max or abs(rise) > turn_max:
                against[s] += on_line and abs(x) <= tubes.length[s]
            elif not on_line or abs(x) > tubes.length[s]:
                agree[s] += 1
            else:
                against[s] -= 1


@njit()
def vote(  # type: ignore[no-untyped-def]
    made: Columns, tubes: Tubes, radius: float, bend: float, votes
) -> None:
    """Count for every point the tubes that hold it: ``votes`` (n,) int32 by row."""
    slots, places = _room(made)
    for s in range(len(tubes.length)):
        reach = tubes.length[s]
        size = _in_tube(made, tubes, s, reach, radius, radius, bend, slots, places)
        for k in range(size):
            votes[made.points[3, slots[k]]] += 1


@njit()
def surroundings(made, tubes, rings, bend, count, held):  # type: ignore[no-untyped-def]
    """Count the returns within some distances d of each tube's line, ascending [quanta].

    ``count`` (m, k) receives those of ``|x| <= length`` by distance, ``held`` (m, PARTS), all
    False, which parts of the tube hold returns within the first.
    """
    slots, places = _room(made)
    for s in range(len(tubes.length)):
        reach = tubes.length[s]
        size = _in_tube(made, tubes, s, reach, rings[-1], rings[-1], bend, slots, places)
        for k in range(size):
            off = max(abs(places[1, k]), abs(places[2, k]))
            for ring in range(len(rings)):
                count[s, ring] += off <= rings[ring]
            if off <= rings[0]:
                part = np.int64((places[0, k] + reach) / (2.0 * reach) * PARTS)
                held[s, min(part, PARTS - 1)] = True
