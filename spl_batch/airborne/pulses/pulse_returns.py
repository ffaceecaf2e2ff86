"""The first and the last signal return of each pulse.

A pulse is what one beamlet sent at one time: its returns share ``gps_time`` and ``channel``. The
first of them is the highest one that is signal. Return numbers do not tell it where noise lies in
front of the surface.

Where nothing tells pulses apart (no time, a time that many share, no channels), a pulse has one
return of number 1, which counts as its first and its last one.
"""

from collections.abc import Callable, Iterable
from functools import partial
from typing import Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.lattice.row_order import lexicographic_order
from spl_batch.lattice.tables import PointTable, concat

COLUMNS_NEEDED: Final = ("x", "y", "z", "gps_time", "channel", "return_number")

_MIX: Final = np.uint64(0x9E37_79B9_7F4A_7C15)
"""Odd number that spreads the bits of a time (Knuth's multiplicative hashing)."""

MOST_RETURNS: Final = 15
"""Returns of a pulse that LAS can number [count]; more are no pulse's [LAS 1.4 R15, 2.7]."""


Ends = tuple[NDArray[np.bool_], NDArray[np.bool_]]
"""Which returns are the first of their pulse, and which the last: two (n,) bool."""


def ends_in_parts(tables: Callable[[], Iterable[PointTable]], shares: int) -> list[Ends]:
    """What :func:`pulse_ends` finds among returns that come table by table.

    The returns of a pulse may lie in several tables. They share a time and a beamlet: pulses are
    dealt out by these, and those of one share are looked at together.

    Parameters
    ----------
    tables : callable
        Gives the tables; it is called once for each share.
    shares : int
        Shares of about as many returns [count].

    Returns
    -------
    list of ((n,) bool, (n,) bool)
        First and last returns of each table.
    """
    ends: list[Ends] = []
    for share in range(shares):
        chosen = list(map(partial(_share, share, shares), tables()))
        if not ends:
            ends = [(np.zeros(n, np.bool_), np.zeros(n, np.bool_)) for n, _, _ in chosen]
        cuts = np.cumsum([len(rows) for _, rows, _ in chosen])[:-1]
        rows = [rows for _, rows, _ in chosen]
        table = concat([part for _, _, part in chosen], COLUMNS_NEEDED)
        del chosen
        for side, found in enumerate(pulse_ends(table)):
            for mask, mine, part in zip(ends, rows, np.split(found, cuts), strict=True):
                mask[side][mine] = part
    return ends


def _share(share: int, shares: int, table: PointTable) -> tuple[int, NDArray[np.intp], PointTable]:
    """Length of a table, and rows and values of the returns in a share of the pulses."""
    # 0.0 for -0.0: equal times have equal bits.
    key = (table["gps_time"] + 0.0).view(np.uint64) + table["channel"]
    rows = np.flatnonzero(((key * _MIX) >> np.uint64(32)) % np.uint64(shares) == share)
    return len(table), rows, table.select(COLUMNS_NEEDED).take(rows)


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
