"""What a run knows about its survey: inputs, limits, and what is finished so far."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.plan.flightlines import Flightline, find_flightlines, is_timeless
from spl_batch.airborne.plan.grid import Grid, Unit, denoise_grid, tile_counts
from spl_batch.airborne.plan.inputs.survey_inputs import Inputs, Source
from spl_batch.airborne.plan.task_memory import halo_m
from spl_batch.airborne.settings.workflow import Workflow
from spl_batch.airborne.tasks.index import part_name
from spl_batch.engine.tasks.ledger import Ledger
from spl_batch.engine.tasks.task import Receipt
from spl_batch.lattice.density import from_counts
from spl_batch.lattice.tiles import Bounds, CellId, quanta, whole_cells


def _most_timed(indexed: tuple[str, Receipt]) -> tuple[int, str]:
    key, receipt = indexed
    return int(receipt.facts["timeless"]) - int(receipt.facts["points"]), key


@dataclass
class Survey(Ledger[Inputs, Workflow]):
    """What a run on an airborne survey knows so far."""

    @property
    def beamlets(self) -> int:
        """Beamlets of a shot; without a channel dimension a shot is one beamlet [count]."""
        workflow = self.workflow
        return workflow.sensor.beamlets if workflow.survey.channel_dimension else 1

    @property
    def filtering(self) -> bool:
        """Whether anything in the chain needs shots and times."""
        return self.workflow.filtering

    @cached_property
    def flightlines(self) -> list[Flightline]:
        """Flightlines whose shots are looked at; complete once the index stage is."""
        return self.flown if self.filtering else []

    @cached_property
    def flown(self) -> list[Flightline]:
        """Flightlines with times, also of a survey that is not filtered; complete likewise."""
        return find_flightlines(self.of("index_file"), self.workflow)

    def parts_between(self, psid: int, low_s: float, high_s: float) -> list[str]:
        """What of the input can hold points of an id and a time [s]; complete once the index is.

        Files with most usable times come first: of returns that several hold theirs count, not
        those of a copy whose times are broken.
        """
        names, ends = self._parts[psid]
        near = np.flatnonzero((ends[:, 0] <= high_s) & (ends[:, 1] >= low_s))
        return [names[k] for k in near.tolist()]

    @cached_property
    def _parts(self) -> dict[int, tuple[list[str], NDArray[np.float64]]]:
        """Parts of files by point source id, first and last time of their points: (p, 2) [s]."""
        found: dict[int, tuple[list[str], list[list[float]]]] = {}
        for key, receipt in sorted(self.of("index_file").items(), key=_most_timed):
            if is_timeless(receipt, self.workflow):
                continue
            for k, held in enumerate(receipt.facts["parts"]):
                for psid, ends in held.items():
                    names, listed = found.setdefault(int(psid), ([], []))
                    names.append(part_name(key, k))
                    listed.append(ends)
        return {psid: (names, np.array(listed)) for psid, (names, listed) in found.items()}

    @cached_property
    def positions(self) -> Mapping[str, str]:
        """Hashes of the trajectory by span: a night that is added leaves those of others alone.

        Complete once the index is.
        """
        receipt = self.of("trajectory").get("all")
        return receipt.facts["positions"] if receipt else {}

    @cached_property
    def counts(self) -> dict[CellId, int]:
        """Points by tile; complete once the shuffle is."""
        return tile_counts(self.of("build_tile"))

    @cached_property
    def denoise_grid(self) -> Grid:
        """Grid of the cells of ``denoise``; complete once the shuffle is."""
        pieces = list(from_counts(self.counts, self.tile_q))
        limits = self.memory_bytes, self.workers
        return denoise_grid(pieces, self._extents, self.workflow, *limits).grid

    def ground_cells(self, margin_q: int) -> Iterator[Unit]:
        """Ground cells with a margin [quanta]; complete once the shuffle is."""
        return self.grid.units(self.counts, self.tile_q, margin_q)

    @cached_property
    def grid(self) -> Grid:
        """Grid of the ground cells; complete once the index is."""
        return Grid.of_workflow(self._extents, self.workflow)

    @property
    def _extents(self) -> list[Bounds]:
        """Bounding boxes of the files' points; complete once the index is [quanta]."""
        return [Bounds(west, south, east + 1, north + 1)
                for west, south, _, east, north, _ in self._boxes]  # fmt: skip

    @property
    def bounds(self) -> list[int]:
        """Box around all points: x, y, z, x, y, z; complete once the index is [quanta]."""
        ends = [*zip(*self._boxes, strict=True)]
        return [*map(min, ends[:3]), *map(max, ends[3:])]

    @property
    def _boxes(self) -> list[Sequence[int]]:
        """The same of the points of each file that holds some."""
        indexed = self.of("index_file").values()
        return [r.facts["bounds"] for r in indexed if r.facts["bounds"]]

    @property
    def tile_q(self) -> int:
        """Edge of a tile [quanta]."""
        return quanta(self.workflow.tiling.tile_m)

    @property
    def halo_q(self) -> int:
        """Margin of a cell of ``denoise`` [quanta]."""
        return quanta(halo_m(self.workflow))


def timeless_sources(survey: Survey) -> list[Source]:
    """Files whose points have no usable time although the chain needs it."""
    indexed = survey.of("index_file") if survey.filtering else {}
    there = (source for source in survey.inputs.sources if str(source.key) in indexed)
    return [one for one in there if is_timeless(indexed[str(one.key)], survey.workflow)]


def mosaic_bounds(survey: Survey) -> Bounds:
    """Whole raster cells around the points of the survey."""
    west, south, _, east, north, _ = survey.bounds
    pixel = quanta(survey.workflow.products.cell_m)
    return whole_cells(Bounds(west, south, east + 1, north + 1), pixel)
