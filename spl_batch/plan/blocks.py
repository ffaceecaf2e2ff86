"""Denoise blocks: squares of tiles that are as large as memory and the workers allow.

A block that would hold too much is cut into smaller ones, and these again, where it lies: the
rest of the survey keeps its blocks. The largest size is remembered in the store, so that a
flightline that is added, or another number of workers, leaves finished blocks as they are.
"""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Final

from spl_batch.errors import DamagedError
from spl_batch.io.store import Store, read_json, write_json
from spl_batch.plan.density import Cut, Piece
from spl_batch.plan.memory import halo_m, points_within
from spl_batch.plan.space import Unit, cells_with_points, unit_of
from spl_batch.task import Receipt
from spl_batch.tiling import CellId, quanta
from spl_batch.workflow import Workflow

LARGEST: Final = (8, 6, 4, 3, 2, 1)
"""Tiles along one side of the largest blocks, to choose from [count]."""

BLOCKS_PER_WORKER: Final = 3
"""Blocks that each worker should have, at the least [count]."""

BLOCK_SHARE: Final = 0.9
"""Part of the points that a worker can hold which a block of several tiles may have: within
a tile they may lie on the side of the halo."""

_FILE: Final = "blocks.json"


def choose_block_tiles(
    pieces: Sequence[Piece], workflow: Workflow, memory_bytes: int, workers: int
) -> int:
    """Tiles along one side of the largest blocks: that of which all blocks read least.

    A larger block reads less halo, unless it has to be cut; but every worker should have
    several blocks.

    Parameters
    ----------
    pieces : sequence of Piece
        Where the points lie.
    workflow : Workflow
        The settings; a size that they give is taken.
    memory_bytes : int
        Memory limit of a worker [byte].
    workers : int
        Worker processes [count].
    """
    if workflow.tiling.block_tiles is not None:
        return workflow.tiling.block_tiles
    tile_q = quanta(workflow.tiling.tile_m)
    best, least = LARGEST[-1], math.inf
    for tiles in LARGEST:
        whole = sum(piece.units(tiles * tile_q) for piece in pieces)
        if whole >= BLOCKS_PER_WORKER * workers or tiles == LARGEST[-1]:
            read = sum(cut.read for cut in _cuts(pieces, workflow, memory_bytes, tiles))
            if read < least:
                best, least = tiles, read
    return best


def block_sides(largest: int, workflow: Workflow) -> tuple[int, ...]:
    """Sizes that blocks may have, the largest first; each divides the one before [tiles].

    Parameters
    ----------
    largest : int
        What :func:`choose_block_tiles` chose.
    workflow : Workflow
        The settings; blocks of a size that they give are not cut.
    """
    if workflow.tiling.block_tiles is not None:
        return (largest,)
    sides = [largest]
    while sides[-1] > 1:
        sides.append(next(n for n in range(sides[-1] - 1, 0, -1) if sides[-1] % n == 0))
    return tuple(sides)


def block_points(memory_bytes: int) -> float:
    """Points that a block of several tiles may hold under a worker's memory limit [count]."""
    return points_within("denoise", memory_bytes) * BLOCK_SHARE


