"""Dependent returns: no evidence of their own, and judged with the return that they follow.

Domain: space. An afterpulse follows *any* detection, noise too: it makes two returns where the null
hypothesis of [W18] Eq. 6-8 expects one, and pairs of pairs pass the test. So a follower that is an
afterpulse with a probability of :data:`DEPENDENT_MIN` or more does not count as a neighbour, and
shares the label of the return in front of it in its beamlet.

Deviation: the sources count every return.

Labels that a return takes over from the one in front of it in its own beamlet.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.constants import NOISE_AFTERPULSE, NOISE_BACKGROUND, NOISE_NOT_ASSESSED
from spl_batch.lattice.tables import PointTable
from spl_batch.lattice.tiles import quanta
from spl_batch.numerics.compiled import njit


@njit()
def inherit(
    order: NDArray[np.int64],
    same: NDArray[np.bool_],
    z: NDArray[np.int32],
    dependent: NDArray[np.bool_],
    lag: int,
    label: NDArray[np.uint8],
    unknown: int,
) -> None:
    """Give each dependent return the label of the one in front of it, in place.

    Parameters
    ----------
    order : (n,) int64
        Rows by beamlet, within a beamlet from the highest return down.
    same : (n,) bool
        Whether ``order[i]`` is of the same beamlet as ``order[i - 1]``; ``same[0]`` is False.
    z : (n,) int32
        Heights by row [quanta].
    dependent : (n,) bool
        Rows that take over; they may follow one another.
    lag : int
        Farthest that the one in front may be above [quanta].
    label : (n,) uint8
        Labels by row; those of dependent rows are set where there is one to take over.
    unknown : int
        Label that is not taken over.
    """
    for i in range(1, len(order)):
        row, front = order[i], order[i - 1]
        if dependent[row] and same[i] and z[front] - z[row] <= lag and label[front] != unknown:
            label[row] = label[front]


MIXER = np.uint64(0x9E37_79B9_7F4A_7C15)
"""Odd number whose products spread over all bits: 2**64 over the golden ratio."""


def may_share(
    first: NDArray[np.uint64], second: NDArray[np.uint8], chosen: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Rows that may share both keys with a chosen one: all that do, and a few others.

    Parameters
    ----------
    first : (n,) uint64
    second : (n,) uint8
        The keys.
    chosen : (n,) bool
        Rows looked for.

    Returns
    -------
    (n,) bool
        True wherever both keys equal those of a chosen row; of other rows 1 in 32 or fewer.
    """
    bits = max(int(np.count_nonzero(chosen)) * 64, 64).bit_length()
    seen = np.zeros(1 << bits, np.bool_)
    out = np.empty(len(first), np.bool_)
    _share(first, second, chosen, np.uint64(64 - bits), seen, out)
    return out


@njit()
def _share(first, second, chosen, shift, seen, out):  # type: ignore[no-untyped-def]
    for i in range(len(first)):
        if chosen[i]:
            seen[((first[i] * MIXER + np.uint64(second[i])) * MIXER) >> shift] = True
    for i in range(len(first)):
        out[i] = seen[((first[i] * MIXER + np.uint64(second[i])) * MIXER) >> shift]


DOMAIN: Final = "space"

DEPENDENT_MIN: Final = 0.3
"""Afterpulse probability from which a return is no evidence of its own."""

LAG_M: Final = 5.0
"""Farthest parent [m]; [W17] 7.2 finds afterpulses within 2-3 m of it."""


def dependents(table: PointTable) -> NDArray[np.bool_]:
    """Returns that are no evidence of their own: (n,) bool."""
    if "afterpulse" not in table:
        return np.zeros(len(table), np.bool_)
    found: NDArray[np.bool_] = table["afterpulse"] >= DEPENDENT_MIN
    return found


def families(table: PointTable, chosen: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Returns of the beamlets that some points lie on, and a few others: (n,) bool.

    Parameters
    ----------
    table : PointTable
        Points with ``gps_time, channel``.
    chosen : (n,) bool
        The points; their own beamlets are among those found.
    """
    # 0.0 for -0.0: equal times have equal bits.
    return may_share((table["gps_time"] + 0.0).view(np.uint64), table["channel"], chosen)


def follow(
    table: PointTable, dependent: NDArray[np.bool_], label: NDArray[np.uint8]
) -> NDArray[np.uint8]:
    """Labels with those of dependent returns taken over from the returns in front of them.

    Parameters
    ----------
    table : PointTable
        Points with ``gps_time, channel, z`` in canonical order: whole :func:`families`.
    dependent : (n,) bool
        Returns whose own label does not count.
    label : (n,) uint8
        ``noise_class``; "not assessed" where it is not known.

    Returns
    -------
    (n,) uint8
        A follower of noise is an afterpulse. One whose parent is not known keeps its label.
    """
    if not dependent.any():
        return label
    time, channel = table["gps_time"], table["channel"]
    order = np.lexsort((-table["z"].astype(np.int64), channel, time))
    same = np.zeros(len(order), np.bool_)
    same[1:] = (np.diff(time[order]) == 0) & (np.diff(channel[order].astype(np.int16)) == 0)
    out = label.copy()
    inherit(order, same, table["z"], dependent, quanta(LAG_M), out, NOISE_NOT_ASSESSED)
    out[dependent & (out == NOISE_BACKGROUND)] = NOISE_AFTERPULSE
    return out
