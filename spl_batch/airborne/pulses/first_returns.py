"""The first signal return of each pulse.

A pulse is what one beamlet sent at one time: its returns share ``gps_time`` and ``channel``. The
first of them is the highest one that is signal. Return numbers do not show it where noise lies in
front of the surface.

Where nothing separates pulses (no time, a time that many share, no channels), returns of number 1
are first.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.lattice.row_order import lexicographic_order
from spl_batch.lattice.tables import PointTable
from spl_batch.numerics.compiled import njit

COLUMNS_NEEDED: Final = ("x", "y", "z", "gps_time", "channel", "return_number")

_PULSE: Final = ("gps_time", "channel")
"""Columns that a pulse's returns share."""

MOST_RETURNS: Final = 15
"""Returns of a pulse that LAS can number [count]; more are no pulse's [LAS 1.4 R15, 2.7]."""


def first_returns(table: PointTable) -> NDArray[np.bool_]:
    """Which returns are the first of their pulse: (n,) bool.

    Parameters
    ----------
    table : PointTable
        Signal in any order, with :data:`COLUMNS_NEEDED`.
    """
    n = len(table)
    first = np.zeros(n, np.bool_)
    if not n:
        return first
    order = lexicographic_order([table[name] for name in _PULSE])
    time, channel = (table[name].take(order) for name in _PULSE)
    opens = np.ones(n, np.bool_)
    # NaN differs from itself: each return without a time is one by itself.
    opens[1:] = (time[1:] != time[:-1]) | (channel[1:] != channel[:-1])
    start = np.flatnonzero(opens)
    count = np.diff(start, append=n)
    known = (count <= MOST_RETURNS) & np.isfinite(time[start])
    z, x, y, number = (table[name] for name in ("z", "x", "y", "return_number"))
    _mark_highest(order, start[known], count[known], z, x, y, number, first)
    apart = order[np.repeat(~known, count)]
    first[apart[table["return_number"][apart] <= 1]] = True
    return first


@njit()
def _mark_highest(order, start, count, z, x, y, number, first):  # type: ignore[no-untyped-def]
    """Mark the highest return of each pulse; ``start``, ``count``: its place in ``order``."""
    for k in range(len(start)):
        high = order[start[k]]
        for at in range(start[k] + 1, start[k] + count[k]):
            row = order[at]
            own = z[row], x[row], y[row], number[row]
            if own >= (z[high], x[high], y[high], number[high]):
                high = row
        first[high] = True
