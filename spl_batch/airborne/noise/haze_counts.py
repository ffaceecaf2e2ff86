"""Returns of cubes, and their pairs in columns and cells, in which haze is looked for."""

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.lattice.tiles import quanta
from spl_batch.numerics.compiled import njit

CUBE_M: Final = 5.0
"""Edge of a cube [m]: air changes over tens of metres."""

CELL_M: Final = 1.0
"""Edge of the cells in which clumping is looked for [m]."""

WINDOW: Final = 5
"""Cubes along the edge of a square that is looked at."""

Axes = tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]


class Counts(NamedTuple):
    """Returns of cubes, and their pairs in columns and cells."""

    corner: tuple[int, int]  #: Index of the first cube along x and y on the absolute lattice.
    layer: NDArray[np.int64]  #: (l,): index of each layer; those without a return are left out.
    held: NDArray[np.int32]  #: (nx, ny, l): returns [count].
    #: (nx, ny, l): ordered pairs of them that share a column, and a cell.
    columns: NDArray[np.int64]
    cells: NDArray[np.int64]


def count_cubes(xyz: Axes, counted: NDArray[np.bool_]) -> Counts | None:
    """Returns of each cube, and their pairs; None where nothing counts.

    They are counted strip by strip, with half a square of empty cubes around: edges of the points
    and ragged edges within them are treated alike.

    Parameters
    ----------
    xyz : three of (n,) integer
        Absolute coordinates [quanta].
    counted : (n,) bool
        Returns that count: independent ones.
    """
    rows = np.flatnonzero(counted)
    if not len(rows):
        return None
    x, y, z = (axis[rows].astype(np.int64, copy=False) for axis in xyz)
    del rows
    edge, half = quanta(CUBE_M), WINDOW // 2
    west, south = (int(axis.min()) // edge - half for axis in (x, y))
    nx, ny = (
        int(axis.max()) // edge - low + 1 + half
        for axis, low in zip((x, y), (west, south), strict=True)
    )
    layer, at = _numbered((z // edge).astype(np.int32))
    strip = (x // edge - west).astype(np.int32)
    order = np.argsort(strip, kind="stable")
    start = np.append(0, np.cumsum(np.bincount(strip, minlength=nx)))
    del strip
    shape = (nx, ny, len(layer))
    count = np.zeros(shape, np.int32)
    columns, cells = np.zeros(shape, np.int64), np.zeros(shape, np.int64)
    parts = round(CUBE_M / CELL_M)
    room = np.zeros((ny, len(layer), parts, parts, parts), np.int32)
    count_strips(
        x, y, z, at, order, start, edge, quanta(CELL_M), south,
        room, count, columns, cells,
    )  # fmt: skip
    return Counts((west, south), layer, count, columns, cells)


def _numbered(index: NDArray[np.int32]) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """Indices that occur, ascending, and which of them each is; without sorting all."""
    low = int(index.min())
    index = index - low
    held = np.zeros(int(index.max()) + 1, np.bool_)
    held[index] = True
    number = np.cumsum(held, dtype=np.int32) - 1
    return np.flatnonzero(held) + low, number[index]


@njit(inline="always")
def _placed(v, edge, cubes, cells_of):  # type: ignore[no-untyped-def]
    """Cube of a coordinate [quanta], and which of its cells; quicker than whole quotients.

    ``cubes, cells_of``: of a quantum. In the middle of its quantum no quotient is near a whole one.
    """
    cube = np.int64(math.floor((v + 0.5) * cubes))
    return cube, np.int64((v - cube * edge + 0.5) * cells_of)


@njit()
def count_strips(  # type: ignore[no-untyped-def]
    x, y, z, layer, order, start, edge, cell, south, room, count, columns, cells
):
    """Returns of each cube, and the pairs of them that share a column or a cell."""
    parts, cubes, cells_of = room.shape[2], 1.0 / edge, 1.0 / cell
    for i in range(len(start) - 1):
        if start[i] == start[i + 1]:
            continue
        room[:] = 0
        for k in range(start[i], start[i + 1]):
            p = order[k]
            _, a = _placed(x[p], edge, cubes, cells_of)
            j, b = _placed(y[p], edge, cubes, cells_of)
            _, c = _placed(z[p], edge, cubes, cells_of)
            j -= south
            room[j, layer[p], a, b, c] += 1
            count[i, j, layer[p]] += 1
        for j in range(count.shape[1]):
            for h in range(count.shape[2]):
                if count[i, j, h] < 2:
                    continue
                in_columns, in_cells = np.int64(0), np.int64(0)
                for a in range(parts):
                    for b in range(parts):
                        total = np.int64(0)
                        for c in range(parts):
                            n = np.int64(room[j, h, a, b, c])
                            total += n
                            in_cells += n * (n - 1)
                        in_columns += total * (total - 1)
                columns[i, j, h], cells[i, j, h] = in_columns, in_cells
