"""Which whole numbers there are, by counting where they lie close together."""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

ROOM: Final = 1 << 16
"""Numbers that span no more than this are counted, however few they are [count]."""


def distinct(values: NDArray[Any]) -> tuple[NDArray[Any], NDArray[np.intp]]:
    """Different numbers, rising, and which of them each value is.

    ``numpy.unique`` gives the same and sorts for it.

    Parameters
    ----------
    values : (n,) array of integers
        Any numbers.

    Returns
    -------
    found : (k,) array of the same type
        The different ones.
    rank : (n,) intp
        Which of them each value is.
    """
    low = int(values.min()) if len(values) else 0
    span = int(values.max()) - low + 1 if len(values) else 0
    if span > max(ROOM, len(values)):
        found, rank = np.unique(values, return_inverse=True)
        return found, rank
    offset = values.astype(np.int64) - low
    held = np.zeros(span, np.bool_)
    held[offset] = True
    numbers: NDArray[np.int64] = np.flatnonzero(held) + low
    return numbers.astype(values.dtype), (np.cumsum(held) - 1)[offset]
