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

from spl_batch.airborne.beams.shot_runs import Beamlets
from spl_batch.constants import NOISE_AFTERPULSE, NOISE_BACKGROUND, NOISE_NOT_ASSESSED
from spl_batch.lattice.tables import PointTable
from spl_batch.lattice.tiles import quanta
from spl_batch.numerics.compiled import njit

DEPENDENT_MIN: Final = 0.3
"""Afterpulse probability from which a return is no evidence of its own. Half and twice move 43 + 38
and 18 + 64 labels."""

LAG_M: Final = 5.0
"""Farthest parent [m]; [W17] 7.2 finds afterpulses within 2-3 m of it."""


def dependents(table: PointTable) -> NDArray[np.bool_]:
    """Returns that are no evidence of their own: (n,) bool."""
    if "afterpulse" not in table:
        return np.zeros(len(table), np.bool_)
    found: NDArray[np.bool_] = table["afterpulse"] >= DEPENDENT_MIN
    return found


def follow(
    table: PointTable,
    beamlets: Beamlets,
    usable: NDArray[np.bool_],
    dependent: NDArray[np.bool_],
    label: NDArray[np.uint8],
) -> NDArray[np.uint8]:
    """Labels with those of dependent returns taken over from the returns in front of them.

    Parameters
    ----------
    table : PointTable
        Points with ``z`` in canonical order.
    beamlets : Beamlets
        Theirs; a return is judged where its beamlet is whole.
    usable : (n,) bool
        Others are in front of none.
    dependent : (n,) bool
        Returns whose own label does not count, usable.
    label : (n,) uint8
        ``noise_class``; "not assessed" where it is not known.

    Returns
    -------
    (n,) uint8
        A follower of noise is an afterpulse. One whose parent is not known keeps its label.
    """
    if not dependent.any():
        return label
    out = label.copy()
    inherit(*beamlets, usable, table["z"], dependent, quanta(LAG_M), out, NOISE_NOT_ASSESSED)
    out[dependent & (out == NOISE_BACKGROUND)] = NOISE_AFTERPULSE
    return out


@njit()
def inherit(
    order: NDArray[np.int32],
    start: NDArray[np.int32],
    usable: NDArray[np.bool_],
    z: NDArray[np.int32],
    dependent: NDArray[np.bool_],
    lag: int,
    label: NDArray[np.uint8],
    unknown: int,
) -> None:
    """Give each dependent return (n,) the label of the one in front of it, in place.

    ``order, start``: :class:`~spl_batch.airborne.beams.shot_runs.Beamlets`. The one in front is the
    next usable one up, at most ``lag`` above [quanta], and its label is not ``unknown``.
    """
    down = np.empty(len(order), np.int32)
    for b in range(len(start) - 1):
        any_dependent, size = False, 0
        for place in range(start[b], start[b + 1]):
            any_dependent |= dependent[order[place]]
        if not any_dependent or start[b + 1] - start[b] < 2:
            continue
        for place in range(start[b], start[b + 1]):
            row, at = order[place], size
            if not usable[row]:
                continue
            while at > 0 and z[down[at - 1]] < z[row]:
                down[at] = down[at - 1]
                at -= 1
            down[at] = row
            size += 1
        for k in range(1, size):
            row, front = down[k], down[k - 1]
            if dependent[row] and z[front] - z[row] <= lag and label[front] != unknown:
                label[row] = label[front]
