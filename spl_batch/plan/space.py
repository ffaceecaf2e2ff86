"""Tiles, blocks and ground cells: which points each unit of the space domain reads."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import NamedTuple

from spl_batch.task import Receipt
from spl_batch.tiling import (
    Bounds,
    BoxIndex,
    CellId,
    cell_bounds,
    cells_touching,
    grow,
    overlap,
    parse_cell,
    quanta,
)


class Unit(NamedTuple):
    """A work unit of the space domain.

    Parameters
    ----------
    name : str
        Column and row on its absolute grid; of a block, see :class:`~spl_batch.plan.layout.Block`.
    cell : CellId
        That column and row; of a block, those of its first tile.
    core : Bounds
        What it owns.
    tiles : tuple of CellId
        Tiles with points in its core or halo.
    points : int
        Points in those tiles that overlap its core [count].
    held : int
        Points in its core and halo, as if they spread evenly over each tile [count].
    """

    name: str
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
    for cell in cells_with_points(counts, tile_q, unit_q):
        yield unit_of(cell, counts, tile_q, unit_q, halo_q)


def unit_of(
    cell: CellId, counts: Mapping[CellId, int], tile_q: int, unit_q: int, halo_q: int
) -> Unit:
    """One unit of a grid; without any points where no tile of its core has some.

    Parameters
    ----------
    cell : CellId
        Its column and row.
    counts, tile_q, unit_q, halo_q
        As in :func:`units`.
    """
    return unit_within(cell_bounds(cell, unit_q), counts, tile_q, halo_q, (str(cell), cell))


def unit_within(
    core: Bounds,
    counts: Mapping[CellId, int],
    tile_q: int,
    halo_q: int,
    named: tuple[str, CellId],
) -> Unit:
    """A unit that owns any rectangle.

    Parameters
    ----------
    core : Bounds
        What it owns [quanta].
    counts, tile_q, halo_q
        As in :func:`units`.
    named : tuple of str and CellId
        Its name, and column and row.
    """
    reach = grow(core, halo_q)
    near = [t for t in cells_touching(reach, tile_q) if t in counts]
    owned = held = 0.0
    for tile in near:
        bounds = cell_bounds(tile, tile_q)
        held += counts[tile] * _shared(bounds, reach) / tile_q**2
        owned += counts[tile] if overlap(bounds, core) else 0
    # shares of tiles add up to whole points, but for the last bit of a sum
    return Unit(*named, core, tuple(near), int(owned), math.ceil(round(held, 6)))


def cells_with_points(counts: Mapping[CellId, int], tile_q: int, unit_q: int) -> list[CellId]:
    """Cells of units that share area with a tile, sorted.

    Parameters
    ----------
    counts, tile_q, unit_q
        As in :func:`units`.
    """
    cells: set[CellId] = set()
    for tile in counts:
        cells.update(cells_touching(cell_bounds(tile, tile_q), unit_q))
    return sorted(cells)


def _shared(a: Bounds, b: Bounds) -> int:
    """Area that two regions share [quanta2]."""
    width = min(a.xmax, b.xmax) - max(a.xmin, b.xmin)
    height = min(a.ymax, b.ymax) - max(a.ymin, b.ymin)
    return max(width, 0) * max(height, 0)


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
