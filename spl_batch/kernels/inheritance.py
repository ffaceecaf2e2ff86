"""Labels that a return takes over from the one in front of it in its own beamlet."""

import numpy as np
from numba import njit
from numpy.typing import NDArray


@njit(nogil=True, cache=True)
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
