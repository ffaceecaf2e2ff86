"""Squares of an absolute grid over a region: which of them belong to it, hold something, count."""

import numpy as np
from numpy.typing import NDArray

from spl_batch.lattice.tiles import Bounds


def owned(core: Bounds, edge: int) -> Bounds:
    """Columns and rows of the squares whose centres lie in a region; each has one owner."""
    return Bounds(*(-(-(side - edge // 2) // edge) for side in core))


def shape(squares: Bounds) -> tuple[int, int]:
    """Rows and columns of some squares."""
    return squares.ymax - squares.ymin, squares.xmax - squares.xmin


def held(
    x: NDArray[np.int64], y: NDArray[np.int64], squares: Bounds, edge: int
) -> NDArray[np.bool_]:
    """Which squares hold a place, row 0 southernmost: (rows, columns) bool."""
    found = np.zeros(shape(squares), np.bool_)
    row, column = y // edge - squares.ymin, x // edge - squares.xmin
    there = (row >= 0) & (row < found.shape[0]) & (column >= 0) & (column < found.shape[1])
    found[row[there], column[there]] = True
    return found


def at_centres(
    cells: NDArray[np.bool_], core: Bounds, squares: Bounds, edge: int
) -> NDArray[np.bool_]:
    """What cells that make up a region hold at the centres of the squares that it owns."""
    size = (core.xmax - core.xmin) // cells.shape[1]
    x = np.arange(squares.xmin, squares.xmax) * edge + edge // 2
    y = np.arange(squares.ymin, squares.ymax) * edge + edge // 2
    found: NDArray[np.bool_] = cells[np.ix_((y - core.ymin) // size, (x - core.xmin) // size)]
    return found
