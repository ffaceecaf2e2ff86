"""How large denoise blocks are: as memory allows, and so that all workers finish together.

The choice is made once and remembered in the store, as is that of a stretch's points, so that a
flightline that is added, other workers or more memory leave what is finished as it is.
"""

import heapq
import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any, Final, NamedTuple

from spl_batch.airborne.plan.block_layout import ORIGIN, Block, Layout, around, parse_block
from spl_batch.airborne.plan.halo import halo_m
from spl_batch.airborne.plan.memory.block_parts import parts_of
from spl_batch.airborne.plan.space_units import unit_within
from spl_batch.airborne.plan.task_memory import points_within
from spl_batch.airborne.settings.workflow import Workflow
from spl_batch.engine.store.working_store import Store, read_json, write_json
from spl_batch.errors import DamagedError
from spl_batch.lattice.density import Cut, Piece
from spl_batch.lattice.tiles import Bounds, BoxIndex, CellId, cell_bounds, quanta

LARGEST: Final = (8, 7, 6, 5, 4, 3, 2, 1)
"""Tiles along one side of the squares that blocks begin as, to choose from [count]."""

WIDEST: Final = 2 * LARGEST[0]
"""Tiles along the longest side of a part of a small survey [count]: where few tiles lie far apart,
it would hold the empty space between them."""

BLOCKS_PER_WORKER: Final = 3
"""Blocks of a large survey that each worker should have, at the least [count]."""

FEW_TILES: Final = 400
"""Tiles of a survey that is small enough to try how its blocks would be worked off [count]."""

PARTS: Final = (1, 2, 3, 4, 6, 8)
"""Parts of a small survey for each worker, to choose from [count]."""

BLOCK_SHARE: Final = 0.9
"""Part of the points that a worker can hold which a block of several tiles may have: within
a tile they may lie on the side of the halo."""

MANY: Final = 2000
"""Tiles times blocks near by from which on each tile is looked up by itself."""

_FILE: Final = "blocks.json"
_STRETCH: Final = "stretches"


class Sizes(NamedTuple):
    """How large blocks are."""

    tiles: int  #: Tiles along one side of the squares that they begin as [count].
    parts: int = 1  #: Parts of about equal cost that each square is divided into [count].
    anchor: CellId = ORIGIN  #: South-western tile of one of those squares.
    #: Memory limit of a worker that they were chosen for: with more, blocks are no larger [byte].
    memory_bytes: int | None = None

    def under(self, memory_bytes: int) -> int:
        """Memory limit by which squares are cut, where a worker has so much [byte]."""
        return memory_bytes if self.memory_bytes is None else min(memory_bytes, self.memory_bytes)


class Expected(NamedTuple):
    """Blocks that a survey will have."""

    blocks: int
    tiles: int  #: Tiles along the longest side of one [count].
    read: float  #: Points that they read, halos included, over those of the survey.


def choose_sizes(
    pieces: Sequence[Piece], workflow: Workflow, memory_bytes: int, workers: int
) -> Sizes:
    """Sizes with which the blocks of a survey are done soonest.

    The absolute grid may cut a small survey unevenly. One square around all of it is tried too, in
    several numbers of parts for each worker.

    ``pieces``: where the points lie. ``workflow``: the settings; a size that they give is taken.
    """
    if workflow.tiling.block_tiles is not None:
        return Sizes(workflow.tiling.block_tiles)
    counts = _few_tiles(pieces, workflow)
    if counts is None:
        return Sizes(_choose_by_read(pieces, workflow, memory_bytes, workers))
    layout = layout_of(counts, workflow)
    tried = [Sizes(tiles) for tiles in LARGEST]
    if counts:
        everything = around(counts)
        side = max(everything.columns, everything.rows)
        anchor = CellId(everything.i, everything.j)
        many = {min(part * workers, len(counts)) for part in PARTS}
        tried += [Sizes(side, parts, anchor) for parts in sorted({1, *many})]
    found = ((blocks(layout, sizes, workflow, memory_bytes), sizes) for sizes in tried)
    costs = [
        (_finished(map(layout.cost, those), workers), n, sizes)
        for n, (those, sizes) in enumerate(found)
        if sizes.tiles <= WIDEST or all(max(block.columns, block.rows) <= WIDEST for block in those)
    ]
    return min(costs)[-1]


