"""The first and the last signal return of each pulse.

A pulse is what one beamlet sent at one time: its returns share ``gps_time`` and ``channel``. The
first of them is the highest one that is signal. Return numbers do not tell it where noise lies in
front of the surface.

Where nothing tells pulses apart (no time, a time that many share, no channels), a pulse has one
return of number 1, which counts as its first and its last one.

Kernel of :mod:`~spl_batch.airborne.pulses.pulse_returns`: the ends of each pulse.
"""

from collections.abc import Callable, Iterable
from functools import partial
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.lattice.row_order import lexicographic_order
from spl_batch.lattice.tables import PointTable, concat
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

_SLOTS: Final = 2**16, 2**24
"""Fewest and most counts of returns by time and beamlet, of which crowds stand out [count]."""

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
        crowds: list[NDArray[np.complex128]] = []
        chosen = list(map(partial(_share, share, shares, crowds), tables()))
        if not ends:
            ends = [(np.zeros_like(some.alone), np.zeros_like(some.alone)) for some in chosen]
        for masks, dealt in zip(ends, chosen, strict=True):
            for mask in masks:
                mask[dealt.alone] = True
        if crowds:
            crowded = np.concatenate(crowds)
            chosen = [_apart(*some, crowded) for some in zip(ends, chosen, strict=True)]
        rows = [dealt.rows for dealt in chosen]
        cuts = np.cumsum(list(map(len, rows)))[:-1]
        table = concat([dealt.returns for dealt in chosen], COLUMNS_NEEDED)
        del chosen
        for side, found in enumerate(pulse_ends(table)):
            for masks, mine, part in zip(ends, rows, np.split(found, cuts), strict=True):
                masks[side][mine] = part
    return ends


class _Dealt(NamedTuple):
    """Returns of a table in a share of the pulses."""

    alone: NDArray[
        np.bool_
    ]  #: (n,): returns of the table that are told, and are pulses' only ones.
    rows: NDArray[np.intp]  #: (k,): which returns are still to be told.
    returns: PointTable  #: Those.


def _share(
    share: int, shares: int, crowds: list[NDArray[np.complex128]], table: PointTable
) -> _Dealt:
    """Returns of a table in a share of the pulses; adds to the crowds.

    Where more returns of a table have one time and beamlet than a pulse can have, each is told by
    itself and none is held: otherwise all that a coarse clock gives one time lie in one share.
    """
    timed = np.isfinite(table["gps_time"])
    only = table["return_number"] <= 1
    alone = ~timed & only
    # 0.0 for -0.0: equal times have equal bits.
    mixed = (table["gps_time"] + 0.0).view(np.uint64)
    mixed += table["channel"]
    mixed *= _MIX
    mixed >>= np.uint64(32)
    rows = np.flatnonzero(timed & (mixed % np.uint64(shares) == share))
    # With a slot for each return few slots but those of crowds are full.
    slots = min(max(1 << len(rows).bit_length(), _SLOTS[0]), _SLOTS[1])
    slot = (mixed[rows] // np.uint64(shares) % np.uint64(slots)).astype(np.uint32)
    del mixed
    full = np.bincount(slot, minlength=slots) > MOST_RETURNS
    some = rows[full[slot]]
    del slot
    pulse, place, count = np.unique(
        _pulse(table.select(_PULSE).take(some)), return_inverse=True, return_counts=True
    )
    crowded = count > MOST_RETURNS
    if crowded.any():
        crowds.append(pulse[crowded])
        crowd = some[crowded[place]]
        alone[crowd] = only[crowd]
        rows = np.setdiff1d(rows, crowd, assume_unique=True)
    return _Dealt(alone, rows, table.select(COLUMNS_NEEDED).take(rows))


def _apart(ends: Ends, dealt: _Dealt, crowds: NDArray[np.complex128]) -> _Dealt:
    """What is left where crowds of other tables are told, each return by itself."""
    crowd = np.isin(_pulse(dealt.returns), crowds)
    for mask in ends:
        mask[dealt.rows[crowd]] = dealt.returns["return_number"][crowd] <= 1
    return dealt._replace(rows=dealt.rows[~crowd], returns=dealt.returns.take(~crowd))


def _pulse(table: PointTable) -> NDArray[np.complex128]:
    """Time and beamlet of each return as one number."""
    found: NDArray[np.complex128] = table["gps_time"] + 1j * table["channel"]
    return found


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
