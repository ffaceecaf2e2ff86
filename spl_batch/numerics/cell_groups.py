"""Points grouped by the cells of a grid."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_array, get_index_dtype


class Cells(NamedTuple):
    """Points grouped by the cells of a grid, row by row."""

    order: NDArray[np.int64]  #: (n,): points, cell after cell.
    start: NDArray[np.int64]  #: (rows * columns + 1,): where each cell begins in ``order``.
    rows: int
    columns: int


def group_by_cell(x: NDArray[np.float64], y: NDArray[np.float64], cell_m: float) -> Cells:
    """Group points by the cells of a grid whose lines are multiples of its cell size.

    Parameters
    ----------
    x, y : (n,) float64
        Places [m]; n > 0.
    cell_m : float
        Edge of a cell [m], > 0.
    """
    left, right, bottom, top = (
        int(np.floor(end / cell_m)) for v in (x, y) for end in (v.min(), v.max())
    )
    columns, rows = right - left + 1, top - bottom + 1
    index = get_index_dtype(maxval=max(rows * columns, len(x)))
    column, row = (
        (np.floor(v / cell_m) - first).astype(index) for v, first in ((x, left), (y, bottom))
    )
    cell = row * index(columns) + column
    # A matrix with one entry in each column is put in the order of its rows by counting.
    entries = np.ones(len(x), np.bool_), cell, np.arange(len(x) + 1, dtype=index)
    grouped = csc_array(entries, shape=(rows * columns, len(x))).tocsr()
    order, start = (part.astype(np.int64) for part in (grouped.indices, grouped.indptr))
    return Cells(order, start, rows, columns)