def blocks(layout: Layout, sizes: Sizes, workflow: Workflow, memory_bytes: int) -> list[Block]:
    """Blocks that own points, sorted.

    Parameters
    ----------
    layout : Layout
        From :func:`layout_of`.
    sizes : Sizes
        From :func:`choose_sizes`.
    workflow : Workflow
        The settings; blocks of a size that they give are neither cut nor joined.
    """
    if workflow.tiling.block_tiles is not None:
        return layout.squares(sizes.tiles)
    most = block_points(sizes.under(memory_bytes))
    return layout.share(sizes.tiles, most, sizes.anchor, sizes.parts)


def layout_of(counts: Mapping[CellId, int], workflow: Workflow) -> Layout:
    """Tiles of a survey as blocks see them."""
    return Layout(counts, quanta(workflow.tiling.tile_m), quanta(halo_m(workflow)))


def block_points(memory_bytes: int) -> float:
    """Points that a block of several tiles may hold under a worker's memory limit [count]."""
    return points_within("denoise", memory_bytes) * BLOCK_SHARE


class Holders:
    """Blocks by the tiles that they own."""

    def __init__(self, names: Iterable[str], tile_q: int) -> None:
        self._tile_q = tile_q
        self._blocks = {name: parse_block(name) for name in names}
        self._index = BoxIndex({name: block.core(tile_q) for name, block in self._blocks.items()})

    def of(self, tiles: Collection[CellId]) -> dict[CellId, list[str]]:
        """Block that holds labels of each tile, by tile."""
        if not tiles:
            return {}
        near = self._index.overlapping(around(tiles).core(self._tile_q))
        rows = {name: self._blocks[name] for name in near}
        if len(tiles) * len(rows) > MANY:
            return {t: self._index.overlapping(cell_bounds(t, self._tile_q)) for t in tiles}
        return {t: [name for name, block in rows.items() if block.holds(t)] for t in tiles}


def count_blocks(
    pieces: Sequence[Piece], workflow: Workflow, memory_bytes: int, sizes: Sizes
) -> Expected:
    """Blocks of a survey of which only the density is known, of a large one estimated.

    Parameters
    ----------
    pieces, workflow, memory_bytes
        As in :func:`choose_sizes`.
    """
    points = max(math.fsum(float(piece.points.sum()) for piece in pieces), 1.0)
    counts = _few_tiles(pieces, workflow)
    if counts is not None:
        layout = layout_of(counts, workflow)
        found = blocks(layout, sizes, workflow, memory_bytes)
        longest = max((max(block.columns, block.rows) for block in found), default=sizes.tiles)
        read = sum(_read(layout, block, workflow, memory_bytes) for block in found)
        return Expected(len(found), longest, read / points)
    shapes = _shapes(sizes.tiles, workflow)
    cuts = _cuts(pieces, workflow, sizes.under(memory_bytes), sizes.tiles)
    there = [max(shape) for shape, cut in zip(shapes, cuts, strict=True) if cut.units]
    # squares of a density know no tile's edge; a block reads at least what it owns
    reading = max(math.fsum(cut.read for cut in cuts), points)
    longest = max(there, default=sizes.tiles)
    return Expected(sum(cut.units for cut in cuts), longest, reading / points)


def _read(layout: Layout, block: Block, workflow: Workflow, memory_bytes: int) -> float:
    """Points that a block reads, part by part where not all of it fits into memory [count]."""
    named = (str(block), CellId(block.i, block.j))

    def points(region: Bounds) -> int:
        return unit_within(region, layout.counts, layout.tile_q, 0, named).held

    parts = parts_of(block.core(layout.tile_q), points, workflow, memory_bytes)
    return math.fsum(part.held for part in parts)


def _few_tiles(pieces: Sequence[Piece], workflow: Workflow) -> dict[CellId, int] | None:
    """Points by tile, of a survey of few."""
    tile_q = quanta(workflow.tiling.tile_m)
    if any(p.edge != tile_q for p in pieces) or sum(p.touched.sum() for p in pieces) > FEW_TILES:
        return None
    return {
        CellId(piece.first.i + int(column), piece.first.j + int(row)):
            max(math.ceil(piece.points[row, column]), 1)
        for piece in pieces
        for row, column in zip(*piece.touched.nonzero(), strict=True)
    }  # fmt: skip


