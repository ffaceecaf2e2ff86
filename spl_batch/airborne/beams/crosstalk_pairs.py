"""Kernel of :mod:`~spl_batch.airborne.beams.crosstalk`: returns of one shot at one range."""

from spl_batch.numerics.compiled import njit
from spl_batch.numerics.sorting import order_of

WINDOW_M = 2.0
"""Depth in which most returns of a shot are sought [m]."""


@njit()
def count_pairs(starts, range_m, direction, row, far_m, same_m, apart, counts):  # type: ignore[no-untyped-def]
    """Add returns far from the fullest window of their shots, and their pairs, to rows of counts.

    ``row`` is that of each shot. ``apart`` are squares of three angles: least and most between
    beamlets side by side, and most between those farther apart.
    """
    for s in range(len(starts) - 1):
        first, stop = starts[s], starts[s + 1]
        near = range_m[first:stop]
        order = order_of(near)
        low, high = _surface(near, order)
        for a in range(len(order)):
            i = order[a]
            if low - far_m <= near[i] <= high + far_m:
                continue
            counts[row[s], 0] += 1
            for b in range(a + 1, len(order)):
                j = order[b]
                if near[j] - near[i] > same_m:
                    break
                if low - far_m <= near[j] <= high + far_m:
                    continue
                angle = 0.0
                for axis in range(3):
                    angle += (direction[first + i, axis] - direction[first + j, axis]) ** 2
                if apart[0] <= angle <= apart[1]:
                    counts[row[s], 1] += 1
                elif apart[1] < angle <= apart[2]:
                    counts[row[s], 2] += 1


@njit()
def _surface(range_m, order):  # type: ignore[no-untyped-def]
    """First and last return of the window that holds most of a shot [m]."""
    begin, most, low, high = 0, 0, range_m[order[0]], range_m[order[0]]
    for k in range(len(order)):
        while range_m[order[k]] - range_m[order[begin]] > WINDOW_M:
            begin += 1
        if k + 1 - begin > most:
            most, low, high = k + 1 - begin, range_m[order[begin]], range_m[order[k]]
    return low, high
