"""A level surface that is fainter than the floor below it.

Where a lagoon hardly glints, a cell of 20 m holds one or two photons of its surface and dozens of
its floor, so no cell by itself shows water. A surface is level and a floor is not: over a kilometre
and a half the few photons pile up at one height, with nothing at the heights beside it. Crowns
stand above the ground too, but at all heights; roofs are level, but not above most of the cells.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.altimetry.water.emptiest import sums_around
from spl_batch.constants import QUANTA_PER_M

BLOCK_CELLS: Final = 25
"""Cells of a block of the absolute grid; a block is looked at with the two beside it [count]."""

NEAR_CELLS: Final = 3
"""Cells to each side that show a surface which the cell itself may not [count]."""

_HALF: Final = QUANTA_PER_M // 2
_DEEPEST: Final = 120
"""Half-metres of water that a floor is seen through, at most [count]."""

_BESIDE: Final = 2
"""Half-metres from a surface to where nothing of it is any more [count]."""

CLEAR: Final = 4
"""Half-metres above the fullest one from where nothing of a rough or sloping ground is left."""

_SKY: Final = (4, 24)
"""Half-metres above it whose photons tell what chance puts into one [count]."""

_SHARP: Final = 3.0
"""Times as many photons as at the heights beside it, and as chance brings, that a surface has."""

_SURE_SD: Final = 6.0
_SEEN: Final = 2
"""Photons of it that a cell and those near by hold [count]."""

_SHOWN: Final = 0.5
"""Cells over a floor that hold a photon of the surface above it."""


def faint_surface(
    index: NDArray[np.int64],
    cell: NDArray[np.intp],
    height: NDArray[np.int32],
    mode: NDArray[np.int64],
    least_cells: int,
) -> NDArray[np.int64]:
    """Half-metre of the surface above the fullest metre of each cell, or that: (n,) int64.

    Parameters
    ----------
    index : (n,) int64
        Cell numbers, in order.
    cell : (p,) intp
        Row of each photon's cell.
    height : (p,) int32
        Photons [quanta].
    mode : (n,) int64
        Half-metre of each cell's fullest metre.
    least_cells : int
        Cells over a floor that a surface is seen over, at least [count].
    """
    chosen = mode.copy()
    over = height // _HALF - mode[cell]
    above = np.flatnonzero((over >= _BESIDE) & (over <= _DEEPEST + _SKY[1]))
    if not len(above):
        return chosen
    above = above[np.argsort(cell[above], kind="stable")]
    cell, bins = cell[above], height[above] // _HALF
    block, at = np.unique(index // BLOCK_CELLS, return_inverse=True)
    base, width = int(bins.min()), int(bins.max() - bins.min()) + 1
    table = np.bincount(at[cell] * width + bins - base, minlength=len(block) * width)
    around = sums_around(block, table.reshape(len(block), width), 1)
    sky = _sky(around)
    for i, column in np.argwhere(_sharp(around, sky)).tolist():
        level = column + base
        rows = slice(*np.searchsorted(block[at], (block[i] - 1, block[i] + 2)))
        some = mode[rows] + CLEAR <= level
        if np.count_nonzero(some) < least_cells:
            continue
        mine = slice(*np.searchsorted(cell, (rows.start, rows.stop)))
        here = np.abs(bins[mine] - level) <= 1
        held = np.bincount(cell[mine][here] - rows.start, minlength=rows.stop - rows.start)
        if not _shown(held[some], 3.0 * sky[i, column] / len(held)):
            continue
        near = sums_around(index[rows], held[:, None], NEAR_CELLS)[:, 0]
        own = (at[rows] == i) & (mode[rows] + _BESIDE <= level) & (near >= _SEEN)
        # Levels come from below: the highest stays.
        chosen[rows][own] = level
    return chosen


def _shown(held: NDArray[np.int64], chance: float) -> bool:
    """Whether cells show a surface in half of them, and more of it than chance does in each."""
    total, noise = int(held.sum()), chance * len(held)
    sure = total > max(_SHARP * noise, noise + _SURE_SD * float(np.sqrt(noise + 1.0)))
    return sure and float(np.mean(held > 0)) >= _SHOWN


def _sky(around: NDArray[np.float64]) -> NDArray[np.float64]:
    """Photons that chance puts into each half-metre, by those above it: (blocks, bins) float64."""
    blocks, width = around.shape
    padded = np.pad(around, ((0, 0), (0, _SKY[1])))
    total = np.concatenate([np.zeros((blocks, 1)), np.cumsum(padded, axis=1)], axis=1)
    first, stop = _SKY
    above = total[:, stop : stop + width] - total[:, first : first + width]
    sky: NDArray[np.float64] = above / (stop - first)
    return sky


def _sharp(around: NDArray[np.float64], sky: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Half-metres of blocks where photons pile up: (blocks, bins) bool."""
    width = around.shape[1]
    padded = np.pad(around, ((0, 0), (_BESIDE, _BESIDE)))
    beside = np.maximum(padded[:, :width], padded[:, 2 * _BESIDE :])
    found: NDArray[np.bool_] = around > _SHARP * np.maximum(beside, sky)
    return found & (around > sky + _SURE_SD * np.sqrt(sky + 1.0))
