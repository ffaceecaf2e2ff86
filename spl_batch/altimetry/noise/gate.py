"""Stretches of track that are long enough to show gate and noise.

By night a cell of 20 m holds no noise at all: what it spans is its surface. So gate and rate are
read from the shortest stretch around a cell that holds some tens of noise photons, 2 km at most. By
day that is the cell and those beside it.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.altimetry.settings import RateSettings
from spl_batch.lattice.tiles import quanta

STRETCH_CELLS: Final = 50
"""Most cells to each side that gate and rate of a cell are read from [count]."""

STRETCH_PHOTONS: Final = 30
"""Noise photons that gate and rate are read from, where a stretch has as many [count]."""


def gates(
    index: NDArray[np.int64],
    cell: NDArray[np.intp],
    height: NDArray[np.int32],
    peak: NDArray[np.int64],
    settings: RateSettings,
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Ends of the gate of each cell, from as many cells around it as show them [quanta].

    The gate is the spread of the photons of a stretch, longer by what the ends of so many are
    expected to lie inside.

    Parameters
    ----------
    index : (n,) int64
        Cells.
    cell : (p,) intp
        Row of each photon's cell.
    height : (p,) int32
        Photons [quanta].
    peak : (n,) int64
        Surface of each cell; photons farther than a height bin from it are noise [quanta].
    settings : RateSettings
        Height bins.
    """
    n = len(index)
    away = np.abs(height - peak[cell]) > quanta(settings.slice_m)
    count = np.bincount(cell[away], minlength=n)
    low = np.full(n, np.iinfo(np.int32).max, np.int64)
    high = np.full(n, np.iinfo(np.int32).min, np.int64)
    np.minimum.at(low, cell, height)
    np.maximum.at(high, cell, height)
    reach, seen = stretches(index, count, 0)
    first = np.searchsorted(index, index - reach)
    stop = np.searchsorted(index, index + reach, side="right")
    bounds = np.stack([first, stop], axis=1).ravel()
    # A row more, so that the last stretch may end where the cells do.
    least = np.minimum.reduceat(np.append(low, low[-1:]), bounds)[::2] if n else low
    most = np.maximum.reduceat(np.append(high, high[-1:]), bounds)[::2] if n else high
    more = (most - least) // np.maximum(seen - 1, 4)
    more[seen < 2] = 0
    return (least - more).astype(np.int32), (most + more).astype(np.int32)


def stretches(
    index: NDArray[np.int64], count: NDArray[np.int64], least: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Cells to each side that hold enough noise photons, and those photons: (n,) int64 each.

    Parameters
    ----------
    index, count : (n,) int64
        Cells, and noise photons seen in each [count].
    least : int
        Cells to each side at least [count].
    """
    total = np.concatenate([[0], np.cumsum(count)])
    reach = np.full(len(index), STRETCH_CELLS, np.int64)
    seen = np.zeros(len(index), np.int64)
    wider = STRETCH_CELLS
    while True:
        first = np.searchsorted(index, index - wider)
        stop = np.searchsorted(index, index + wider, side="right")
        within = total[stop] - total[first]
        enough = (within >= STRETCH_PHOTONS) | (wider == STRETCH_CELLS)
        reach[enough], seen[enough] = wider, within[enough]
        if wider <= least:
            return reach, seen
        wider = max(wider // 2, least)
