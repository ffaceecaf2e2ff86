"""Cells: squares of an absolute grid, what each owns and what it reads around it.

``denoise`` takes k x k tiles, one k for the survey, and labels and rasters are the same whatever k
is; the steps after it take ``ground.cell_m``. Cells at a survey's edge may own more.

Each square is read with a margin. Where a survey enters a column or a row of squares by no more
than that margin, the next one reads all of it anyway, and owns it too: alone it would cost as much
as the margin along it.

What the survey reaches follows from the bounding boxes of its files, so that tiles are free to lie
as they like.
"""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Final, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.plan.task_memory import halo_m, task_bytes
from spl_batch.airborne.settings.workflow import Workflow
from spl_batch.engine.plan.worker_memory import usable_bytes
from spl_batch.engine.tasks.task import Receipt
from spl_batch.lattice.density import Piece
from spl_batch.lattice.tiles import (
    Bounds,
    CellId,
    cell_bounds,
    cells_touching,
    grow,
    overlap,
    parse_cell,
    quanta,
    shared,
)

MOST_ACROSS: Final = 500
"""Raster cells along a square up to which strips are joined [count]: rasters of a joined cell are
made for whole squares, nine of them where a survey is one square with strips all round."""

MOST_TILES: Final = 8
"""Tiles along one side of a cell of ``denoise``, at most [count]: wider ones read hardly less."""

MARGIN_COST: Final = 0.4
"""Time that a point of a margin takes, over that of one that a cell owns: what the quickstart's
cells took."""


def strip_q(workflow: Workflow) -> int:
    """Width up to which a strip belongs to the cell beside it [quanta]."""
    across = quanta(workflow.ground.cell_m) // quanta(workflow.products.cell_m)
    return quanta(workflow.ground.buffer_m) if across <= MOST_ACROSS else 0


class Unit(NamedTuple):
    """A cell that owns points."""

    cell: CellId  #: Its column and row.
    core: Bounds  #: What it owns [quanta].
    tiles: tuple[CellId, ...]  #: Tiles with points in its core or margin.
    points: int  #: Points in those tiles that overlap its core [count].
    held: int  #: Points in its core and margin, as if they spread evenly over each tile [count].


class Grid(NamedTuple):
    """Cells of a survey."""

    edge: int  #: Edge of a square [quanta].
    #: First and last column and row of squares that are cells by themselves.
    low: CellId
    high: CellId
    reached: Bounds  #: What all cells own together, whole squares [quanta].

    @classmethod
    def of_boxes(cls, boxes: Iterable[Sequence[int]], edge: int, strip: int) -> Self:
        """Cells of a survey, by the bounding boxes of its files, half-open [quanta].

        ``edge, strip``: edge of a square, and width up to which a strip is joined [quanta].
        """
        corners = list(zip(*boxes, strict=True)) or [(0,), (0,), (1,), (1,)]
        columns = _axis(min(corners[0]), max(corners[2]), edge, strip)
        rows = _axis(min(corners[1]), max(corners[3]), edge, strip)
        west, east, low_i, high_i = columns
        south, north, low_j, high_j = rows
        reached = Bounds(west * edge, south * edge, (east + 1) * edge, (north + 1) * edge)
        return cls(edge, CellId(low_i, low_j), CellId(high_i, high_j), reached)

    @classmethod
    def of_workflow(cls, boxes: Iterable[Sequence[int]], workflow: Workflow) -> Self:
        """Cells of a survey, by its workflow; see :meth:`of_boxes`."""
        return cls.of_boxes(boxes, quanta(workflow.ground.cell_m), strip_q(workflow))

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

    def units(self, counts: Mapping[CellId, int], tile_q: int, margin: int) -> Iterator[Unit]:
        """Cells that may own points of a tile, with what they read; in their order."""
        touched = {cell for tile in counts for cell in self._of_tile(tile, tile_q)}
        for cell in sorted(touched):
            yield _unit(cell, self.core(cell), counts, tile_q, margin)

    def owners(self, tiles: Iterable[CellId], tile_q: int, margin: int = 0) -> list[str]:
        """Names of the cells that own points of some tiles, or could, and of a margin."""
        return sorted({str(cell) for tile in tiles for cell in self._of_tile(tile, tile_q, margin)})

    def _of_tile(self, tile: CellId, tile_q: int, margin: int = 0) -> Iterable[CellId]:
        """Cells that own points of a tile, or could, each once."""
        squares = cells_touching(grow(cell_bounds(tile, tile_q), margin), self.edge)
        return dict.fromkeys(map(self.keeper, squares))


