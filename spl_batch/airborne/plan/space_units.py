"""Tiles, blocks and ground cells: which points each unit of the space domain reads."""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from spl_batch.engine.tasks.task import Receipt
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


class Unit(NamedTuple):
    """A work unit of the space domain."""

    #: Column and row of a ground cell; of a block, see
    #: :class:`~spl_batch.airborne.plan.block_layout.Block`.
    name: str
    cell: CellId  #: That column and row; of a block, those of its first tile.
    core: Bounds
    tiles: tuple[CellId, ...]  #: Tiles with points in its core or halo.
    points: int  #: Points in those tiles that overlap its core [count].
    held: int  #: Points in its core and halo, as if they spread evenly over each tile [count].


def tile_counts(tiles: Mapping[str, Receipt]) -> dict[CellId, int]:
    """Points of each tile that holds some, from the receipts of the built tiles."""
    counts = {parse_cell(name): int(r.facts["points"]) for name, r in tiles.items()}
    return {tile: n for tile, n in sorted(counts.items()) if n}


def occupied(counts: Mapping[CellId, int], region: Bounds, tile_q: int) -> list[CellId]:
    """Tiles with points that share area with a region, row by row.

    A region that spans far more tiles than hold points costs no more than those do.

    ``counts``: points by tile; only tiles that hold some. ``region``: where to look [quanta].
    """
    columns = -(-region.xmax // tile_q) - region.xmin // tile_q
    rows = -(-region.ymax // tile_q) - region.ymin // tile_q
    if columns * rows <= len(counts):
        return [t for t in cells_touching(region, tile_q) if t in counts]
    found = (t for t in counts if overlap(cell_bounds(t, tile_q), region))
    return sorted(found, key=lambda t: (t.j, t.i))


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
    tile_q, halo_q : int
        Edge of a tile, and the halo that the unit reads [quanta].
    named : tuple of str and CellId
        Its name, and column and row.
    """
    reach = grow(core, halo_q)
    near = occupied(counts, reach, tile_q)
    owned = held = 0.0
    for tile in near:
        bounds = cell_bounds(tile, tile_q)
        held += counts[tile] * _area(shared(bounds, reach)) / tile_q**2
        owned += counts[tile] if overlap(bounds, core) else 0
    # shares of tiles add up to whole points, but for the last bit of a sum
    return Unit(*named, core, tuple(near), int(owned), math.ceil(round(held, 6)))


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
