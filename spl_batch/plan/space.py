"""Tiles, blocks and ground cells: which points each unit of the space domain reads."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from spl_batch.plan.density import Piece, largest
from spl_batch.plan.memory import halo_m, points_within
from spl_batch.runner.space_domain import parse_cell
from spl_batch.task import Receipt
from spl_batch.tiling import (
    Bounds,
    BoxIndex,
    CellId,
    cell_bounds,
    cells_touching,
    grow,
    overlap,
    quanta,
)
from spl_batch.workflow import Workflow

MAX_BLOCK_TILES = 8
"""Tiles along one side of a block, at most [count]."""

BLOCK_SHARE = 0.9
"""Part of the points that a worker can hold which a block of several tiles may have: within
a tile they may lie on the side of the halo."""


@dataclass(frozen=True, slots=True)
class Unit:
    """A work unit of the space domain.

    Parameters
    ----------
    cell : CellId
        Column and row on its absolute grid.
    core : Bounds
        What it owns.
    tiles : tuple of CellId
        Tiles with points in its core or halo.
    points : int
        Points in those tiles that overlap its core [count].
    held : int
        Points in its core and halo, as if they spread evenly over each tile [count].
    """

    cell: CellId
    core: Bounds
    tiles: tuple[CellId, ...]
    points: int
    held: int


def tile_counts(tiles: Mapping[str, Receipt]) -> dict[CellId, int]:
    """Points of each tile that holds some, from the receipts of the built tiles."""
    counts = {parse_cell(name): int(r.facts["points"]) for name, r in tiles.items()}
    return {tile: n for tile, n in sorted(counts.items()) if n}


def units(counts: Mapping[CellId, int], tile_q: int, unit_q: int, halo_q: int) -> Iterator[Unit]:
    """Units of an absolute grid that own points, one by one in the order of their cells.

    Parameters
    ----------
    counts : mapping of CellId to int
        Points by tile.
    tile_q, unit_q : int
        Edges of a tile and of a unit [quanta].
    halo_q : int
        Halo that a unit reads [quanta].
    """
    for cell in _cells_with_points(counts, tile_q, unit_q):
        core = cell_bounds(cell, unit_q)
        near = [t for t in cells_touching(grow(core, halo_q), tile_q) if t in counts]
        owned = held = 0.0
        for tile in near:
            bounds = cell_bounds(tile, tile_q)
            held += counts[tile] * _shared(bounds, grow(core, halo_q)) / tile_q**2
            owned += counts[tile] if overlap(bounds, core) else 0
        yield Unit(cell, core, tuple(near), int(owned), math.ceil(held))


def _cells_with_points(counts: Mapping[CellId, int], tile_q: int, unit_q: int) -> list[CellId]:
    """Cells of units that share area with a tile, sorted."""
    cells: set[CellId] = set()
    for tile in counts:
        cells.update(cells_touching(cell_bounds(tile, tile_q), unit_q))
    return sorted(cells)


def _shared(a: Bounds, b: Bounds) -> int:
    """Area that two regions share [quanta2]."""
    width = min(a.xmax, b.xmax) - max(a.xmin, b.xmin)
    height = min(a.ymax, b.ymax) - max(a.ymin, b.ymin)
    return max(width, 0) * max(height, 0)


def choose_block_tiles(
    pieces: Sequence[Piece], workflow: Workflow, memory_bytes: int, workers: int
) -> int:
    """Tiles along one side of a denoise block: as many as memory and the workers allow.

    A larger block reads less halo; but every worker should have several blocks.

    Parameters
    ----------
    pieces : sequence of Piece
        Where the points lie.
    workflow : Workflow
        The settings.
    memory_bytes : int
        Memory limit of a worker [byte].
    workers : int
        Worker processes [count].
    """
    if workflow.tiling.block_tiles is not None:
        return workflow.tiling.block_tiles
    tile_q = quanta(workflow.tiling.tile_m)
    halo_q = quanta(halo_m(workflow))
    budget = points_within("denoise", memory_bytes) * BLOCK_SHARE
    best = 1
    for n in range(2, MAX_BLOCK_TILES + 1):
        heaviest = largest(piece.peak(n * tile_q, halo_q) for piece in pieces)
        blocks = sum(piece.units(n * tile_q) for piece in pieces)
        if heaviest.points > budget or blocks < 3 * workers:
            break
        best = n
    return best


def owners(
    tiles: Iterable[CellId], tile_q: int, unit_q: int, done: Mapping[str, Receipt]
) -> dict[CellId, list[str]]:
    """Finished units that may hold labels of each tile, by tile."""
    return {
        tile: [
            str(cell)
            for cell in cells_touching(cell_bounds(tile, tile_q), unit_q)
            if str(cell) in done
        ]
        for tile in tiles
    }


def fired_index(boxes: Mapping[str, Sequence[int]]) -> BoxIndex:
    """Stretches by the place that they fired at.

    Parameters
    ----------
    boxes : mapping of str to sequence of int
        Rectangle of each stretch near the ground: xmin, ymin, xmax, ymax [m].
    """
    return BoxIndex({name: Bounds(*map(quanta, box)) for name, box in boxes.items()})


def voxel_index(boxes: Mapping[str, Sequence[int]], voxel_q: int) -> BoxIndex:
    """Stretches by the place of their voxel parts.

    Parameters
    ----------
    boxes : mapping of str to sequence of int
        First and past-the-last voxel index of each part: x, y, z, x, y, z.
    voxel_q : int
        Edge of a voxel [quanta].
    """
    return BoxIndex(
        {
            name: Bounds(x0 * voxel_q, y0 * voxel_q, x1 * voxel_q, y1 * voxel_q)
            for name, (x0, y0, _, x1, y1, _) in boxes.items()
        }
    )
