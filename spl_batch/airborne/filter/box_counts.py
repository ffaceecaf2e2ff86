"""Counts of two kinds of points in the cells of a lattice, its wide gaps closed."""

import numpy as np
from numpy.typing import NDArray

from spl_batch.numerics.compiled import njit

_Axes = tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int32]]


@njit()
def lowest_and_highest(
    xyz: _Axes, kind: NDArray[np.uint8], kinds: tuple[int, int], out: NDArray[np.int64]
) -> int:
    """Extent of the points of two kinds.

    Parameters
    ----------
    xyz : three (n,) of integers
        Points [quanta].
    kind : (n,) uint8
        What they are.
    kinds : (int, int)
        Those that are looked at.
    out : (3, 2) int64, written
        Lowest and highest coordinate on each axis; as it was where there is no point.

    Returns
    -------
    int
        0, 1 for points of the first kind, 2 for the second, 3 for both.
    """
    x, y, z = xyz
    met, far = 0, np.int64(1 << 62)
    # Own numbers: what stands in an array is written at each point.
    west, south, low, east, north, high = far, far, far, -far, -far, -far
    for i in range(len(kind)):
        first, second = kind[i] == kinds[0], kind[i] == kinds[1]
        if first or second:
            met |= first + 2 * second
            west, east = min(west, x[i]), max(east, x[i])
            south, north = min(south, y[i]), max(north, y[i])
            low, high = min(low, np.int64(z[i])), max(high, np.int64(z[i]))
    if met:
        out[0, 0], out[1, 0], out[2, 0] = west, south, low
        out[0, 1], out[1, 1], out[2, 1] = east, north, high
    return met


@njit()
def cells_held(
    xyz: _Axes, kind: NDArray[np.uint8], kinds: tuple[int, int], corner: NDArray[np.int64],
    edge: float, held: tuple[NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_]],
) -> None:  # fmt: skip
    """Mark the cells along each axis that hold points of two kinds.

    Parameters
    ----------
    corner : (3,) int64
        Lower corner of the lattice's first cell [quanta].
    edge : float
        Edge of a cell, a whole number [quanta].
    held : three (cells,) bool, written
        Cells along x, y and z.
    """
    x, y, z = xyz
    for i in range(len(kind)):
        if kind[i] == kinds[0] or kind[i] == kinds[1]:
            # A quotient of whole numbers below 2**53 never rounds up to the next whole one.
            held[0][np.int64((x[i] - corner[0]) / edge)] = True
            held[1][np.int64((y[i] - corner[1]) / edge)] = True
            held[2][np.int64((z[i] - corner[2]) / edge)] = True


@njit()
def count_in_cells(
    xyz: _Axes, kind: NDArray[np.uint8], kinds: tuple[int, int], corner: NDArray[np.int64],
    edge: float, place: tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]],
    first: NDArray[np.int64], second: NDArray[np.int64], number: NDArray[np.int32],
) -> None:  # fmt: skip
    """Count points of two kinds in each cell.

    Parameters
    ----------
    place : three (cells,) int64
        Number of a cell along each axis, gaps closed.
    first, second : (a, b, c) int64, added to
        Points of either kind.
    number : (n,) int32, written
        Cell of each point of the first kind in ``first.ravel()``; -1 for all others.
    """
    x, y, z = xyz
    for i in range(len(kind)):
        number[i] = -1
        if kind[i] != kinds[0] and kind[i] != kinds[1]:
            continue
        a = place[0][np.int64((x[i] - corner[0]) / edge)]
        b = place[1][np.int64((y[i] - corner[1]) / edge)]
        c = place[2][np.int64((z[i] - corner[2]) / edge)]
        if kind[i] == kinds[0]:
            first[a, b, c] += 1
            number[i] = (a * first.shape[1] + b) * first.shape[2] + c
        else:
            second[a, b, c] += 1


@njit()
def in_marked_cells(
    number: NDArray[np.int32], marked: NDArray[np.bool_], out: NDArray[np.bool_]
) -> None:
    """Which points lie in marked cells.

    Parameters
    ----------
    number : (n,) int32
        Cell of each point, negative for none.
    marked : (cells,) bool
        Cells.
    out : (n,) bool, written
    """
    for i in range(len(number)):
        out[i] = number[i] >= 0 and marked[number[i]]


@njit()
def count_values(
    xyz: _Axes, kind: tuple[NDArray[np.uint8], NDArray[np.bool_]], kinds: tuple[int, int],
    value: NDArray[np.float32], corner: NDArray[np.int64], edge: float,
    place: tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]],
    marked: NDArray[np.bool_], ends: NDArray[np.float64], out: NDArray[np.int64],
) -> None:  # fmt: skip
    """Histogram of a value of the points of two kinds in marked cells.

    Parameters
    ----------
    kind : (n,) uint8, (n,) bool
        What points are, and which of them count.
    value : (n,) float32
        NaN counts nowhere.
    place : three (cells,) int64
        As in :func:`count_in_cells`.
    marked : (a, b, c) bool
        Cells.
    ends : (bins,) float64
        Upper end of each bin, rising.
    out : (bins + 1,) int64, added to
        The last one has what lies beyond.
    """
    x, y, z = xyz
    what, counts = kind
    for i in range(len(what)):
        if not counts[i] or np.isnan(value[i]) or (what[i] != kinds[0] and what[i] != kinds[1]):
            continue
        a = place[0][np.int64((x[i] - corner[0]) / edge)]
        b = place[1][np.int64((y[i] - corner[1]) / edge)]
        c = place[2][np.int64((z[i] - corner[2]) / edge)]
        if marked[a, b, c]:
            bin_of = 0
            while bin_of < len(ends) and value[i] > ends[bin_of]:
                bin_of += 1
            out[bin_of] += 1
