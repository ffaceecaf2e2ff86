"""Where the gate of a cell, or the first metre of its water, is emptiest, by the cells around.

Noise is equally dense at every height, so what is emptiest shows noise and nothing else. A cell's
own photons do not choose what is counted of them: chance does not make the noise less than it is.
"""

from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.constants import QUANTA_PER_M

QUARTER: Final = 4
"""Part of a gate that is counted, one over [count]."""

_BIN_M: Final = 2
"""Height of a bin [m]."""

_BINS: Final = 75
"""Bins to each side of the middle [count]; what is farther off is not looked at."""


_BAND_M: Final = 0.1
"""Height of a band between a surface and a shallow floor [m]."""


class Photons(NamedTuple):
    """Photons of cells."""

    number: NDArray[np.int64]  #: (n,): cells, in order.
    cell: NDArray[np.intp]  #: (p,): row of each photon's cell.
    height: NDArray[np.int32]  #: (p,): heights [quanta].


def emptiest(
    photons: Photons,
    gate: tuple[NDArray[np.int64], NDArray[np.int64]],
    middle: NDArray[np.int64],
    some: NDArray[np.bool_],
    reach: int,
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Photons in the emptiest quarter of the gate, and its length: (n,) int64 [count, quanta].

    Parameters
    ----------
    gate : ((n,) int64, (n,) int64)
        Lower and upper end of each cell's gate [quanta].
    middle : (n,) int64
        Height that bins are counted from [quanta]: ground and crowns keep theirs along the track.
    some : (n,) bool
        Cells that are looked at; 0 for others.
    reach : int
        Cells to each side that say what is empty [count].
    """
    index, cell, height = photons
    step = _BIN_M * QUANTA_PER_M
    row = (height - middle[cell]) // step + _BINS
    inside = some[cell] & (row >= 0) & (row < 2 * _BINS)
    n = len(index)
    count = np.bincount(cell[inside] * 2 * _BINS + row[inside], minlength=n * 2 * _BINS)
    count = count.reshape(n, 2 * _BINS)
    first = middle[:, None] + (np.arange(2 * _BINS) - _BINS) * step
    length = np.minimum(gate[1][:, None], first + step) - np.maximum(gate[0][:, None], first)
    length = np.where(some[:, None], np.maximum(length, 0), 0)
    others = sums_around(index, count, reach) - count
    seen = sums_around(index, length, reach) - length
    # Bins that others hardly see come last.
    order = np.argsort((others + 1.0) / (seen + 1.0), axis=1, kind="stable")
    ordered = np.take_along_axis(length, order, axis=1)
    before = np.cumsum(ordered, axis=1) - ordered
    taken = before * QUARTER < length.sum(axis=1, keepdims=True)
    counted = np.take_along_axis(count, order, axis=1)
    return (counted * taken).sum(axis=1), (ordered * taken).sum(axis=1)


def mean_height(photons: Photons, reach: int) -> NDArray[np.int64]:
    """Mean height of the photons of the cells within ``reach`` of each, (n,) int64 [quanta]."""
    index, cell, height = photons
    counted = [np.bincount(cell, weight, len(index)) for weight in (height, None)]
    total, number = sums_around(index, np.stack(counted, axis=1), reach).T
    mean: NDArray[np.int64] = np.rint(total / np.maximum(number, 1.0)).astype(np.int64)
    return mean


def emptiest_band(
    index: NDArray[np.int64],
    cell: NDArray[np.intp],
    depth_m: NDArray[np.float64],
    between_m: tuple[float, float],
    reach: int,
) -> NDArray[np.float64]:
    """Photons more in the emptiest band below a surface than as far above it: (n,) float64 [1/m].

    Waves reach as far up as down; what is as high as they are counts for nothing.

    Parameters
    ----------
    index, cell : (n,) int64, (p,) intp
        Cells, in order, and the row of each photon's.
    depth_m : (p,) float64
        Below the surface [m]; 0 where there is none.
    between_m : (float, float)
        Depths between which bands lie [m].
    reach : int
        Cells to each side whose photons count [count].
    """
    low_m, high_m = between_m
    n, bands = len(index), round((high_m - low_m) / _BAND_M)
    band = np.floor((np.abs(depth_m) - low_m) / _BAND_M).astype(np.int64)
    inside = (band >= 0) & (band < bands)
    place = cell[inside] * bands + band[inside]
    more = np.bincount(place, np.sign(depth_m[inside]), n * bands).reshape(n, bands)
    found: NDArray[np.float64] = sums_around(index, more, reach).min(axis=1) / _BAND_M
    return found


def sums_around(index: NDArray[np.int64], values: NDArray[Any], reach: int) -> NDArray[np.float64]:
    """Sums over the cells of an absolute grid within ``reach`` of each."""
    # Whole parts of a square metre: sums of whole numbers have no order.
    whole = np.rint(values * 1024).astype(np.int64)
    total = np.concatenate([np.zeros((1, values.shape[1]), np.int64), np.cumsum(whole, axis=0)])
    first = np.searchsorted(index, index - reach)
    stop = np.searchsorted(index, index + reach, side="right")
    found: NDArray[np.float64] = (total[stop] - total[first]) / 1024
    return found
