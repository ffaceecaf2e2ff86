"""Squares of an absolute grid: raster cells of a ground cell, and those that diagnostics count.

Raster cells are numbered row by row from the south-west.
"""

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.products.cell_values import number_cells
from spl_batch.lattice.tables import PointTable
from spl_batch.lattice.tiles import Bounds


def shape_of(bounds: Bounds, size: int) -> tuple[int, int]:
    """Rows and columns of raster cells of an edge [quanta]."""
    return (bounds.ymax - bounds.ymin) // size, (bounds.xmax - bounds.xmin) // size


def cell_number(table: PointTable, bounds: Bounds, size: int) -> NDArray[np.int64]:
    """Number of the raster cell of each point within bounds, row by row from the south-west."""
    number = np.empty(len(table), np.int64)
    corner, cols = (bounds.xmin, bounds.ymin), shape_of(bounds, size)[1]
    number_cells(table["x"], table["y"], corner, float(size), cols, number)
    return number


def relative(
    table: PointTable, order: NDArray[np.intp], corner: Bounds
) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int32]]:
    """Sorted coordinates relative to a corner: three (n,) int32 [quanta]."""
    return (
        (table["x"].take(order) - corner.xmin).astype(np.int32),
        (table["y"].take(order) - corner.ymin).astype(np.int32),
        table["z"].take(order),
    )


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
