"""Labels that a return takes over from the one in front of it in its own beamlet."""

import numpy as np
from numpy.typing import NDArray

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
