"""Density of a survey's points by location: counts in cells of the tile grid, and what units hold.

Before any work, it follows from headers: a file's points spread evenly over its bounding box, and
overlaps add up. After the shuffle it follows from the tiles. A survey is a few dense pieces, so
that a million tiles are a few arrays.
"""

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.lattice.tiles import Bounds, CellId, far_apart

MAX_CELLS = 8_000_000
"""Cells of a piece; a larger one is counted in cells of twice the edge, and so on."""

FEW_CELLS = 4096
"""Cells that a piece may have, however few its points; beyond, no more cells than points."""

FAR_Q = 10_000_000
"""Straight gap beyond which what lies on either side is a piece of its own [quanta]."""

_TOUCHED = 1e-6
"""Share of a cell that counts as none: what sums of shares leave of nothing."""


class Box(NamedTuple):
    """Points that lie somewhere in a rectangle."""

    bounds: Bounds
    points: float


class Peak(NamedTuple):
    """The unit that reads most points."""

    points: float  #: Points in its core and halo [count].
    core: Bounds


@dataclass(frozen=True)
class Piece:
    """Points in cells of an absolute grid over one rectangle."""

    edge: int  #: Edge of a cell [quanta].
    first: CellId  #: Column and row of the first cell.
    points: NDArray[np.float64]  #: (rows, columns): points of each cell [count].
    touched: NDArray[np.bool_]  #: (rows, columns): cells that belong to the survey.

    def units(self, unit_q: int) -> int:
        """Units of an absolute grid that own part of a cell of the survey [count]."""
        step = max(unit_q, self.edge)
        there = self._sums(self._total_touched, step, (step, 0)) > _TOUCHED
        if step == unit_q:
            return int(np.count_nonzero(there))
        points = self._sums(self._total, step, (step, 0))[there]
        each = math.ceil((step / unit_q) ** 2)  # no more units hold points than there are points
        return int(np.minimum(each, np.maximum(np.ceil(points), 1.0)).sum())

    def peak(self, unit_q: int, halo_q: int) -> Peak:
        """The unit that reads most, of those that own part of the survey.

        Where cells are larger than units, one unit of each cell is looked at.

        Parameters
        ----------
        unit_q, halo_q : int
            Edge of a unit and its halo [quanta].
        """
        step = max(unit_q, self.edge)
        _, read, there, first = self.loads(unit_q, halo_q)
        read[~there] = -1.0
        row, column = np.unravel_index(int(np.argmax(read)), read.shape)
        west, south = (first.i + int(column)) * step, (first.j + int(row)) * step
        return Peak(float(read[row, column]), Bounds(west, south, west + unit_q, south + unit_q))

    def loads(
        self, unit_q: int, halo_q: int
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_], CellId]:
        """Points of each unit, and with its halo; which own part of the survey; the first unit.

        Three (rows, columns); units that own none have no points of their own. Where cells are
        larger than units, one unit of each cell is looked at. Parameters as of :meth:`peak`.
        """
        step = max(unit_q, self.edge)
        own, read = (self._sums(self._total, step, (unit_q, reach)) for reach in (0, halo_q))
        there = self._sums(self._total_touched, step, (step, 0)) > _TOUCHED
        first = CellId(self.first.i * self.edge // step, self.first.j * self.edge // step)
        return np.where(there, own, 0.0), read, there, first

    @cached_property
    def _total(self) -> NDArray[np.float64]:
        return _integral(self.points)

    @cached_property
    def _total_touched(self) -> NDArray[np.float64]:
        return _integral(self.touched.astype(np.float64))

    def _sums(
        self, total: NDArray[np.float64], step: int, reach: tuple[int, int]
    ) -> NDArray[np.float64]:
        """Points of square units, one every ``step``; ``reach``: their edge, and the halo."""
        return self._between(self._between(total, 0, step, reach), 1, step, reach)

    def _between(
        self, total: NDArray[np.float64], axis: int, step: int, reach: tuple[int, int]
    ) -> NDArray[np.float64]:
        """Differences of running totals over the extents of all units along one axis."""
        first, number = self.first[1 - axis], total.shape[axis] - 1
        unit_q, halo_q = reach
        units = np.arange(first * self.edge // step, -(-(first + number) * self.edge // step))
        low = (units * step - halo_q) / self.edge - first
        high = (units * step + unit_q + halo_q) / self.edge - first
        return _at(total, high, axis) - _at(total, low, axis)


def from_boxes(boxes: Iterable[Box], edge: int) -> Iterator[Piece]:
    """Pieces of a survey whose points spread evenly over some rectangles.

    Parameters
    ----------
    boxes : iterable of Box
        Bounding boxes of the input files and their points.
    edge : int
        Edge of a tile [quanta].
    """
    known = [box for box in boxes if box.points]
    corners = np.array([box.bounds for box in known], np.int64).reshape(-1, 4)
    for group in map(np.sort, far_apart(corners[:, :2], FAR_Q, corners[:, 2:])):
        part, ends = [known[row] for row in group], corners[group]
        hull = Bounds(*ends[:, :2].min(axis=0).tolist(), *ends[:, 2:].max(axis=0).tolist())
        sides = hull.xmax - hull.xmin, hull.ymax - hull.ymin
        size = _coarse(*sides, edge, math.fsum(box.points for box in part))
        first = CellId(hull.xmin // size, hull.ymin // size)
        shape = (-(-hull.ymax // size) - first.j, -(-hull.xmax // size) - first.i)
        points, touched = np.zeros(shape), np.zeros(shape, dtype=np.bool_)
        for box in part:
            rows, of_rows = _shares(box.bounds.ymin, box.bounds.ymax, size, first.j)
            columns, of_columns = _shares(box.bounds.xmin, box.bounds.xmax, size, first.i)
            points[rows, columns] += np.outer(of_rows * box.points, of_columns)
            touched[rows, columns] = True
        yield Piece(size, first, points, touched)


def from_counts(counts: Mapping[CellId, int], edge: int) -> Iterator[Piece]:
    """Pieces of a survey whose points are counted by tile.

    ``edge``: edge of a tile [quanta].
    """
    cells = np.fromiter((v for cell in counts for v in cell), np.int64, 2 * len(counts))
    cells = cells.reshape(-1, 2)
    values = np.fromiter(counts.values(), np.float64, len(counts))
    for rows in far_apart(cells, max(FAR_Q // edge, 1)):
        extent = (np.ptp(cells[rows], axis=0) + 1) * edge
        size = _coarse(int(extent[0]), int(extent[1]), edge, math.fsum(values[rows]))
        coarse = cells[rows] * edge // size
        low, high = coarse.min(axis=0), coarse.max(axis=0)
        points = np.zeros((high - low + 1)[::-1])
        np.add.at(points, (coarse[:, 1] - low[1], coarse[:, 0] - low[0]), values[rows])
        yield Piece(size, CellId(int(low[0]), int(low[1])), points, points > 0)


def largest(peaks: Iterable[Peak]) -> Peak:
    """Peak with most points, the first of equals; of none, one that reads nothing."""
    return max(peaks, key=lambda peak: peak.points, default=Peak(0.0, Bounds(0, 0, 0, 0)))


def _integral(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Running totals with a leading row and column of zeros."""
    total = np.zeros((values.shape[0] + 1, values.shape[1] + 1))
    np.cumsum(values, axis=0, out=total[1:, 1:])
    np.cumsum(total[1:, 1:], axis=1, out=total[1:, 1:])
    return total


def _at(total: NDArray[np.float64], at: NDArray[np.float64], axis: int) -> NDArray[np.float64]:
    """Running totals at fractional positions along an axis; constant beyond its ends."""
    at = np.clip(at, 0.0, total.shape[axis] - 1)
    low = np.minimum(at.astype(np.int64), total.shape[axis] - 2)
    share = np.expand_dims(at - low, 1 - axis)
    before, after = np.take(total, low, axis), np.take(total, low + 1, axis)
    found: NDArray[np.float64] = before + (after - before) * share
    return found


def _shares(low: int, high: int, size: int, first: int) -> tuple[slice, NDArray[np.float64]]:
    """Cells that an extent touches, and the share of it that lies in each."""
    start, stop = low // size, -(-high // size)
    edges = np.clip(np.arange(start, stop + 1, dtype=np.float64) * size, low, high)
    return slice(start - first, stop - first), np.diff(edges) / (high - low)


def _coarse(width: int, height: int, edge: int, points: float) -> int:
    """Edge of cells that are few enough: the tile's, or a power of two of it."""
    size, most = edge, min(MAX_CELLS, max(points, FEW_CELLS))
    while width / size * (height / size) > most:
        size *= 2
    return size
