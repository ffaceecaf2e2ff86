"""Stretches of track that are long enough to show gate and noise.

By night a cell of 20 m holds no noise at all: what it spans is its surface. So gate and rate are
read from the shortest stretch around a cell that holds some tens of noise photons, 2 km at most. By
day that is the cell and those beside it. Both ends of the gate have to be seen: a floor has photons
enough below a surface, and none of them tells where the gate ends above it.
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

END_PHOTONS: Final = 8
"""Of them on either side of the surface, so that both ends of the gate are seen [count]."""


def gates(
    index: NDArray[np.int64],
    cell: NDArray[np.intp],
    height: NDArray[np.int32],
    surface: tuple[NDArray[np.int64], NDArray[np.int64]],
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
    surface : ((n,) int64, (n,) int64)
        Lowest and highest surface of each cell; photons farther than a height bin below and above
        them are noise [quanta].
    """
    n = len(index)
    least = quanta(settings.slice_m)
    sides = height < surface[0][cell] - least, height > surface[1][cell] + least
    below, above = (np.bincount(cell[side], minlength=n) for side in sides)
    # Of the photons' own type: numpy takes seconds for others.
    low = np.full(n, np.iinfo(np.int32).max, np.int32)
    high = np.full(n, np.iinfo(np.int32).min, np.int32)
    np.minimum.at(low, cell, height)
    np.maximum.at(high, cell, height)
    low, high = low.astype(np.int64), high.astype(np.int64)
    reach, _ = stretches(index, below + above, 0)
    # A floor, and the water above it, tell nothing of the upper end.
    for one in (below, above):
        reach = np.maximum(reach, stretches(index, one, 0, END_PHOTONS)[0])
    first = np.searchsorted(index, index - reach)
    stop = np.searchsorted(index, index + reach, side="right")
    bounds = np.stack([first, stop], axis=1).ravel()
    # A row more, so that the last stretch may end where the cells do.
    lowest = np.minimum.reduceat(np.append(low, low[-1:]), bounds)[::2] if n else low
    highest = np.maximum.reduceat(np.append(high, high[-1:]), bounds)[::2] if n else high
    total = np.concatenate([[0], np.cumsum(below + above)])
    seen = total[stop] - total[first]
    more = (highest - lowest) // np.maximum(seen - 1, 4)
    more[seen < 2] = 0
    return (lowest - more).astype(np.int32), (highest + more).astype(np.int32)


def stretches(
    index: NDArray[np.int64],
    count: NDArray[np.int64],
    least: int,
    photons: int = STRETCH_PHOTONS,
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Cells to each side that hold enough noise photons, and those photons: (n,) int64 each.

    Parameters
    ----------
    index, count : (n,) int64
        Cells, and noise photons seen in each [count].
    """
    reach = np.full(len(index), STRETCH_CELLS, np.int64)
    seen = np.zeros(len(index), np.int64)
    wider = STRETCH_CELLS
    while True:
        within = _around(index, count, wider)
        enough = (within >= photons) | (wider == STRETCH_CELLS)
        reach[enough], seen[enough] = wider, within[enough]
        if wider <= least:
            return reach, seen
        wider = max(wider // 2, least)


def _around(index: NDArray[np.int64], values: NDArray[np.int64], reach: int) -> NDArray[np.int64]:
    """Sums over the cells of an absolute grid within ``reach`` of each, (n,) int64."""
    total = np.concatenate([[0], np.cumsum(values)])
    first = np.searchsorted(index, index - reach)
    stop = np.searchsorted(index, index + reach, side="right")
    sums: NDArray[np.int64] = total[stop] - total[first]
    return sums
