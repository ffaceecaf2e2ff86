"""Ground cells: squares of an absolute grid, of which those at a survey's edge own a strip more.

A TIN is known where its surroundings are, so each square is read with a buffer. Where a survey
enters a column or a row of squares by no more than that buffer, the next one reads all of it
anyway, and owns it too: alone a strip costs as much as the buffer along it.

What the survey reaches is told by the bounding boxes of its files, so that tiles and blocks are
free to lie as they like.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import NamedTuple, Self

from spl_batch.plan.space import Unit, unit_within
from spl_batch.task import Receipt
from spl_batch.tiling import Bounds, CellId, cell_bounds, cells_touching


class GroundCells(NamedTuple):
    """Ground cells of a survey.

    Parameters
    ----------
    edge : int
        Edge of a square [quanta].
    low, high : CellId
        First and last column and row of squares that are cells by themselves.
    reached : Bounds
        What all cells own together, whole squares [quanta].
    """

    edge: int
    low: CellId
    high: CellId
    reached: Bounds

    @classmethod
    def of_boxes(cls, boxes: Iterable[Sequence[int]], edge: int, buffer: int) -> Self:
        """Cells of a survey.

        Parameters
        ----------
        boxes : iterable of (xmin, ymin, xmax, ymax)
            Bounding boxes of its files, half-open [quanta].
        edge, buffer : int
            Edge of a square and its buffer [quanta].
        """
        corners = list(zip(*boxes, strict=True)) or [(0,), (0,), (1,), (1,)]
        columns = _axis(min(corners[0]), max(corners[2]), edge, buffer)
        rows = _axis(min(corners[1]), max(corners[3]), edge, buffer)
        west, east, low_i, high_i = columns
        south, north, low_j, high_j = rows
        reached = Bounds(west * edge, south * edge, (east + 1) * edge, (north + 1) * edge)
        return cls(edge, CellId(low_i, low_j), CellId(high_i, high_j), reached)

    @property
    def alone(self) -> Bounds:
        """Squares that are cells by themselves [quanta]."""
        east, north = self.high.i + 1, self.high.j + 1
        corners = self.low.i, self.low.j, east, north
        return Bounds(*(corner * self.edge for corner in corners))

    def keeper(self, square: CellId) -> CellId:
        """Cell that owns a square of the grid."""
        return CellId(
            min(max(square.i, self.low.i), self.high.i), min(max(square.j, self.low.j), self.high.j)
        )

    def core(self, cell: CellId) -> Bounds:
        """What a cell owns, whole squares [quanta]."""
        alone = cell_bounds(cell, self.edge)
        return Bounds(
            alone.xmin if cell.i > self.low.i else self.reached.xmin,
            alone.ymin if cell.j > self.low.j else self.reached.ymin,
            alone.xmax if cell.i < self.high.i else self.reached.xmax,
            alone.ymax if cell.j < self.high.j else self.reached.ymax,
        )

    def squares(self, cell: CellId) -> Iterator[CellId]:
        """Squares that a cell owns, row by row."""
        return cells_touching(self.core(cell), self.edge)

    def units(self, counts: Mapping[CellId, int], tile_q: int, halo_q: int) -> Iterator[Unit]:
        """Cells that share area with a tile, with what they read; in their order.

        Parameters
        ----------
        counts : mapping of CellId to int
            Points by tile.
        tile_q, halo_q : int
            Edge of a tile, and what a cell reads around its core [quanta].
        """
        touched = {cell for tile in counts for cell in self._of_tile(tile, tile_q)}
        for cell in sorted(touched):
            yield unit_within(self.core(cell), counts, tile_q, halo_q, (str(cell), cell))

    def owners(
        self, tiles: Iterable[CellId], tile_q: int, done: Mapping[str, Receipt]
    ) -> dict[CellId, list[str]]:
        """Finished cells that may hold labels of each tile, by tile."""
        return {
            tile: [str(cell) for cell in self._of_tile(tile, tile_q) if str(cell) in done]
            for tile in tiles
        }

    def _of_tile(self, tile: CellId, tile_q: int) -> Iterable[CellId]:
        """Cells that share area with a tile, each once."""
        squares = cells_touching(cell_bounds(tile, tile_q), self.edge)
        return dict.fromkeys(map(self.keeper, squares))


def _axis(first: int, past: int, edge: int, buffer: int) -> tuple[int, int, int, int]:
    """First and last column that a survey reaches, and those that are cells by themselves."""
    west, east = first // edge, (past - 1) // edge
    low, high = west, east
    if low < high and (low + 1) * edge - first <= buffer:
        low += 1
    if low < high and past - high * edge <= buffer:
        high -= 1
    return west, east, low, high
