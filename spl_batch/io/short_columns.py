"""Columns of one byte that share columns of four.

Parquet has no numbers of one byte: each is stored as one of four, byte by byte, three of which
are zero. Up to four of them side by side take no more room, and are written and read four times
as fast. The shared column's name joins theirs.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import DTypeLike, NDArray

_AND: Final = "+"
_BYTES: Final = 4


def shared(dtypes: Mapping[str, DTypeLike]) -> dict[str, DTypeLike]:
    """Columns of a file in which those of one byte share columns.

    Parameters
    ----------
    dtypes : mapping of str to dtype
        Columns of a table.
    """
    short = [name for name, dtype in dtypes.items() if np.dtype(dtype) == np.uint8]
    groups = [short[k : k + _BYTES] for k in range(0, len(short), _BYTES)]
    kept = {name: dtype for name, dtype in dtypes.items() if name not in short}
    return kept | {_AND.join(g): np.uint32 if len(g) > 1 else np.uint8 for g in groups}


def joined(columns: Mapping[str, NDArray[Any]], name: str) -> NDArray[Any]:
    """A column of the file.

    Parameters
    ----------
    columns : mapping of str to (n,) ndarray
        Columns of the table.
    name : str
        One of :func:`shared`.
    """
    if _AND not in name:
        return columns[name]
    names = name.split(_AND)
    side_by_side = np.zeros((len(columns[names[0]]), _BYTES), np.uint8)
    for at, one in enumerate(names):
        side_by_side[:, at] = columns[one]
    return side_by_side.view("<u4")[:, 0]


def holders(stored: Sequence[str]) -> dict[str, tuple[str, int]]:
    """Column of the file that holds each column of a table, and its place in there; -1 for all.

    Parameters
    ----------
    stored : sequence of str
        Columns of the file.
    """
    return {
        one: (whole, at if _AND in whole else -1)
        for whole in stored
        for at, one in enumerate(whole.split(_AND))
    }


def taken(values: NDArray[Any], at: int) -> NDArray[Any]:
    """A column of a table.

    Parameters
    ----------
    values : (n,) ndarray
        The column of the file.
    at : int
        From :func:`holders`.
    """
    if at < 0:
        return values
    side_by_side = values.astype("<u4", copy=False).view(np.uint8).reshape(-1, _BYTES)
    one: NDArray[np.uint8] = np.ascontiguousarray(side_by_side[:, at])
    one.setflags(write=False)  # as is whatever else was read
    return one
