"""Runs of equal shots and beamlets in a table that is in time order.

A shot is the run of rows with one ``gps_time``, a beamlet that with one ``gps_time`` and channel.
Shot *numbers* do not count: two shots share one where times jitter.
"""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.lattice.row_order import lexicographic_order
from spl_batch.lattice.tables import PointTable
from spl_batch.numerics.compiled import njit


def run_starts(*keys: NDArray[np.generic]) -> NDArray[np.int64]:
    """First row of each run of equal keys.

    Parameters
    ----------
    *keys : (n,) arrays
        Keys; a run ends where any of them changes.

    Returns
    -------
    (m + 1,) int64
        Starts of the m runs, then n; ``[0]`` for no rows.
    """
    n = len(keys[0])
    if n == 0:
        return np.zeros(1, dtype=np.int64)
    change: NDArray[np.bool_] = keys[0][1:] != keys[0][:-1]
    for key in keys[1:]:
        change |= key[1:] != key[:-1]
    inner = np.flatnonzero(change)
    starts = np.empty(len(inner) + 2, dtype=np.int64)
    starts[0], starts[-1] = 0, n
    np.add(inner, 1, out=starts[1:-1])
    return starts


class Beamlets(NamedTuple):
    """Returns of a table in any order by beamlet."""

    order: NDArray[np.int32]  #: (n,): rows, beamlet after beamlet, ascending within each.
    start: NDArray[np.int32]  #: (m + 1,): where beamlets start in ``order``, then n.


NO_BEAMLETS: Final = Beamlets(np.empty(0, np.int32), np.zeros(1, np.int32))
"""Those of an empty table."""


def beamlets_of(table: PointTable) -> Beamlets:
    """Beamlets of a table with ``gps_time, channel``."""
    time, channel = table["gps_time"], table["channel"]
    order = lexicographic_order((time, channel)).astype(np.int32)
    return Beamlets(order, run_starts(time[order], channel[order]).astype(np.int32))


@njit()
def lag_behind(
    starts: NDArray[np.int64],
    range_m: NDArray[np.float64],
    dead_m: float,
    reach_m: float,
    lag_m: NDArray[np.float32],
) -> None:
    """Distance of each return behind the nearest earlier return of its beamlet.

    Parameters
    ----------
    starts : (m + 1,) int64
        Rows where beamlets start, then n.
    range_m : (n,) float64
        Slant ranges [m], in any order within a beamlet.
    dead_m : float
        No return can follow another closer than this; such ones are not parents [m].
    lag_m : (n,) float32
        Filled with the lag [m]; 0 where no return of the beamlet lies within
        ``[dead_m, reach_m]`` in front.
    """
    for b in range(len(starts) - 1):
        first, last = starts[b], starts[b + 1]
        for i in range(first, last):
            best = 0.0
            for j in range(first, last):
                lag = range_m[i] - range_m[j]
                if lag > 0.0 and dead_m <= lag <= reach_m and (best == 0.0 or lag < best):
                    best = lag
            lag_m[i] = best


@njit()
def blind_behind(
    starts: NDArray[np.int64],
    range_m: NDArray[np.float64],
    reach_m: float,
    blind_m: NDArray[np.float64],
) -> None:
    """Length behind each return, up to a reach, as far as no other return has taken it.

    The lengths of a beamlet add up to that of everything within reach behind a return.

    Parameters
    ----------
    starts : (m + 1,) int64
        Rows where beamlets start, then n.
    range_m : (n,) float64
        Slant ranges [m], in any order within a beamlet.
    blind_m : (n,) float64
        Filled [m].
    """
    for b in range(len(starts) - 1):
        first, last = starts[b], starts[b + 1]
        for i in range(first, last):
            gap = reach_m
            for j in range(first, last):
                ahead = range_m[j] - range_m[i]
                if 0.0 < ahead < gap or (ahead == 0.0 and j > i):
                    gap = ahead
            blind_m[i] = gap


def interval_rows(
    shot: NDArray[np.int64], length: int, interval: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Row of the interval that each shot lies in, or of the nearest one before it.

    Parameters
    ----------
    shot : (n,) int64
        Shot numbers, in any order; quick where neighbours are of one shot.
    interval : (m,) int64
        Numbers of the intervals, increasing.

    Returns
    -------
    (n,) int64
        0 for what lies before all of them.
    """
    start = run_starts(shot)
    row = np.searchsorted(interval, shot[start[:-1]] // length, side="right") - 1
    return np.repeat(np.maximum(row, 0), np.diff(start))


def share_out(
    shot: NDArray[np.int64],
    time: NDArray[np.float64],
    window_shots: int,
    interval_shots: int,
    row: NDArray[np.int64],
    first: NDArray[np.int64],
    last: NDArray[np.int64],
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Shots fired and beamlets seen in the window of each seen beamlet.

    Parameters
    ----------
    shot : (n,) int64
        Shot of each beamlet, in time order.
    time : (n,) float64
        Times [s]; two shots may share a number where the times jitter.
    window_shots, interval_shots : int
        Shots of a window, and of an interval, which windows divide.
    row : (n,) int64
        From :func:`interval_rows`.
    first, last : (m,) int64
        First and last shot that was fired of each interval, from its beginning.

    Returns
    -------
    fired, seen : (n,) int64
        Shots and beamlets [count].
    """
    window = shot // window_shots
    starts = run_starts(window)
    begin, seen = starts[:-1], np.diff(starts)
    if not len(begin):
        return seen, seen
    changes = np.ones(len(shot), np.int64)
    changes[1:] = time[1:] != time[:-1]
    # The first beamlet of a window is of a shot, whenever the one before it was fired.
    changes[begin] = 1
    start = window[begin] * window_shots - shot[begin] // interval_shots * interval_shots
    low = np.maximum(start, first[row[begin]])
    high = np.minimum(start + window_shots - 1, last[row[begin]])
    # No fewer were fired than are seen.
    fired = np.maximum(high - low + 1, np.add.reduceat(changes, begin))
    return np.repeat(fired, seen), np.repeat(seen, seen)
