"""Denoise blocks: rectangles of tiles, cut where they hold too much, joined where they own little.

Every point of a halo is read and tested again for each block that it lies around. A block at the
edge of a survey may own a strip of a few metres and read twenty times as much; its neighbour
reads nearly all of that anyway and takes the strip over.
"""

import heapq
import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Final, NamedTuple

from spl_batch.airborne.plan.space_units import Unit, occupied, unit_within
from spl_batch.lattice.tiles import Bounds, CellId

POOR: Final = 0.25
"""Share of what it reads that a block owns, below which a neighbour takes it over if it can."""


CORE_COST: Final = 2.5
"""Cost of a point that a block owns, over that of one in its halo: what the quickstart's
blocks took."""

ORIGIN: Final = CellId(0, 0)
"""Tile that a square of tiles begins with, unless another is named."""


class Block(NamedTuple):
    """Rectangle of tiles."""

    #: i, j: column and row of its south-western tile.
    i: int
    j: int
    columns: int
    rows: int

    def __str__(self) -> str:
        return f"{self.i}_{self.j}_{self.columns}_{self.rows}"

    def tiles(self) -> Iterator[CellId]:
        """Its tiles, column by column."""
        for i in range(self.i, self.i + self.columns):
            for j in range(self.j, self.j + self.rows):
                yield CellId(i, j)

    def holds(self, tile: CellId) -> bool:
        """Whether a tile is one of its own."""
        return 0 <= tile.i - self.i < self.columns and 0 <= tile.j - self.j < self.rows

    def core(self, tile_q: int) -> Bounds:
        """Region that it owns [quanta]."""
        east, north = self.i + self.columns, self.j + self.rows
        return Bounds(self.i * tile_q, self.j * tile_q, east * tile_q, north * tile_q)


class Load(NamedTuple):
    """Points of a block."""

    points: int  #: In tiles of its own [count].
    held: int  #: In its core and halo, as if they spread evenly over each tile [count].


