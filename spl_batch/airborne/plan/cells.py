"""Cells: squares of the absolute grid, what each owns and what it reads around it.

``denoise`` takes k x k tiles, one k for the survey; the steps after it take ``ground.cell_m``
(:mod:`~spl_batch.airborne.plan.ground_cells`).
Labels and rasters are the same whatever k is.
"""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Final, NamedTuple

from spl_batch.airborne.plan.halo import halo_m
from spl_batch.airborne.plan.task_memory import task_bytes
from spl_batch.airborne.settings.workflow import Workflow
from spl_batch.engine.plan.worker_memory import usable_bytes
from spl_batch.engine.tasks.task import Receipt
from spl_batch.lattice.density import Piece, largest
from spl_batch.lattice.tiles import (
    Bounds,
    BoxIndex,
    CellId,
    cell_bounds,
    cells_touching,
    grow,
    overlap,
    parse_cell,
    quanta,
    shared,
)

MOST_TILES: Final = 8
"""Tiles along one side of a cell of ``denoise``, at most [count]: wider ones read hardly less."""

MARGIN_COST: Final = 0.4
"""Time that a point of a margin takes, over that of one that a cell owns: what the quickstart's
cells took."""


class Unit(NamedTuple):
    """A cell that owns points."""

    name: str
    cell: CellId  #: Its column and row.
    core: Bounds  #: What it owns [quanta].
    tiles: tuple[CellId, ...]  #: Tiles with points in its core or margin.
    points: int  #: Points in those tiles that overlap its core [count].
    held: int  #: Points in its core and margin, as if they spread evenly over each tile [count].


def tiles_along(
    pieces: Sequence[Piece], workflow: Workflow, memory_bytes: int, workers: int
) -> int:
    """Tiles along one side of the cells of ``denoise``.

    Those that fit with their margin into a worker, even where the survey is densest, and of these
    the ones with which the workers finish soonest: wide cells read little twice, many of them
    share the work evenly.

    Parameters
    ----------
    pieces : sequence of Piece
        Where the points lie.
    memory_bytes, workers : int
        Memory limit of a worker [byte], and how many there are.
    """
    if workflow.tiling.block_tiles is not None:
        return workflow.tiling.block_tiles
    tile_m, margin_m = workflow.tiling.tile_m, halo_m(workflow)
    best, least = 1, math.inf
    for side in range(1, MOST_TILES + 1):
        edge_m = side * tile_m
        peak = largest(piece.peak(quanta(edge_m), quanta(margin_m)) for piece in pieces)
        if side > 1 and task_bytes("denoise", peak.points) > usable_bytes(memory_bytes):
            break
        cells = sum(piece.units(quanta(edge_m)) for piece in pieces)
        rounds = -(-cells // max(workers, 1))
        cost = edge_m**2 + MARGIN_COST * ((edge_m + 2.0 * margin_m) ** 2 - edge_m**2)
        if rounds * cost < least:
            best, least = side, rounds * cost
    return best


def tile_counts(tiles: Mapping[str, Receipt]) -> dict[CellId, int]:
    """Points of each tile that holds some, from the receipts of the built tiles."""
    counts = {parse_cell(name): int(r.facts["points"]) for name, r in tiles.items()}
    return {tile: n for tile, n in sorted(counts.items()) if n}


def units(counts: Mapping[CellId, int], tile_q: int, edge: int, margin: int) -> Iterator[Unit]:
    """Cells that may own points of a tile, with what they read; in their order.

    Parameters
    ----------
    counts : mapping of CellId to int
        Points by tile; only tiles that hold some.
    tile_q, edge, margin : int
        Edge of a tile and of a cell, and what a cell reads around its core [quanta].
    """
    touched = {cell for tile in counts for cell in cells_touching(cell_bounds(tile, tile_q), edge)}
    for cell in sorted(touched):
        yield unit_of(cell, cell_bounds(cell, edge), counts, tile_q, margin)


def unit_of(
    cell: CellId, core: Bounds, counts: Mapping[CellId, int], tile_q: int, margin: int
) -> Unit:
    """A cell that owns a core, with what it reads; parameters as of :func:`units`."""
    reach = grow(core, margin)
    near = _occupied(counts, reach, tile_q)
    owned = held = 0.0
    for tile in near:
        bounds = cell_bounds(tile, tile_q)
        held += counts[tile] * _area(shared(bounds, reach)) / tile_q**2
        owned += counts[tile] if overlap(bounds, core) else 0
    # shares of tiles add up to whole points, but for the last bit of a sum
    return Unit(str(cell), cell, core, tuple(near), int(owned), math.ceil(round(held, 6)))


def owners(tiles: Iterable[CellId], tile_q: int, edge: int) -> dict[CellId, list[str]]:
    """Cells that may hold labels of each tile, by tile."""
    return {
        tile: [str(cell) for cell in cells_touching(cell_bounds(tile, tile_q), edge)]
        for tile in tiles
    }


def _occupied(counts: Mapping[CellId, int], region: Bounds, tile_q: int) -> list[CellId]:
    """Tiles with points that share area with a region, row by row."""
    columns = -(-region.xmax // tile_q) - region.xmin // tile_q
    rows = -(-region.ymax // tile_q) - region.ymin // tile_q
    if columns * rows <= len(counts):
        return [t for t in cells_touching(region, tile_q) if t in counts]
    found = (t for t in counts if overlap(cell_bounds(t, tile_q), region))
    return sorted(found, key=lambda t: (t.j, t.i))


def _area(region: Bounds) -> int:
    """Area of a region [quanta2]."""
    return (region.xmax - region.xmin) * (region.ymax - region.ymin)


def fired_index(boxes: Mapping[str, Sequence[int]]) -> BoxIndex:
    """Stretches by the place that they fired at.

    ``boxes``: rectangle of each stretch near the ground: xmin, ymin, xmax, ymax [m].
    """
    return BoxIndex({name: Bounds(*map(quanta, box)) for name, box in boxes.items()})


def voxel_index(boxes: Mapping[str, Sequence[int]], voxel_q: int) -> BoxIndex:
    """Stretches by the place of their voxel parts.

    ``boxes``: first and past-the-last voxel index of each part: x, y, z, x, y, z.
    """
    return BoxIndex(
        {
            name: Bounds(x0 * voxel_q, y0 * voxel_q, x1 * voxel_q, y1 * voxel_q)
            for name, (x0, y0, _, x1, y1, _) in boxes.items()
        }
    )