def _finished(costs: Iterable[float], workers: int) -> float:
    """When the last of some tasks is done, if each worker takes the dearest that is left."""
    busy = [0.0] * max(workers, 1)
    for cost in sorted(costs, reverse=True):
        heapq.heapreplace(busy, busy[0] + cost)
    return max(busy)


def _choose_by_read(
    pieces: Sequence[Piece], workflow: Workflow, memory_bytes: int, workers: int
) -> int:
    """Side of squares of which all read least; but every worker has several [tiles]."""
    tile_q = quanta(workflow.tiling.tile_m)
    best, least = LARGEST[-1], math.inf
    for tiles in LARGEST:
        whole = sum(piece.units(tiles * tile_q) for piece in pieces)
        if whole >= BLOCKS_PER_WORKER * workers or tiles == LARGEST[-1]:
            read = sum(cut.read for cut in _cuts(pieces, workflow, memory_bytes, tiles))
            if read < least:
                best, least = tiles, read
    return best


def _shapes(largest: int, workflow: Workflow) -> list[tuple[int, int]]:
    """Columns and rows of squares, of their halves, of the halves of these, and so on [tiles].

    Where a side cannot be halved it is cut into the fewest equal parts that it can; a prime number
    of tiles into two that are nearly equal.
    """
    wide = high = largest
    shapes = [(wide, high)]
    while high > 1 and workflow.tiling.block_tiles is None:
        wide = _largest_part(wide)
        shapes += [(wide, high), (wide, wide)]
        high = wide
    return shapes


def _largest_part(side: int) -> int:
    nearly = 1 if side <= 3 else -(-side // 2)
    return next((n for n in range(side // 2, 1, -1) if side % n == 0), nearly)


def _cuts(
    pieces: Sequence[Piece], workflow: Workflow, memory_bytes: int, largest: int
) -> list[Cut]:
    """Blocks of each shape, and what they read, about: none is joined to a neighbour."""
    tile_q, halo_q = quanta(workflow.tiling.tile_m), quanta(halo_m(workflow))
    shapes = [(wide * tile_q, high * tile_q) for wide, high in _shapes(largest, workflow)]
    by_piece = [piece.cut(shapes, halo_q, block_points(memory_bytes)) for piece in pieces]
    return [
        Cut(sum(cut.units for cut in by_shape), sum(cut.read for cut in by_shape))
        for by_shape in zip(*by_piece, strict=True)
    ] or [Cut(0, 0.0)] * len(shapes)


def remembered_sizes(store: Store, workflow: Workflow) -> Sizes | None:
    """Sizes of the blocks of earlier runs with these tiles; None where there are none."""
    found = _remembered(store).get(_key(workflow))
    if found is None:
        return None
    anchor = CellId(*found.get("anchor", ORIGIN))
    parts, memory_bytes = int(found.get("parts", 1)), found.get("memory_bytes")
    return Sizes(int(found["tiles"]), parts, anchor, memory_bytes)


def remember_sizes(store: Store, workflow: Workflow, sizes: Sizes) -> None:
    """Keep the sizes of blocks for later runs.

    ``store``: where. ``sizes``: what :func:`choose_sizes` chose.
    """
    _remember(store, _key(workflow), {**sizes._asdict(), "anchor": [*sizes.anchor]})


def remembered_stretch(store: Store) -> int | None:
    """Points of a stretch in earlier runs [count]; None where there are none."""
    found = _remembered(store).get(_STRETCH)
    return None if found is None else int(found["points"])


def remember_stretch(store: Store, points: int) -> None:
    """Keep the points of a stretch for later runs: with more memory they would be cut anew."""
    _remember(store, _STRETCH, {"points": points})


def _key(workflow: Workflow) -> str:
    return f"blocks of tiles of {workflow.tiling.tile_m:g} m"


def _remember(store: Store, key: str, chosen: dict[str, Any]) -> None:
    known = _remembered(store)
    if known.get(key) != chosen:
        write_json(store.path(_FILE), {**known, key: chosen})


def _remembered(store: Store) -> dict[str, dict[str, Any]]:
    try:
        return read_json(store.path(_FILE))
    except DamagedError:
        return {}  # none yet, or nothing that can be trusted: it is chosen anew