def blocks(
    counts: Mapping[CellId, int], tile_q: int, sides: Sequence[int], halo_q: int, most: float
) -> Iterator[Unit]:
    """Blocks that own points, one by one in the order of the largest ones' cells.

    Parameters
    ----------
    counts : mapping of CellId to int
        Points by tile.
    tile_q : int
        Edge of a tile [quanta].
    sides : sequence of int
        From :func:`block_sides` [tiles].
    halo_q : int
        Halo that a block reads [quanta].
    most : float
        Points beyond which a block is cut, as long as there is a smaller size [count].
    """
    cells = cells_with_points(counts, tile_q, sides[0] * tile_q)
    waiting = [(cell, 0) for cell in reversed(cells)]
    while waiting:
        cell, level = waiting.pop()
        unit = unit_of(cell, counts, tile_q, sides[level] * tile_q, halo_q)
        if not unit.points:
            continue  # a part without tiles
        if unit.held > most and level + 1 < len(sides):
            step = sides[level] // sides[level + 1]
            inside = (CellId(cell.i * step + k // step, cell.j * step + k % step)
                      for k in range(step**2 - 1, -1, -1))  # fmt: skip
            waiting.extend((part, level + 1) for part in inside)
        else:
            yield unit._replace(name=block_name(cell, sides[level]))


def block_name(cell: CellId, side: int) -> str:
    """Name of a block: column and row of its first tile, and tiles along its side.

    Parameters
    ----------
    cell : CellId
        Its cell on the grid of blocks of its size.
    side : int
        That size [tiles].
    """
    return f"{cell.i * side}_{cell.j * side}_{side}"


def block_holders(
    tiles: Iterable[CellId], sides: Sequence[int], done: Mapping[str, Receipt]
) -> dict[CellId, list[str]]:
    """Finished block that holds labels of each tile, none where it has failed; by tile.

    Parameters
    ----------
    tiles : iterable of CellId
        Tiles.
    sides : sequence of int
        Sizes that blocks may have [tiles].
    done : mapping of str to Receipt
        Finished blocks by name.
    """
    return {
        tile: [
            name
            for side in sides
            if (name := block_name(CellId(tile.i // side, tile.j // side), side)) in done
        ]
        for tile in tiles
    }


def count_blocks(
    pieces: Sequence[Piece], workflow: Workflow, memory_bytes: int, largest: int
) -> tuple[int, int]:
    """Blocks of a survey of which only the density is known, and the largest size of them.

    Parameters
    ----------
    pieces, workflow, memory_bytes
        As in :func:`choose_block_tiles`.
    largest : int
        What it chose.

    Returns
    -------
    blocks, tiles : int
        Their number, and the tiles along one side of the largest [count].
    """
    sides = block_sides(largest, workflow)
    found = _cuts(pieces, workflow, memory_bytes, largest)
    there = [side for side, cut in zip(sides, found, strict=True) if cut.units]
    return sum(cut.units for cut in found), max(there, default=largest)


def _cuts(
    pieces: Sequence[Piece], workflow: Workflow, memory_bytes: int, largest: int
) -> list[Cut]:
    """Blocks of each size, and what they read."""
    tile_q, halo_q = quanta(workflow.tiling.tile_m), quanta(halo_m(workflow))
    edges = [side * tile_q for side in block_sides(largest, workflow)]
    by_piece = [piece.cut(edges, halo_q, block_points(memory_bytes)) for piece in pieces]
    return [
        Cut(sum(cut.units for cut in by_size), sum(cut.read for cut in by_size))
        for by_size in zip(*by_piece, strict=True)
    ] or [Cut(0, 0.0)] * len(edges)


def remembered_block_tiles(store: Store, workflow: Workflow) -> int | None:
    """Size of the largest blocks of earlier runs with these tiles; None where there is none."""
    return _remembered(store).get(_key(workflow))


def remember_block_tiles(store: Store, workflow: Workflow, tiles: int) -> None:
    """Keep the size of the largest blocks for later runs.

    Parameters
    ----------
    store : Store
        Where.
    workflow : Workflow
        The settings.
    tiles : int
        Tiles along one side [count].
    """
    known = _remembered(store)
    if known.get(_key(workflow)) != tiles:
        write_json(store.path(_FILE), {**known, _key(workflow): tiles})


def _key(workflow: Workflow) -> str:
    return f"tiles of {workflow.tiling.tile_m:g} m"


def _remembered(store: Store) -> dict[str, int]:
    try:
        return read_json(store.path(_FILE))
    except DamagedError:
        return {}  # none yet, or nothing that can be trusted: it is chosen anew
