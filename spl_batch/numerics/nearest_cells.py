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

    ``held``: as :func:`nearest_cells` has it.
    """
    away: NDArray[np.float64] = distance_transform_edt(~held)
    return away


def within_discs(held: Mask, radius: float) -> Mask:
    """Cells whose distance to one that holds something is no more than a radius.

    Parameters
    ----------
    held : (rows, columns) bool
        Cells that do; there may be none.
    radius : float
        Radius between the middles of cells [cells], >= 0.

    Returns
    -------
    (rows, columns) bool
    """
    return distances(held) <= radius if held.any() else np.zeros_like(held)
