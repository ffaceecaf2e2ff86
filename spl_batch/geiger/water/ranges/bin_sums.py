"""Sums over frames of time bins: where hits lie, and how many a pixel has [G15 Eq. 2-1, 2-3].

A frame holds for each pixel the bin of its only hit, 0 for none. All sums are integers, so pieces
of a file may come in any order.
"""

import numpy as np
from numpy.typing import NDArray

from spl_batch.numerics.compiled import njit


@njit()
def add_histogram(
    frames: NDArray[np.uint16], used: NDArray[np.bool_], out: NDArray[np.int64]
) -> int:
    """Count the hits of each bin.

    Parameters
    ----------
    frames : (n, rows, cols) uint16
        Bins; 0 is no hit.
    used : (rows, cols) bool
        Pixels that are counted.
    out : (bins + 1,) int64
        Added to.

    Returns
    -------
    int
        Hits of these pixels in bins beyond the last, which are not counted.
    """
    n, rows, cols = frames.shape
    beyond = 0
    for f in range(n):
        for i in range(rows):
            for j in range(cols):
                value = frames[f, i, j]
                if value == 0 or not used[i, j]:
                    continue
                if value < len(out):
                    out[value] += 1
                else:
                    beyond += 1
    return beyond


@njit()
def add_hits(
    frames: NDArray[np.uint16],
    low: int,
    high: int,
    hits: NDArray[np.int64],
    total: NDArray[np.int64],
    square: NDArray[np.int64],
    outside: NDArray[np.int64],
) -> None:
    """Add up the hits within a gate, and their bins counted from its start.

    Parameters
    ----------
    frames : (n, rows, cols) uint16
        Bins; 0 is no hit.
    low, high : int
        First bin of the gate, and the first one behind it.
    hits, total, square, outside : (rows, cols) int64
        Added to: hits, sums of ``bin - low`` and of its square, hits outside the gate.
    """
    n, rows, cols = frames.shape
    for f in range(n):
        for i in range(rows):
            for j in range(cols):
                value = np.int64(frames[f, i, j])
                if value == 0:
                    continue
                if value < low or value >= high:
                    outside[i, j] += 1
                    continue
                step = value - low
                hits[i, j] += 1
                total[i, j] += step
                square[i, j] += step * step