def _unit(
    cell: CellId, core: Bounds, counts: Mapping[CellId, int], tile_q: int, margin: int
) -> Unit:
    """A cell that owns a core, with what it reads; parameters as of :meth:`Grid.units`."""
    reach = grow(core, margin)
    near = [tile for tile in cells_touching(reach, tile_q) if tile in counts]
    owned = held = 0.0
    for tile in near:
        bounds = cell_bounds(tile, tile_q)
        held += counts[tile] * shared(bounds, reach).area_m2 / bounds.area_m2
        owned += counts[tile] if overlap(bounds, core) else 0
    # shares of tiles add up to whole points, but for the last bit of a sum
    return Unit(cell, core, tuple(near), int(owned), math.ceil(round(held, 6)))


def _axis(first: int, past: int, edge: int, strip: int) -> tuple[int, int, int, int]:
    """First and last column that a survey reaches, and those that are cells by themselves."""
    west, east = first // edge, (past - 1) // edge
    low, high = west, east
    if low < high and (low + 1) * edge - first <= strip:
        low += 1
    if low < high and past - high * edge <= strip:
        high -= 1
    return west, east, low, high


class DenoiseCells(NamedTuple):
    """Cells of ``denoise``, how many own points, and their work, of margins too [points]."""

    grid: Grid
    cells: int
    work: float


def denoise_grid(
    pieces: Sequence[Piece],
    boxes: Sequence[Sequence[int]],
    workflow: Workflow,
    memory_bytes: int,
    workers: int,
) -> DenoiseCells:
    """Cells of ``denoise``.

    Of the k x k tiles that fit with their margin into a worker, even where the survey is densest,
    those with which the workers finish soonest: wide cells read little twice, many of them share
    the work evenly. Tasks in any order take at most ``total / workers + (1 - 1 / workers) x
    longest`` (R. L. Graham, Bounds on multiprocessing timing anomalies, SIAM J. Appl. Math. 17,
    1969), and at most as many times the longest as each worker has tasks.

    Parameters
    ----------
    pieces : sequence of Piece
        Where the points lie.
    boxes : sequence of sequence of int
        Bounding boxes of the files, half-open [quanta].
    workflow : Workflow
        Its ``tiling.block_tiles`` is k where it is given.
    memory_bytes : int
        Limit of a worker [byte].
    workers : int
        Worker processes [count].
    """
    margin, given = quanta(halo_m(workflow)), workflow.tiling.block_tiles
    share, least = 1.0 / max(workers, 1), math.inf
    found = DenoiseCells(Grid.of_boxes(boxes, quanta(workflow.tiling.tile_m), margin), 0, 0.0)
    for side in range(1, MOST_TILES + 1) if given is None else (given,):
        edge = quanta(side * workflow.tiling.tile_m)
        # What lies in a strip is read by the cell beside it already.
        grid = Grid.of_boxes(boxes, edge, margin)
        loads = [_work(piece, grid, margin) for piece in pieces]
        peak = task_bytes("denoise", max((most for *_, most in loads), default=0.0))
        if side > 1 and given is None and peak > usable_bytes(memory_bytes):
            break
        total = math.fsum(float(work.sum()) * each for work, each, _ in loads)
        longest = max((float(work.max(initial=0.0)) for work, *_ in loads), default=0.0)
        cells = sum(int(np.count_nonzero(work) * each) for work, each, _ in loads)
        took = min(share * total + (1.0 - share) * longest, -(-cells // max(workers, 1)) * longest)
        if took < least:
            found, least = DenoiseCells(grid, cells, total), took
    return found


def _work(piece: Piece, grid: Grid, margin: int) -> tuple[NDArray[np.float64], float, float]:
    """Work of the cells that own part of a piece, how many each stands for, most that one reads.

    Work and what is read are in points.
    """
    own, read, there, first = piece.loads(grid.edge, margin)
    most = float(read[there].max(initial=0.0))
    each = (max(piece.edge, grid.edge) / grid.edge) ** 2
    if each == 1.0:
        for axis, (low, high) in enumerate(((grid.low.j, grid.high.j), (grid.low.i, grid.high.i))):
            at = first[1 - axis] + np.arange(own.shape[axis])
            keeper, starts = np.unique(np.clip(at, low, high), return_index=True)
            own = np.add.reduceat(own, starts, axis)
            # A strip that is a piece by itself is read whole; its keeper lies beside the piece.
            read = read.take(keeper - first[1 - axis], axis, mode="clip")
    return np.where(own > 0.0, own + MARGIN_COST * (read - own), 0.0), each, most


def tile_counts(tiles: Mapping[str, Receipt]) -> dict[CellId, int]:
    """Points of each tile that holds some, from the receipts of the built tiles."""
    counts = {parse_cell(name): int(r.facts["points"]) for name, r in tiles.items()}
    return {tile: n for tile, n in sorted(counts.items()) if n}
