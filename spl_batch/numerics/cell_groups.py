"""Points grouped by the cells of a grid."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.numerics.compiled import njit


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
    order = np.empty(len(x), dtype=np.int64)
    start = np.zeros(rows * columns + 1, dtype=np.int64)
    _group(x, y, float(cell_m), (left, bottom, columns), start, order)
    return Cells(order, start, rows, columns)


@njit()
def _group(
    x: NDArray[np.float64], y: NDArray[np.float64], cell_m: float, grid: tuple[int, int, int],
    start: NDArray[np.int64], order: NDArray[np.int64],
) -> None:  # fmt: skip
    """Stable grouping; fills ``start`` and ``order``. Grid: first column, first row, columns."""
    left, bottom, columns = grid
    cell = np.empty(len(x), np.int64)
    for i in range(len(x)):
        column, row = np.floor(x[i] / cell_m), np.floor(y[i] / cell_m)
        cell[i] = (np.int64(row) - bottom) * columns + np.int64(column) - left
    for i in range(len(cell)):
        start[cell[i] + 1] += 1
    for c in range(len(start) - 1):
        start[c + 1] += start[c]
    cursor = np.empty(len(start) - 1, np.int64)
    for c in range(len(cursor)):
        cursor[c] = start[c]
    for i in range(len(cell)):
        order[cursor[cell[i]]] = i
        cursor[cell[i]] += 1
