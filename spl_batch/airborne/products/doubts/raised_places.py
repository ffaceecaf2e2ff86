"""Places of a terrain model that stand above the ground beside them, each as one."""

from collections.abc import Iterator
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

DOMAIN: Final = "space"

Grid = NDArray[np.float64]
Mask = NDArray[np.bool_]


class RaisedPlace(NamedTuple):
    """Cells that hang together.

    Parameters
    ----------
    area_m2 : float
        Area [m2].
    row, column : int
        Its highest cell.
    height_m : float
        How far that stands above the ground on both sides [m].
    cells : (2, n) int64
        Rows and columns of all of it.
    """

    area_m2: float
    row: int
    column: int
    height_m: float
    cells: NDArray[np.int64]


def raised_places(above: Grid, told: Mask, cell_m: float) -> Iterator[RaisedPlace]:
    """Places of some cells, row by row.

    Parameters
    ----------
    above : (rows, columns) float64
        How far each cell stands above the ground on both sides [m].
    told : (rows, columns) bool
        Cells that count.
    cell_m : float
        Edge of a cell [m].
    """
    numbers, _ = ndimage.label(told, np.ones((3, 3)))
    for number, box in enumerate(ndimage.find_objects(numbers), start=1):
        mine = numbers[box] == number
        cells = np.stack(np.nonzero(mine)) + np.array([[side.start] for side in box])
        height = above[box][mine]
        row, column = cells[:, height.argmax()].tolist()
        area_m2 = float(mine.sum()) * cell_m**2
        yield RaisedPlace(area_m2, row, column, float(height.max()), cells)
