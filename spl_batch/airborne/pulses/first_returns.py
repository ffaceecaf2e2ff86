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

COLUMNS_NEEDED: Final = ("x", "y", "z", "gps_time", "channel", "return_number")

_PULSE: Final = ("gps_time", "channel")
"""Columns that a pulse's returns share."""

_BY_HEIGHT: Final = ("z", "x", "y", "return_number")
"""Columns whose last row, in their order, is a pulse's highest return."""

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
    first[order[start[known & (count == 1)]]] = True
    # The highest of several is the last in order of height; of equals, of these columns.
    several = known & (count > 1)
    rows, of_each = order[np.repeat(several, count)], count[several]
    pulse = np.repeat(np.arange(len(of_each)), of_each)
    by = lexicographic_order([pulse, *(table[name][rows] for name in _BY_HEIGHT)])
    first[rows[by[np.cumsum(of_each) - 1]]] = True
    apart = order[np.repeat(~known, count)]
    first[apart[table["return_number"][apart] <= 1]] = True
    return first
