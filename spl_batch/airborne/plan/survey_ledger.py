"""What a run knows about its survey: inputs, limits, and what is finished so far."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.plan.block_layout import Block
from spl_batch.airborne.plan.block_size import Holders, Sizes, blocks, choose_sizes, layout_of
from spl_batch.airborne.plan.flightlines import Flightline, find_flightlines, is_timeless
from spl_batch.airborne.plan.ground_cells import GroundCells
from spl_batch.airborne.plan.halo import halo_m
from spl_batch.airborne.plan.inputs.survey_inputs import Inputs, Source
from spl_batch.airborne.plan.mosaics import split_mosaic
from spl_batch.airborne.plan.space_units import Unit, tile_counts
from spl_batch.airborne.plan.task_memory import stretch_points
from spl_batch.airborne.settings.workflow import Workflow
from spl_batch.airborne.tasks.index import part_name
from spl_batch.engine.tasks.ledger import Ledger
from spl_batch.engine.tasks.task import Receipt
from spl_batch.lattice.density import from_counts
from spl_batch.lattice.tiles import Bounds, CellId, parse_cell, quanta


def _most_timed(indexed: tuple[str, Receipt]) -> tuple[int, str]:
    key, receipt = indexed
    return int(receipt.facts["timeless"]) - int(receipt.facts["points"]), key


class Pieces(NamedTuple):
    """Input files, or parts of large ones, that hold points of a point source id."""

    names: list[str]  #: What the files of the store that hold them are called.
    #: (p,): times of the first and the last of these points [s].
    first_s: NDArray[np.float64]
    last_s: NDArray[np.float64]

    def within(self, low_s: float, high_s: float) -> list[str]:
        """Names of those that can have points of a time [s]."""
        near = np.flatnonzero((self.first_s <= high_s) & (self.last_s >= low_s))
        return [self.names[k] for k in near.tolist()]


@dataclass
class Survey(Ledger[Inputs, Workflow]):
    """What a run on an airborne survey knows so far.

    ``remembered`` are the sizes of the blocks that earlier runs had, ``remembered_stretch`` the
    points of their stretches.
    """

    remembered: Sizes | None = None
    remembered_stretch: int | None = None

    @property
    def beamlets(self) -> int:
        """Beamlets of a shot; without a channel dimension a shot is one beamlet [count]."""
        workflow = self.workflow
        return workflow.sensor.beamlets if workflow.survey.channel_dimension else 1

    @property
    def filtering(self) -> bool:
        """Whether anything in the chain needs shots and times."""
        return self.workflow.filter.method != "none" or self.workflow.afterpulse.enabled

    @cached_property
    def flightlines(self) -> list[Flightline]:
        """Flightlines whose shots are looked at; complete once the index stage is."""
        return self.flown if self.filtering else []

    @cached_property
    def flown(self) -> list[Flightline]:
        """Flightlines with times, also of a survey that is not filtered; complete likewise."""
        return find_flightlines(self.of("index_file"), self.workflow, self.stretch_points)

    @cached_property
    def line_columns(self) -> tuple[str, ...]:
        """Columns that tell the flightlines of points; none where all are of one."""
        ids = [line.psid for line in self.flown]
        files = self.of("index_file").values()
        timed = not any(is_timeless(receipt, self.workflow) for receipt in files)
        if len(ids) < 2 and timed:
            return ()
        if len(set(ids)) == len(ids) and timed:
            return ("point_source_id",)
        return ("point_source_id", "gps_time")

    @property
    def stretch_points(self) -> int:
        """Points of a stretch on average: as memory allows, and no more than in earlier runs."""
        points = stretch_points(self.memory_bytes)
        return min(points, self.remembered_stretch or points)

    @cached_property
    def cut_anew(self) -> list[Flightline]:
        """Flightlines with shorter stretches than in earlier runs; known once they are indexed."""
        before = self.remembered_stretch
        if not self.filtering or before is None or self.stretch_points >= before:
            return []
        then = find_flightlines(self.of("index_file"), self.workflow, before)
        pairs = zip(then, self.flightlines, strict=True)
        return [now for was, now in pairs if was.stretch_shots != now.stretch_shots]

    def has_other_stretches(self) -> bool:
        """Whether stretches are gathered that another choice than the remembered one made."""
        gathered = self.of("gather")
        return any(name in gathered for line in self.cut_anew for name, _ in line.stretches())

    @cached_property
    def pieces(self) -> dict[int, Pieces]:
        """What of the input holds points of each point source id; complete once the index is.

        Files with most usable times come first: of returns that several hold theirs count, not
        those of a copy whose times are broken.
        """
        found: dict[int, list[tuple[str, float, float]]] = {}
        for key, receipt in sorted(self.of("index_file").items(), key=_most_timed):
            if is_timeless(receipt, self.workflow):
                continue
            spans, parts = receipt.facts["spans"], receipt.facts["parts"]
            whole = {psid: [mine[0][0], mine[-1][1]] for psid, mine in spans.items()}
            named = [(part_name(key, k), of_part) for k, of_part in enumerate(parts)]
            for name, held in named or [(key, whole)]:
                for psid, (first, last) in held.items():
                    found.setdefault(int(psid), []).append((name, first, last))
        return {
            psid: Pieces([n for n, _, _ in listed], *np.array([ends for _, *ends in listed]).T)
            for psid, listed in found.items()
        }

    @cached_property
    def counts(self) -> dict[CellId, int]:
        """Points by tile; complete once the shuffle is."""
        return tile_counts(self.of("build_tile"))

    def blocks(self) -> Iterator[Unit]:
        """Denoise blocks; complete once the shuffle is."""
        layout = layout_of(self.counts, self.workflow)
        found = blocks(layout, self.block_sizes, self.workflow, self.memory_bytes)
        return map(layout.unit, found)

    @cached_property
    def block_sizes(self) -> Sizes:
        """How large denoise blocks are; known once the shuffle is complete."""
        found = self.remembered if self.workflow.tiling.block_tiles is None else None
        if found is None:
            pieces = list(from_counts(self.counts, self.tile_q))
            found = choose_sizes(pieces, self.workflow, self.memory_bytes, self.workers)
        return found._replace(memory_bytes=found.under(self.memory_bytes))

    @property
    def block_memory_bytes(self) -> int | None:
        """Memory limit that blocks of earlier runs were chosen for, where it is known [byte]."""
        given = self.workflow.tiling.block_tiles is not None
        return None if given or self.remembered is None else self.remembered.memory_bytes

    def with_memory_of_blocks(self) -> "Survey | None":
        """The survey under the limit that its blocks were chosen for, none of them looked at.

        None where this run's blocks are those. Known once the shuffle is complete.
        """
        then, now = self._blocks_then_and_now
        if then <= now or self.block_memory_bytes is None:
            return None
        done = {kind: shelf for kind, shelf in self.done.items() if kind != "denoise"}
        return replace(self, memory_bytes=self.block_memory_bytes, done=done)

    def has_other_blocks(self) -> bool:
        """Whether blocks are finished that another choice than the remembered one made."""
        if self.remembered is not None and self.remembered.memory_bytes is None:
            return True  # of a version that did not say what they were chosen for
        then, now = self._blocks_then_and_now
        finished = self.of("denoise")
        return any(str(block) in finished for block in now - then)

    @cached_property
    def _blocks_then_and_now(self) -> tuple[set[Block], set[Block]]:
        """Blocks that the remembered memory limit makes, and this run's; none where it has more."""
        sizes, before = self.remembered, self.block_memory_bytes
        if sizes is None or before is None or before <= self.memory_bytes or not self.counts:
            return set(), set()
        layout = layout_of(self.counts, self.workflow)
        limits = before, self.memory_bytes
        then, now = (set(blocks(layout, sizes, self.workflow, limit)) for limit in limits)
        return then, now

    @cached_property
    def holders(self) -> Holders:
        """Blocks by the tiles that they own; complete once the shuffle is."""
        return Holders([unit.name for unit in self.blocks()], self.tile_q)

    @cached_property
    def ground_cells(self) -> GroundCells:
        """Ground cells; complete once the index stage is."""
        boxes = [(xmin, ymin, xmax + 1, ymax + 1) for xmin, ymin, _, xmax, ymax, _ in _boxes(self)]
        return GroundCells.of_workflow(boxes, self.workflow)

    @property
    def tile_q(self) -> int:
        """Edge of a tile [quanta]."""
        return quanta(self.workflow.tiling.tile_m)

    @property
    def cell_q(self) -> int:
        """Edge of a ground cell [quanta]."""
        return quanta(self.workflow.ground.cell_m)

    @property
    def halo_q(self) -> int:
        """Halo of a denoise block [quanta]."""
        return quanta(halo_m(self.workflow))


def timeless_sources(survey: Survey) -> list[Source]:
    """Files whose points have no usable time although the chain needs it."""
    indexed = survey.of("index_file")
    return [
        s
        for s in survey.inputs.sources
        if survey.filtering
        and str(s.key) in indexed
        and is_timeless(indexed[str(s.key)], survey.workflow)
    ]


def mosaic_parts(survey: Survey) -> list[tuple[list[CellId], Bounds]]:
    """Ground cells and region of each mosaic, the part with most points first.

    One mosaic, unless the survey lies in pieces so far apart that it would be empty space.
    """
    squares: dict[CellId, int] = {}
    for name, receipt in survey.of("surface").items():
        cell = parse_cell(name)
        squares |= dict.fromkeys(survey.ground_cells.squares(cell), 0)
        squares[cell] = receipt.points
    pixel_q = quanta(survey.workflow.products.cell_m)
    return split_mosaic(squares, _boxes(survey), survey.cell_q, pixel_q)


def _boxes(survey: Survey) -> list[Sequence[int]]:
    """Bounding boxes of the points of the files that hold some: x, y, z, x, y, z [quanta]."""
    return [r.facts["bounds"] for r in survey.of("index_file").values() if r.facts["bounds"]]