@dataclass(frozen=True)
class Layout:
    """How the tiles of a survey are shared among blocks."""

    counts: Mapping[CellId, int]  #: Points by tile; only tiles that hold some.
    tile_q: int
    halo_q: int  #: Halo that a block reads [quanta].
    _loads: dict[Block, Load] = field(default_factory=dict, init=False, repr=False, compare=False)

    def load(self, block: Block) -> Load:
        """Points that a block owns and reads; the same blocks are tried again and again."""
        if block not in self._loads:
            unit = self.unit(block)
            self._loads[block] = Load(unit.points, unit.held)
        return self._loads[block]

    def unit(self, block: Block) -> Unit:
        """What a block owns and reads, with its tiles."""
        cell, core = CellId(block.i, block.j), block.core(self.tile_q)
        return unit_within(core, self.counts, self.tile_q, self.halo_q, (str(block), cell))

    def cost(self, block: Block) -> float:
        """What a block takes, in points of a halo."""
        load = self.load(block)
        return load.held + (CORE_COST - 1) * load.points

    def share(self, side: int, most: float, anchor: CellId = ORIGIN, parts: int = 1) -> list[Block]:
        """Blocks that read little and hold no more than they may.

        Parameters
        ----------
        side : int
            Tiles along one side of the squares that they are made of [count].
        most : float
            Points that a block of several tiles may hold with its halo [count].
        parts : int
            Parts of about equal cost that each of them is divided into [count].

        Returns
        -------
        list of Block
            Sorted; each tile that holds points belongs to one.
        """
        # strips at the edges first, so that cuts run through all of a survey
        whole = self.join(self.squares(side, anchor), math.inf)
        if parts == 1:
            return self.join(self.cut(whole, most), most)
        divided = (part for block in whole for part in self.divide(block, parts))
        return sorted(self.cut(divided, most))

    def squares(self, side: int, anchor: CellId = ORIGIN) -> list[Block]:
        """Squares of a grid, without the rows and columns that hold no points."""
        cells: dict[CellId, list[CellId]] = {}
        for tile in self.counts:
            square = CellId((tile.i - anchor.i) // side, (tile.j - anchor.j) // side)
            cells.setdefault(square, []).append(tile)
        return [around(tiles) for _, tiles in sorted(cells.items())]

    def divide(self, block: Block, parts: int) -> list[Block]:
        """A block in parts that cost about the same, as far as columns and rows of tiles let them.

        ``parts``: how many, if it has as many tiles [count].
        """
        block = around(self._tiles(block))
        if parts == 1 or block.columns * block.rows == 1:
            return [block]
        _, one, other, of_one = min(self._in_two(block, parts))
        return self.divide(one, of_one) + self.divide(other, parts - of_one)

    def _in_two(self, block: Block, parts: int) -> Iterator[tuple[float, Block, Block, int]]:
        """Each way to cut across a longer side for so many parts: the dearer one's cost first."""
        tiles = self._tiles(block)
        for axis in (0, 1):
            if (block.columns, block.rows)[axis] < max(block.columns, block.rows):
                continue
            for line in sorted({t[axis] for t in tiles})[1:]:
                one = around(t for t in tiles if t[axis] < line)
                other = around(t for t in tiles if t[axis] >= line)
                costs = self.cost(one), self.cost(other)
                for of_one in {parts // 2, parts - parts // 2}:
                    dearest = max(costs[0] / of_one, costs[1] / (parts - of_one))
                    yield dearest, one, other, of_one

    def cut(self, blocks: Iterable[Block], most: float) -> Iterator[Block]:
        """Blocks of several tiles that hold too much in halves, and these again.

        ``most``: points that a block may hold with its halo [count].
        """
        waiting = list(blocks)[::-1]
        while waiting:
            block = waiting.pop()
            if block.columns * block.rows > 1 and self.load(block).held > most:
                waiting.extend(reversed(self._halves(block)))
            else:
                yield block

    def join(self, blocks: Iterable[Block], most: float) -> list[Block]:
        """Blocks that own little of what they read given to a neighbour, the poorest first.

        Parameters
        ----------
        blocks : iterable of Block
            Blocks that own points and share no tile.
        most : float
            Points that the two may hold together [count].
        """
        holder = {t: block for block in blocks for t in self._tiles(block)}
        waiting = [self._rank(block) for block in set(holder.values())]
        heapq.heapify(waiting)
        while waiting and waiting[0][0] < POOR:
            block = heapq.heappop(waiting)[-1]
            if holder[self._tiles(block)[0]] != block:
                continue  # taken over
            both = self._best(block, holder, most)
            if both is not None:
                holder.update((t, both) for t in self._tiles(both))
                heapq.heappush(waiting, self._rank(both))
        return sorted(set(holder.values()))

    def _tiles(self, block: Block) -> list[CellId]:
        """Tiles of a block that hold points, column by column."""
        return sorted(occupied(self.counts, block.core(self.tile_q), self.tile_q))

    def _beside(self, block: Block) -> Iterator[CellId]:
        """Tiles with points that share a side with a block."""
        i, j, columns, rows = block
        for strip in (
            Block(i - 1, j, 1, rows),
            Block(i + columns, j, 1, rows),
            Block(i, j - 1, columns, 1),
            Block(i, j + rows, columns, 1),
        ):
            yield from self._tiles(strip)

    def _rank(self, block: Block) -> tuple[float, Block]:
        load = self.load(block)
        return load.points / max(load.held, 1), block

    def _best(self, block: Block, holder: Mapping[CellId, Block], most: float) -> Block | None:
        """The block with that neighbour with which it reads least beyond what both did."""
        found = []
        for other in {holder[t] for t in self._beside(block)}:
            both = around((*_corners(block), *_corners(other)))
            if any(holder[t] not in (block, other) for t in self._tiles(both)):
                continue
            held = self.load(both).held
            if held <= most:
                found.append((held - self.load(other).held, both))
        return min(found)[1] if found else None

    def _halves(self, block: Block) -> tuple[Block, Block]:
        """A block in two along its longer side, where its points are shared most evenly."""
        wide = block.columns >= block.rows
        tiles = self._tiles(block)
        at = [t.i if wide else t.j for t in tiles]
        west, total = 0, sum(self.counts[t] for t in tiles)
        shares = []
        for line in sorted(set(at))[:-1]:
            west += sum(self.counts[t] for t, k in zip(tiles, at, strict=True) if k == line)
            shares.append((abs(total - 2 * west), line))
        line = min(shares)[1]
        low = [t for t, k in zip(tiles, at, strict=True) if k <= line]
        high = [t for t, k in zip(tiles, at, strict=True) if k > line]
        return around(low), around(high)


def parse_block(name: str) -> Block:
    """Block of a name such as ``"-3_12_4_2"``."""
    return Block(*map(int, name.split("_")))


def around(tiles: Iterable[CellId]) -> Block:
    """The smallest block that contains some tiles, at least one."""
    columns, rows = zip(*tiles, strict=True)
    i, j = min(columns), min(rows)
    return Block(i, j, max(columns) - i + 1, max(rows) - j + 1)


def _corners(block: Block) -> tuple[CellId, CellId]:
    east, north = block.i + block.columns, block.j + block.rows
    return CellId(block.i, block.j), CellId(east - 1, north - 1)
