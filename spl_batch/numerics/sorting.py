"""Sorting and bisection for kernels, as functions that compile quickly.

numba compiles its own ``sort`` and ``searchsorted`` anew for each type and for each
process: two seconds each, where these take some tenths. What kernels sort is short: the returns of
a cell, a column or a shot.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from spl_batch.numerics.compiled import njit


@njit()
def sort(values: NDArray[Any]) -> None:
    """Sort in place, in increasing order.

    Shell's method with gaps that grow by 9 / 4 (Tokuda 1992): short lists are moved little, and
    no list takes a time of its length squared.

    Parameters
    ----------
    values : (n,) int64 or float64, sorted
        Numbers; none is NaN.
    """
    n, gap = len(values), 1
    while gap < n:
        gap = gap * 9 // 4 + 1
    while gap > 1:
        gap = gap * 4 // 9
        for i in range(gap, n):
            taken, k = values[i], i
            while k >= gap and values[k - gap] > taken:
                values[k] = values[k - gap]
                k -= gap
            values[k] = taken


@njit()
def select(values: NDArray[np.float64], k: int) -> float:
    """Value that a sort would put at position ``k``; what is not larger ends up before it.

    ``values``: (n,) float64, finite; their order is changed. ``k``: position, 0 to n - 1.
    """
    low, high = 0, len(values) - 1
    while low < high:
        # A pivot from the middle of three stays off the quadratic case of sorted values.
        a, b, c = values[low], values[(low + high) // 2], values[high]
        pivot = max(min(a, b), min(max(a, b), c))
        i, j = low, high
        while i <= j:
            while values[i] < pivot:
                i += 1
            while values[j] > pivot:
                j -= 1
            if i <= j:
                values[i], values[j] = values[j], values[i]
                i += 1
                j -= 1
        if k <= j:
            high = j
        elif k >= i:
            low = i
        else:
            break
    return float(values[k])


@njit()
def first_above(values: NDArray[Any], sought: Any) -> int:
    """Position of the first value that is larger than another.

    Parameters
    ----------
    values : (n,) int64 or float64
        Numbers in increasing order.
    sought : int or float
        What they are compared with; NaN lies above all of them.

    Returns
    -------
    int
        0 to n; n where none is larger.
    """
    low, high = 0, len(values)
    while low < high:
        middle = (low + high) >> 1
        if sought < values[middle]:
            high = middle
        else:
            low = middle + 1
    return low
