"""Highest return of each raster cell that others confirm: noise must not stand out.

Noise that the filter leaves hangs mostly a few metres above dense surfaces, where its
neighbourhoods borrow returns from the surface. A count in one sphere cannot tell it from
a thin crown at the same density of returns in space. Two spheres can:

- *near*: a return on a surface has several others within half a metre, whatever the
  surface's tilt; returns with so many are *dense*.
- *far*: a return in a crown has few that near, but many within two metres that are not
  dense either. Noise above a roof has only other noise: the roof's returns are dense.

Ground returns confirm themselves and nothing else.
"""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

_UNKNOWN, _SPARSE, _DENSE = 0, 1, 2


class Support(NamedTuple):
    """What confirms a return; lengths in quanta.

    Parameters
    ----------
    near, far : int
        Radii of the two spheres.
    near_count, far_count : int
        Returns that they must hold, the confirmed one itself not counted [count].
    near_cells, far_cells : int
        Raster cells to each side that the radii can reach.
    """

    near: int
    far: int
    near_count: int
    far_count: int
    near_cells: int
    far_cells: int


class CellPoints(NamedTuple):
    """Returns in the order of :func:`spl_batch.kernels.raster.sort_into_cells`.

    Parameters
    ----------
    x, y, z : (n,) int32
        Coordinates relative to any anchor [quanta].
    level : (n,) uint8
        Reliability; a return is confirmed only by returns of its own level or a lower one.
    ground : (n,) bool
        Returns that need no confirmation and give none.
    start : (rows * cols + 1,) int64
        Where each cell begins.
    rows, cols : int
        Shape of the raster.
    """

    x: NDArray[np.int32]
    y: NDArray[np.int32]
    z: NDArray[np.int32]
    level: NDArray[np.uint8]
    ground: NDArray[np.bool_]
    start: NDArray[np.int64]
    rows: int
    cols: int


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
def _confirms(points: CellPoints, p: int, q: int, radius: int) -> bool:
    """Whether return q may confirm return p and lies within a radius."""
    if q == p or points.ground[q] or points.level[q] > points.level[p]:
        return False
    dx = np.int64(points.x[q]) - points.x[p]
    dy = np.int64(points.y[q]) - points.y[p]
    dz = np.int64(points.z[q]) - points.z[p]
    return bool(dx * dx + dy * dy + dz * dz <= np.int64(radius) * radius)


@njit(nogil=True, cache=True)
def _dense(
    points: CellPoints, p: int, place: tuple[int, int], by: Support, known: NDArray[np.uint8]
) -> bool:
    """Whether enough returns lie near; remembered in ``known``."""
    if known[p] != _UNKNOWN:
        return bool(known[p] == _DENSE)
    found = 0
    row, col = place
    z0 = np.int64(points.z[p])
    for r in range(max(row - by.near_cells, 0), min(row + by.near_cells + 1, points.rows)):
        for c in range(max(col - by.near_cells, 0), min(col + by.near_cells + 1, points.cols)):
            end = points.start[r * points.cols + c + 1]
            begin = _first_not_above(points.z, points.start[r * points.cols + c], end, z0 + by.near)
            for q in range(begin, end):
                if z0 - points.z[q] > by.near or found >= by.near_count:
                    break
                found += _confirms(points, p, q, by.near)
    known[p] = _DENSE if found >= by.near_count else _SPARSE
    return found >= by.near_count


@njit(nogil=True, cache=True)
def _crowded(
    points: CellPoints, p: int, place: tuple[int, int], by: Support, known: NDArray[np.uint8]
) -> bool:
    """Whether enough returns that are not dense lie in the far sphere."""
    found = 0
    row, col = place
    z0 = np.int64(points.z[p])
    for r in range(max(row - by.far_cells, 0), min(row + by.far_cells + 1, points.rows)):
        for c in range(max(col - by.far_cells, 0), min(col + by.far_cells + 1, points.cols)):
            end = points.start[r * points.cols + c + 1]
            begin = _first_not_above(points.z, points.start[r * points.cols + c], end, z0 + by.far)
            for q in range(begin, end):
                if z0 - points.z[q] > by.far or found >= by.far_count:
                    break
                if _confirms(points, p, q, by.far) and not _dense(points, q, (r, c), by, known):
                    found += 1
    return found >= by.far_count


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
    known = np.zeros(len(points.x), dtype=np.uint8)
    for row in range(points.rows):
        for col in range(points.cols):
            tops[row, col] = np.nan
            cell = row * points.cols + col
            for p in range(points.start[cell], points.start[cell + 1]):
                if (
                    points.ground[p]
                    or _dense(points, p, (row, col), by, known)
                    or _crowded(points, p, (row, col), by, known)
                ):
                    tops[row, col] = points.z[p]
                    break
