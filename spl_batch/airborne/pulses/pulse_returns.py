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

COLUMNS_NEEDED: Final = ("x", "y", "z", "gps_time", "channel", "return_number")

MOST_RETURNS: Final = 15
"""Returns of a pulse that LAS can number [count]; more are no pulse's [LAS 1.4 R15, 2.7]."""


def pulse_ends(table: PointTable) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
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
    keys = [table[name] for name in ("gps_time", "channel", "z", "x", "y", "return_number")]
    order = lexicographic_order(keys)
    time, channel = (key[order] for key in keys[:2])
    opens = np.ones(n, np.bool_)
    # NaN differs from itself: each return without a time is one by itself.
    opens[1:] = (time[1:] != time[:-1]) | (channel[1:] != channel[:-1])
    start = np.flatnonzero(opens)
    count = np.diff(start, append=n)
    known = (count <= MOST_RETURNS) & np.isfinite(time[start])
    last[order[start[known]]] = True
    first[order[(start + count - 1)[known]]] = True
    untold = order[np.repeat(~known, count)]
    only = untold[table["return_number"][untold] <= 1]
    first[only] = last[only] = True
    return first, last
