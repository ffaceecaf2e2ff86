"""Tiles, blocks and ground cells: which points each unit of the space domain reads."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from spl_batch.model import Receipt
from spl_batch.runner.space_domain import parse_cell
from spl_batch.stages.denoise import BYTES_PER_POINT, reach_m
from spl_batch.tiling import Bounds, CellId, cell_bounds, cells_touching, grow, overlap, quanta
from spl_batch.workflow import Workflow

MAX_BLOCK_TILES = 8
"""Tiles along one side of a block, at most [count]."""


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
    """

    cell: CellId
    core: Bounds
    tiles: tuple[CellId, ...]
    points: int


def tile_counts(tiles: Mapping[str, Receipt]) -> dict[CellId, int]:
    """Points of each tile that holds some, from the receipts of the built tiles."""
    counts = {parse_cell(name): int(r.facts["points"]) for name, r in tiles.items()}
    return {tile: n for tile, n in sorted(counts.items()) if n}


def units(counts: Mapping[CellId, int], tile_q: int, unit_q: int, halo_q: int) -> list[Unit]:
    """Units of an absolute grid that own points.

    Parameters
    ----------
    counts : mapping of CellId to int
        Points by tile.
    tile_q, unit_q : int
        Edges of a tile and of a unit [quanta].
    halo_q : int
        Halo that a unit reads [quanta].
    """
    cells: dict[CellId, None] = {}
    for tile in counts:
        cells.update(dict.fromkeys(cells_touching(cell_bounds(tile, tile_q), unit_q)))
    found = []
    for cell in sorted(cells):
        core = cell_bounds(cell, unit_q)
        near = [t for t in cells_touching(grow(core, halo_q), tile_q) if t in counts]
        points = sum(counts[t] for t in near if overlap(cell_bounds(t, tile_q), core))
        found.append(Unit(cell, core, tuple(near), points))
    return found


def choose_block_tiles(
    counts: Mapping[CellId, int], workflow: Workflow, memory_bytes: int, workers: int
) -> int:
    """Tiles along one side of a denoise block: as many as memory and the workers allow.

    A larger block reads less halo; but every worker should have several blocks.
    """
    if workflow.tiling.block_tiles is not None:
        return workflow.tiling.block_tiles
    tile_q = quanta(workflow.tiling.tile_m)
    halo_q = quanta(reach_m(workflow.filter))
    budget = memory_bytes // 2 // BYTES_PER_POINT
    best = 1
    for n in range(2, MAX_BLOCK_TILES + 1):
        blocks = units(counts, tile_q, n * tile_q, halo_q)
        heaviest = max((sum(counts[t] for t in b.tiles) for b in blocks), default=0)
        if heaviest > budget or len(blocks) < 3 * workers:
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


def fired_parts(boxes: Mapping[str, Sequence[int]], region: Bounds) -> list[str]:
    """Stretches that may have fired at a region, by name.

    Parameters
    ----------
    boxes : mapping of str to sequence of int
        Rectangle of each stretch near the ground: xmin, ymin, xmax, ymax [m].
    region : Bounds
        The region [quanta].
    """
    return [
        name
        for name, box in sorted(boxes.items())
        if overlap(Bounds(*(quanta(edge) for edge in box)), region)
    ]


def voxel_parts(boxes: Mapping[str, Sequence[int]], region: Bounds, voxel_q: int) -> list[str]:
    """Stretches whose voxel parts overlap a region, by name.

    Parameters
    ----------
    boxes : mapping of str to sequence of int
        First and past-the-last voxel index of each part: x, y, z, x, y, z.
    region : Bounds
        The region [quanta].
    voxel_q : int
        Edge of a voxel [quanta].
    """
    return [
        name
        for name, (x0, y0, _, x1, y1, _) in sorted(boxes.items())
        if overlap(Bounds(x0 * voxel_q, y0 * voxel_q, x1 * voxel_q, y1 * voxel_q), region)
    ]
