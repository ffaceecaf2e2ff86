"""Points in the cells around each point's own cell, of the absolute lattice.

A window of three slabs moves through the points along x. Each point adds one to the nine cells
around its own when its slab comes in, and takes it away when it goes out; in between its own cell
gives the count. The cost is a point's, however wide or high the cloud: along each axis a gap counts
as one cell.
"""

import math

import numpy as np
from numpy.typing import NDArray

from spl_batch.numerics.compiled import njit
from spl_batch.numerics.neighbours.kdtree import U1


def cube_counts(
    xyz: NDArray[np.int32], anchor: tuple[int, int, int], edge: int
) -> NDArray[np.int32]:
    """Points in the 3 x 3 x 3 cells around each point's own cell, itself included: (n,) int32.

    ``xyz``: (n, 3), from ``anchor`` on the absolute lattice on; quickest in ascending order of x.
    """
    out = np.zeros(len(xyz), dtype=np.int32)
    if not len(xyz):
        return out
    cell = np.empty((3, len(xyz)), dtype=np.int32)
    slabs, across, up = (
        _number_cells(xyz, axis, float(anchor[axis]), float(edge), cell) for axis in range(3)
    )
    _count(cell, slabs, across + 2, up + 2, out)
    return out


@njit()
def _number_cells(
    xyz: NDArray[np.int32], axis: int, base: float, edge: float, cell: NDArray[np.int32]
) -> int:
    """Number the cells along an axis from 1 on, a gap like a single cell: the largest number."""
    n = len(xyz)
    low, high = xyz[0, axis], xyz[0, axis]
    for i in range(n):
        low, high = min(low, xyz[i, axis]), max(high, xyz[i, axis])
    # No quotient of whole numbers so small rounds up to the next whole one.
    first = math.floor((low + base) / edge)
    number = np.zeros(np.int64(math.floor((high + base) / edge) - first) + 1, np.int32)
    for i in range(n):
        cell[axis, i] = np.int32(math.floor((xyz[i, axis] + base) / edge) - first)
        number[cell[axis, i]] = 1
    last, beside = 0, False
    for c in range(len(number)):
        held = number[c] == 1
        last += held or beside
        number[c], beside = last, held
    for i in range(n):
        cell[axis, i] = number[cell[axis, i]]
    return last


@njit()
def _add(
    held: NDArray[np.int32], cell: NDArray[np.int32], row: np.int64, up: np.uint64, one: np.int32
) -> None:
    """Add to the nine cells around a point's own."""
    at = np.uint64(cell[1, row] - 1) * up + np.uint64(cell[2, row] - 1)
    for _ in range(3):
        held[at] += one
        held[at + U1] += one
        held[at + U1 + U1] += one
        at += up


@njit()
def _count(
    cell: NDArray[np.int32], slabs: int, across: int, up: int, out: NDArray[np.int32]
) -> None:
    """Move the window of three slabs from end to end."""
    n = cell.shape[1]
    start = np.zeros(slabs + 4, np.int64)
    for i in range(n):
        start[cell[0, i] + 2] += 1
    for slab in range(1, len(start)):
        start[slab] += start[slab - 1]
    row = np.empty(n, np.int32)
    for i in range(n):
        own = cell[0, i] + 1
        row[start[own]] = i
        start[own] += 1
    # Points of a slab now begin where those of the one before end.
    held, high = np.zeros(across * up, np.int32), np.uint64(up)
    for slab in range(slabs + 1):
        for at in range(start[slab + 1], start[slab + 2]):
            _add(held, cell, row[at], high, np.int32(1))
        for at in range(start[slab], start[slab + 1]):
            own = row[at]
            out[own] = held[np.uint64(cell[1, own]) * high + np.uint64(cell[2, own])]
        for at in range(start[max(slab - 1, 0)], start[slab]):
            _add(held, cell, row[at], high, np.int32(-1))
