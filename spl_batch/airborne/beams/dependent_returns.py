"""Dependent returns: no evidence of their own, and judged with the return that they follow.

Domain: space. An afterpulse follows *any* detection, noise too: it makes two returns where the null
hypothesis of [W18] Eq. 6-8 expects one, and pairs of pairs pass the test. So a follower that is an
afterpulse with a probability of :data:`DEPENDENT_MIN` or more does not count as a neighbour, and
shares the label of the return in front of it in its beamlet.

Deviation: the sources count every return.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.constants import NOISE_AFTERPULSE, NOISE_BACKGROUND, NOISE_NOT_ASSESSED
from spl_batch.lattice.tables import PointTable
from spl_batch.lattice.tiles import quanta
from spl_batch.numerics.compiled import njit

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
    """Returns of the beamlets that some points lie on: (n,) bool.

    Parameters
    ----------
    table : PointTable
        Points with ``gps_time, channel``.
    chosen : (n,) bool
        The points.
    """
    time = table["gps_time"]
    times = np.unique(time[chosen])
    if not len(times):
        return np.zeros(len(table), np.bool_)
    shot = np.minimum(np.searchsorted(times, time), len(times) - 1)
    out: NDArray[np.bool_] = times[shot] == time
    beamlet = shot * 256 + table["channel"]
    out[out] = np.isin(beamlet[out], beamlet[chosen])
    return out


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
    """Give each dependent return (n,) the label of the one in front of it, in place.

    ``order`` (n,) has the rows by beamlet, from the highest return down; ``same`` (n,) says whether
    one is of the same beamlet as that before it. The one in front is at most ``lag`` above
    [quanta], and its label is not ``unknown``.
    """
    for i in range(1, len(order)):
        row, front = order[i], order[i - 1]
        if dependent[row] and same[i] and z[front] - z[row] <= lag and label[front] != unknown:
            label[row] = label[front]


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
