"""Nearest of some points in the plane, by rings of the cells of a grid.

Points of nodes, of raster cells and of returns lie fairly evenly: a grid whose cells hold two of
them finds what is near sooner than a tree, is made faster, and equally near ones come by number.
Where points lie unevenly answers are the same.
"""

import math
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.numerics.cell_groups import group_by_cell
from spl_batch.numerics.compiled import njit
from spl_batch.numerics.neighbours.kdtree import U0, U1

PER_CELL: Final = 2.0
"""Points in a cell, on the average [count]; speed only."""

FULLEST: Final = 64
"""Cells become smaller where one holds more, while they are few [count]; speed only."""

_SURELY: Final = 1.0 - 1e-6
"""Part of a ring's distance within which all was seen: a quotient that gives a cell is rounded."""

Float = NDArray[np.float64]
Index = NDArray[np.int64]


class PointGrid(NamedTuple):
    """Points by cell, row by row."""

    #: (n,): coordinates and number of each point.
    x: Float
    y: Float
    number: Index
    start: Index  #: (rows * columns + 1,): where each cell begins in them.
    shape: tuple[int, int]  #: Rows and columns.
    corner: tuple[int, int]  #: Row and column of the first cell, from the origin.
    edge: float  #: Edge of a cell [unit of the points].

    @classmethod
    def of(cls, points: Float) -> "PointGrid":
        """Grid of some points.

        Parameters
        ----------
        points : (n, 2) float64
            Points, finite, n > 0; further columns do not count.
        """
        x, y = points[:, 0].copy(), points[:, 1].copy()
        wide, high, share = float(np.ptp(x)), float(np.ptp(y)), PER_CELL / len(x)
        edge = max(math.sqrt(share * wide * high), share * max(wide, high)) or 1.0
        cells = group_by_cell(x, y, edge)
        # Where some lie far from the others, cells of the average would hold too many of these.
        for _ in range(3):
            if np.diff(cells.start).max() > FULLEST and cells.rows * cells.columns < 4 * len(x):
                edge /= 2.0
                cells = group_by_cell(x, y, edge)
        corner = math.floor(y.min() / edge), math.floor(x.min() / edge)
        x, y = x[cells.order], y[cells.order]
        return cls(x, y, cells.order, cells.start, (cells.rows, cells.columns), corner, edge)

    def nearest(
        self, asked: NDArray[np.floating[Any]], count: int = 1, reach: float = math.inf
    ) -> Index:
        """Numbers of the nearest points, nearest first: (m, count) int64; -1 where there is none.

        Parameters
        ----------
        asked : (m, 2) float64
            Where neighbours are asked for, anywhere, near ones following each other; further
            columns do not count.
        count : int
            Neighbours of each, at least 1 [count].
        reach : float
            They are nearer than this [unit of the points].
        """
        found = np.full((len(asked), count), -1, np.int64)
        _nearest(self, np.ascontiguousarray(asked[:, :2], np.float64), float(reach), found)
        return found


@njit()
def _nearest(grid: PointGrid, asked: Float, reach: float, out: Index) -> None:
    """Fill; -1 at first."""
    xs, ys, number, start, (rows, columns), corner, edge = grid
    farthest = max(rows, columns)
    away2 = np.empty(out.shape[1])
    for i in range(len(asked)):
        x, y, nearest = asked[i, 0], asked[i, 1], out[i]
        row, column = int(np.floor(y / edge)) - corner[0], int(np.floor(x / edge)) - corner[1]
        # Rings nearer than the grid are empty.
        ring = max(0, -row, row - rows + 1, -column, column - columns + 1)
        last, seen2, inner = ring + farthest, (_SURELY * max(ring - 1, 0) * edge) ** 2, -1
        away2[:] = reach * reach
        while ring <= last and seen2 < away2[-1]:
            for r in range(max(row - ring, 0), min(row + ring, rows - 1) + 1):
                # Of a row of cells those to the west of what was seen, and those to the east.
                seen = inner if abs(r - row) <= inner else -1
                for west, east in (
                    (column - ring, column - seen - 1 if seen >= 0 else column + ring),
                    (column + seen + 1, column + ring if seen >= 0 else column - 1),
                ):
                    low, high = max(west, 0), min(east, columns - 1)
                    if low <= high:
                        first, end = start[r * columns + low], start[r * columns + high + 1]
                        _sort_in(xs, ys, number, first, end, x, y, away2, nearest)
            seen2, inner = (_SURELY * ring * edge) ** 2, ring
            ring += 1


@njit(inline="always")
def _sort_in(xs, ys, number, first, end, x, y, away2, nearest):  # type: ignore[no-untyped-def]
    """Sort the points of some cells in among the nearest."""
    last = np.uint64(len(away2) - 1)
    for p in range(np.uint64(first), np.uint64(end)):
        dx, dy = xs[p] - x, ys[p] - y
        distance2, own = dx * dx + dy * dy, number[p]
        if distance2 > away2[last] or (distance2 == away2[last] and own >= nearest[last]):
            continue
        k = last
        while k > U0 and (
            distance2 < away2[k - U1] or (distance2 == away2[k - U1] and own < nearest[k - U1])
        ):
            away2[k], nearest[k] = away2[k - U1], nearest[k - U1]
            k -= U1
        away2[k], nearest[k] = distance2, own
