"""Points by square columns of the absolute lattice, each column sorted by height.

A search that is wide but flat - along a wire, around a small cube - looks at a few columns and
walks one stretch of each. Columns lie on the absolute lattice and ties are broken by row,
so the order in which points come does not depend on what else the table holds.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from spl_batch.lattice.row_order import lexicographic_order
from spl_batch.numerics.compiled import njit


class Columns(NamedTuple):
    """Points in column order."""

    points: NDArray[np.int32]  #: (4, n): x, y, z [quanta] and row of each slot, each contiguous.
    start: NDArray[np.int64]  #: (nx * ny + 1,): first slot of each column, y fastest.
    #: (2,): lower corner of the first column, relative to the anchor [quanta].
    corner: NDArray[np.int64]
    shape: tuple[int, int]  #: Columns along x and y.
    edge: int  #: Edge of a column [quanta].


def columns(
    xyz: NDArray[np.int32], rows: NDArray[np.intp], anchor: tuple[int, int, int], edge: int
) -> Columns:
    """Put some points into columns.

    Parameters
    ----------
    xyz : (m, 3) int32
        Coordinates relative to the anchor [quanta].
    rows : (n,) intp
        Points to take, ascending.
    anchor : tuple of int
        Where xyz counts from, on the absolute lattice [quanta].
    edge : int
        Edge of a column [quanta].
    """
    # Searches look at whole vectors: some more lies behind the last point.
    points = np.empty(4 * len(rows) + 8, dtype=np.int32)[:-8].reshape(4, -1)
    if not len(rows):
        return Columns(points, np.zeros(2, np.int64), np.zeros(2, np.int64), (1, 1), edge)
    cell = [(xyz[rows, a].astype(np.int64) + anchor[a]) // edge for a in (0, 1)]
    first = [int(c.min()) for c in cell]
    shape = (int(cell[0].max()) - first[0] + 1, int(cell[1].max()) - first[1] + 1)
    column = (cell[0] - first[0]) * shape[1] + (cell[1] - first[1])
    start = np.zeros(shape[0] * shape[1] + 1, dtype=np.int64)
    np.cumsum(np.bincount(column, minlength=len(start) - 1), out=start[1:])
    # Rows ascend within equal heights.
    points[3] = rows[lexicographic_order([column, xyz[rows, 2]])]
    # A point is fetched once: its three coordinates share memory.
    points[:3] = xyz[points[3]].T
    corner = np.array([first[a] * edge - anchor[a] for a in (0, 1)], dtype=np.int64)
    return Columns(points, start, corner, shape, edge)


def most_around(made: Columns, span: int = 1) -> int:
    """Most points in a column and those up to ``span`` columns beside it [count]."""
    counts = np.diff(made.start).reshape(made.shape)
    for axis in (0, 1):
        counts = ndimage.convolve1d(counts, np.ones(2 * span + 1, int), axis, mode="constant")
    return int(counts.max())


@njit()
def first_above(points, low, high, z):  # type: ignore[no-untyped-def]
    """First slot of a column's stretch [low, high) whose height is at least ``z``."""
    while low < high:
        middle = (low + high) // 2
        if points[2, middle] < z:
            low = middle + 1
        else:
            high = middle
    return low


@njit(inline="always")
def stretch_of(coordinate, reach, edge, n):  # type: ignore[no-untyped-def]
    """First column within ``reach`` of a coordinate along one axis, and the one after the last."""
    low = np.int64(math.floor((coordinate - reach) / edge))
    high = np.int64(math.floor((coordinate + reach) / edge))
    return max(low, 0), min(high + 1, n)
