"""Nearest cell that holds something, for each cell of a grid; by scipy's exact transform."""

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

Index = NDArray[np.int64]
Mask = NDArray[np.bool_]


def nearest_cells(held: Mask) -> tuple[Index, Index]:
    """Row and column of the nearest cell that holds something: two (rows, columns) int64.

    Parameters
    ----------
    held : (rows, columns) bool
        Cells that do; at least one.
    """
    found = distance_transform_edt(~held, return_distances=False, return_indices=True)
    row, column = found.astype(np.int64)
    return row, column


def distances(held: Mask) -> NDArray[np.float64]:
    """Distance of each cell to the nearest that holds something: (rows, columns) float64 [cells].

    ``held``: (rows, columns) bool, cells that do; where there are none it is infinite.
    """
    away: NDArray[np.float64] = distance_transform_edt(~held)
    return away if held.any() else np.full(held.shape, np.inf)
