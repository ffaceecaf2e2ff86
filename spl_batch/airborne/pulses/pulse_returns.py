"""The first and the last signal return of each pulse.

A pulse is what one beamlet sent at one time: its returns share ``gps_time`` and ``channel``. The
first of them is the highest one that is signal. Return numbers do not tell it where noise lies in
front of the surface.

Where nothing tells pulses apart (no time, a time that many share, no channels), a pulse has one
return of number 1, which counts as its first and its last one.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.lattice.row_order import lexicographic_order
from spl_batch.lattice.tables import PointTable
from spl_batch.numerics.compiled import njit


@njit()
def mark_ends(order, start, count, z, x, y, number, first, last):  # type: ignore[no-untyped-def]
    """Mark the highest return of each pulse as its first, the lowest as its last.

    Of returns as high the easting decides, then the northing, then the return number, then the row.

    Parameters
    ----------
    order : (n,) int64
        Rows, those of a pulse together and rising.
    start, count : (p,) int64
        Where each pulse begins in ``order``, and its returns.
    z, x, y, number : (n,) integer
        Of each row.
    first, last : (n,) bool
        Set at the rows that are.
    """
    for k in range(len(start)):
        low = high = order[start[k]]
        for at in range(start[k] + 1, start[k] + count[k]):
            row = order[at]
            own = z[row], x[row], y[row], number[row]
            if own < (z[low], x[low], y[low], number[low]):
                low = row
            if own >= (z[high], x[high], y[high], number[high]):
                high = row
        first[high], last[low] = True, True


COLUMNS_NEEDED: Final = ("x", "y", "z", "gps_time", "channel", "return_number")

_PULSE: Final = ("gps_time", "channel")
"""Columns that a pulse's returns share."""

MOST_RETURNS: Final = 15
"""Returns of a pulse that LAS can number [count]; more are no pulse's [LAS 1.4 R15, 2.7]."""


Ends = tuple[NDArray[np.bool_], NDArray[np.bool_]]
"""Which returns are the first of their pulse, and which the last: two (n,) bool."""


def pulse_ends(table: PointTable) -> Ends:
    """Which returns are the first of their pulse, and which the last.

    Parameters
    ----------
    table : PointTable
        Signal in any order, with :data:`COLUMNS_NEEDED`.

    Returns
    -------
    first, last : (n,) bool
        As many are first as are last.
    """
    n = len(table)
    first, last = np.zeros((2, n), np.bool_)
    if not n:
        return first, last
    order = lexicographic_order([table[name] for name in _PULSE])
    time, channel = (table[name].take(order) for name in _PULSE)
    opens = np.ones(n, np.bool_)
    # NaN differs from itself: each return without a time is one by itself.
    opens[1:] = (time[1:] != time[:-1]) | (channel[1:] != channel[:-1])
    start = np.flatnonzero(opens)
    count = np.diff(start, append=n)
    known = (count <= MOST_RETURNS) & np.isfinite(time[start])
    z, x, y, number = (table[name] for name in ("z", "x", "y", "return_number"))
    mark_ends(order, start[known], count[known], z, x, y, number, first, last)
    untold = order[np.repeat(~known, count)]
    only = untold[table["return_number"][untold] <= 1]
    first[only] = last[only] = True
    return first, last
