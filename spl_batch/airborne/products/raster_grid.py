"""The raster cells of a ground cell, seen from its points.

Cells are numbered row by row from the south-west.
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
