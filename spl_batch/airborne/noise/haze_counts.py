"""Kernels of :mod:`~spl_batch.airborne.noise.haze`: cubes counted, their quarters, noise raised."""

import math

import numpy as np

from spl_batch.numerics.compiled import njit
from spl_batch.numerics.sorting import sort


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


@njit()
def quarters(  # type: ignore[no-untyped-def]
    count, asked, half, rank, lower, upper
):
    """Count that all but ``rank`` cubes of the square around each asked cube reach, or do not."""
    nx, ny, layers = count.shape
    held = np.empty((2 * half + 1) ** 2, np.int64)
    for i in range(half, nx - half):
        for j in range(half, ny - half):
            for h in range(layers):
                if asked[i, j, h]:
                    n = 0
                    for a in range(i - half, i + half + 1):
                        for b in range(j - half, j + half + 1):
                            held[n] = count[a, b, h]
                            n += 1
                    sort(held)
                    lower[i, j, h], upper[i, j, h] = held[rank], held[len(held) - 1 - rank]


@njit()
def raise_to(x, y, z, edge, low, density, out):  # type: ignore[no-untyped-def]
    """Put the density of a point's cube where it is larger."""
    nx, ny, nz = density.shape
    for p in range(len(out)):
        i, j, k = x[p] // edge - low[0], y[p] // edge - low[1], z[p] // edge - low[2]
        if 0 <= i < nx and 0 <= j < ny and 0 <= k < nz:
            out[p] = max(out[p], density[i, j, k])
