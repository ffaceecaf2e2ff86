"""Windows of an absolute grid along the track, and sums over each and those beside it."""

import numpy as np
from numpy.typing import NDArray

from spl_batch.altimetry.settings import RateSettings


def window_of(
    index: NDArray[np.int64], settings: RateSettings, window_m: float
) -> NDArray[np.int64]:
    """Window of the absolute grid that each cell lies in, (n,) int64."""
    return index // max(round(window_m / settings.cell_m), 1)


def of_window(
    index: NDArray[np.int64], values: NDArray[np.float64], settings: RateSettings, window_m: float
) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """Sums of cells' values over their window and the two beside it.

    Parameters
    ----------
    index : (n,) int64
        Cells.
    values : (m, n) float64
        Of each cell.

    Returns
    -------
    at : (n,) intp
        Row of each cell's window among those that hold cells.
    sums : (m, w) float64
    """
    window, at = np.unique(window_of(index, settings, window_m), return_inverse=True)
    own = np.stack([np.bincount(at, row, len(window)).astype(np.float64) for row in values])
    return at, running(window, own)


def running(window: NDArray[np.int64], own: NDArray[np.float64]) -> NDArray[np.float64]:
    """Sums of each window and those directly beside it, along the last axis."""
    total = own.copy()
    beside = np.diff(window) == 1
    total[..., 1:] += np.where(beside, own[..., :-1], 0)
    total[..., :-1] += np.where(beside, own[..., 1:], 0)
    return total
