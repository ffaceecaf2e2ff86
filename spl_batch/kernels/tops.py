"""Highest return of each raster cell that others confirm: noise must not stand out.

Noise that the filter leaves hangs mostly a few metres above dense surfaces and crowns,
where its neighbourhood borrows their returns. A count in one sphere cannot tell it from a
thin crown. Several spheres can: a return counts for a larger sphere only where no smaller
one confirms it. A roof is confirmed within half a metre, whatever its tilt, a dense crown
within a metre, a thin one within two; noise above a roof or a dense crown then has only
other noise to confirm it.

Ground returns confirm themselves and nothing else.
"""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

_UNKNOWN, _NO, _YES = 0, 1, 2


class Support(NamedTuple):
    """What confirms a return: spheres, the smallest first.

    Parameters
    ----------
    radius : (s,) int64
        Radii [quanta].
    needed : (s,) int64
        Returns that each must hold, the confirmed one itself not counted [count].
    cells : (s,) int64
        Raster cells to each side that each can reach [count].
    """

    radius: NDArray[np.int64]
    needed: NDArray[np.int64]
    cells: NDArray[np.int64]


class CellPoints(NamedTuple):
    """Returns in the order of :func:`spl_batch.kernels.raster.sort_into_cells`.

    Parameters
    ----------
    x, y, z : (n,) int32
        Coordinates relative to the raster's south-west corner [quanta].
    level : (n,) uint8
        Reliability; a return is confirmed only by returns of its own level or a lower one.
    ground : (n,) bool
        Returns that need no confirmation and give none.
    start : (rows * cols + 1,) int64
        Where each cell begins.
    rows, cols : int
        Shape of the raster.
    size : int
        Edge of a cell [quanta]; x and y count from the raster's corner.
    """

    x: NDArray[np.int32]
    y: NDArray[np.int32]
    z: NDArray[np.int32]
    level: NDArray[np.uint8]
    ground: NDArray[np.bool_]
    start: NDArray[np.int64]
    rows: int
    cols: int
    size: int


@njit(nogil=True, cache=True)
def _first_not_above(z: NDArray[np.int32], begin: int, end: int, top: np.int64) -> int:
    """First place of a falling run whose height is not above ``top``."""
    while begin < end:
        middle = (begin + end) // 2
        if z[middle] > top:
            begin = middle + 1
        else:
            end = middle
    return begin


@njit(nogil=True, cache=True)
def _may_confirm(points: CellPoints, p: int, q: int, radius: int) -> bool:
    """Whether return q may confirm return p and lies within a radius."""
    if q == p or points.ground[q] or points.level[q] > points.level[p]:
        return False
    dx = np.int64(points.x[q]) - points.x[p]
    dy = np.int64(points.y[q]) - points.y[p]
    dz = np.int64(points.z[q]) - points.z[p]
    return bool(dx * dx + dy * dy + dz * dz <= np.int64(radius) * radius)


@njit(nogil=True, cache=True)
def _confirmed(
    points: CellPoints, p: int, scale: int, by: Support, known: NDArray[np.uint8]
) -> bool:
    """Whether one sphere holds enough returns that no smaller one confirms."""
    if known[p, scale] != _UNKNOWN:
        return bool(known[p, scale] == _YES)
    found = 0
    radius, reach, needed = by.radius[scale], by.cells[scale], by.needed[scale]
    row, col = points.y[p] // points.size, points.x[p] // points.size
    z0 = np.int64(points.z[p])
    for r in range(max(row - reach, 0), min(row + reach + 1, points.rows)):
        for c in range(max(col - reach, 0), min(col + reach + 1, points.cols)):
            cell = r * points.cols + c
            end = points.start[cell + 1]
            for q in range(_first_not_above(points.z, points.start[cell], end, z0 + radius), end):
                if z0 - points.z[q] > radius or found >= needed:
                    break
                if _may_confirm(points, p, q, radius):
                    free = True
                    for smaller in range(scale):
                        free = free and not _confirmed(points, q, smaller, by, known)
                    found += free
    known[p, scale] = _YES if found >= needed else _NO
    return bool(found >= needed)


@njit(nogil=True, cache=True)
def supported_tops(points: CellPoints, by: Support, tops: NDArray[np.float64]) -> None:
    """Height of the highest confirmed return of each cell.

    Parameters
    ----------
    points : CellPoints
        Returns by cell, highest first.
    by : Support
        What confirms a return.
    tops : (rows, cols) float64, written
        Heights [quanta]; NaN where no return is confirmed.
    """
    known = np.zeros((len(points.x), len(by.radius)), dtype=np.uint8)
    for row in range(points.rows):
        for col in range(points.cols):
            tops[row, col] = np.nan
            cell = row * points.cols + col
            for p in range(points.start[cell], points.start[cell + 1]):
                accepted = points.ground[p]
                for scale in range(len(by.radius)):
                    accepted = accepted or _confirmed(points, p, scale, by, known)
                if accepted:
                    tops[row, col] = points.z[p]
                    break
