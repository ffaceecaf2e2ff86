"""The fullest metre of each cell, and layers beside it that may be the surface instead.

A floor may be brighter than the surface above it, and as level. So may a thin cloud be, above both.
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
"""Photons that a cell's layer above or below its fullest metre holds at least [count]."""

_SURE_SD: Final = 5.0

_DEEPEST_M: Final = 60
"""No floor is seen through more water than this [m]."""


def fullest(
    cell: NDArray[np.intp], height: NDArray[np.int32], n: int
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Half-metre whose metre holds most photons, of each cell, and those of two layers beside it.

    One is the highest layer with a quarter as many photons: a surface above a floor that is
    brighter. The other is the fullest as bright that lies deeper than any floor is seen: the
    ground below a thin cloud. Both are the fullest metre where there is none. (n,) int64 each.
    """
    if not n:
        return np.zeros(0, np.int64), np.zeros(0, np.int64), np.zeros(0, np.int64)
    half = QUANTA_PER_M // 2
    bins = height // half
    base, width = int(bins.min()), int(bins.max() - bins.min()) + 1
    mode, upper, lower = (np.zeros(n, np.int64) for _ in range(3))
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
        deep = np.arange(width) < mode[first:stop, None] - 2 * _DEEPEST_M
        lower[first:stop] = _deeper(metre, deep, mode[first:stop])
    return mode + base, upper + base, lower + base


def _deeper(
    metre: NDArray[np.int64], deep: NDArray[np.bool_], mode: NDArray[np.int64]
) -> NDArray[np.int64]:
    """The fullest of the deep metres of each cell, where it is no noise, else ``mode``: (n,)."""
    held = np.where(deep, metre, 0)
    best = held.max(1, initial=0)
    # What lies in a metre lies in those beside it as well.
    others = np.maximum(held.sum(1) - 3 * best, 0) / np.maximum(deep.sum(1), 1)
    least = np.maximum(others + _SURE_SD * np.sqrt(others) + 3.0, metre.max(1) / _BRIGHTER)
    found: NDArray[np.int64] = np.where(best >= least, held.argmax(1), mode)
    return found


def agreed(
    index: NDArray[np.int64],
    mode: NDArray[np.int64],
    layer: NDArray[np.int64],
    reach: int,
    *,
    level: bool,
) -> NDArray[np.int64]:
    """A layer beside the fullest where half of the cells around have one, else the fullest.

    A ``level`` one has to lie at the height that it has there: a cloud or trees have a layer above
    the ground in every cell, and hardly at one height.
    """
    chosen = mode.copy()
    for i in np.flatnonzero(layer != mode):
        first, stop = np.searchsorted(index, (index[i] - reach, index[i] + reach + 1))
        around = layer[first:stop]
        there = np.abs(around - layer[i]) <= 1 if level else around <= layer[i] + 2 * _DEEPEST_M
        if 2 * np.count_nonzero(there) >= len(around):
            chosen[i] = layer[i]
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
