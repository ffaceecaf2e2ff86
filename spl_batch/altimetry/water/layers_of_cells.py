"""The fullest metre of each cell, and a layer above it that may be a water surface.

A floor may be brighter than the surface above it, and as level.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from spl_batch.constants import QUANTA_PER_M

_BRIGHTER: Final = 4
"""Times the photons of the surface above it that a floor may hold [count]."""

LEAST_CELLS: Final = 10
"""Cells that a level has to be the fullest metre of [count]."""

_LAYER_LEAST: Final = 4
"""Photons that a cell's layer above its fullest metre holds at least [count]."""


def fullest(
    cell: NDArray[np.intp], height: NDArray[np.int32], n: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Half-metre whose metre holds most photons, of each cell, and the one of the highest layer.

    That is the fullest metre too, unless one above it holds a quarter as many photons: a surface
    above a floor that is brighter. (n,) int64 each.
    """
    if not n:
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    half = QUANTA_PER_M // 2
    bins = height // half
    base, width = int(bins.min()), int(bins.max() - bins.min()) + 1
    mode, upper = np.zeros(n, np.int64), np.zeros(n, np.int64)
    step = max(4_000_000 // width, 1)
    order = np.argsort(cell, kind="stable")
    edges = np.searchsorted(cell[order], np.arange(n + 1))
    for first in range(0, n, step):
        stop = min(first + step, n)
        rows = order[edges[first] : edges[stop]]
        table = np.bincount(
            (cell[rows] - first) * width + bins[rows] - base, minlength=(stop - first) * width
        ).reshape(stop - first, width)
        metre = ndimage.convolve1d(table, [1, 1, 1], axis=1, mode="constant")
        mode[first:stop] = metre.argmax(1)
        many = metre >= np.maximum(metre.max(1, keepdims=True) / _BRIGHTER, _LAYER_LEAST)
        top = width - 1 - many[:, ::-1].argmax(1)
        # What lies in a metre lies in the ends of those beside it as well.
        around = np.maximum(top[:, None] + np.arange(-2, 1), 0)
        top = around[:, 0] + np.take_along_axis(metre, around, axis=1).argmax(1)
        higher = many.any(1) & (top > mode[first:stop] + 2)
        upper[first:stop] = np.where(higher, top, mode[first:stop])
    return mode + base, upper + base


def agreed(
    index: NDArray[np.int64], mode: NDArray[np.int64], upper: NDArray[np.int64], reach: int
) -> NDArray[np.int64]:
    """The highest layer where half of the cells around have it at that height, else the fullest.

    A cloud or trees have a layer in every cell, and hardly at one height.
    """
    chosen = mode.copy()
    for i in np.flatnonzero(upper != mode):
        first, stop = np.searchsorted(index, (index[i] - reach, index[i] + reach + 1))
        around = upper[first:stop]
        if 2 * np.count_nonzero(np.abs(around - upper[i]) <= 1) >= len(around):
            chosen[i] = upper[i]
    return chosen


def common_metre(
    index: NDArray[np.int64], mode: NDArray[np.int64], reach: int
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """The fullest metre that many cells around share, the cell's own before others.

    Parameters
    ----------
    index, mode : (n,) int64
        Cells, and the half-metre of the fullest metre of each.
    reach : int
        Cells to each side that are looked at [count].

    Returns
    -------
    common : (n,) int64
        Half-metre that most of them have; the cell's own where :data:`LEAST_CELLS` have that.
    shared : (n,) bool
        Whether as many have it.
    """
    first = np.searchsorted(index, index - reach)
    stop = np.searchsorted(index, index + reach, side="right")
    common, same = mode.copy(), np.zeros(len(index), np.int64)
    for i in range(len(index)):
        around = mode[first[i] : stop[i]]
        same[i] = np.count_nonzero(np.abs(around - mode[i]) <= 1)
        if same[i] < LEAST_CELLS:
            base = around.min()
            runs = np.convolve(np.bincount(around - base), (1, 1, 1), "same")
            common[i], same[i] = base + runs.argmax(), runs.max()
    return common, same >= LEAST_CELLS
