"""Coincidence processing of Geiger-mode lidar, as the verbs need it."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import pairwise
from pathlib import Path
from types import MappingProxyType
from typing import Any, ClassVar, Final

from pyproj import CRS

from spl_batch.constants import QUANTA_PER_M
from spl_batch.engine.findings import Finding
from spl_batch.engine.plan.budget import Cost, measured_rates
from spl_batch.engine.plan.input_files import check_keys, expand, name_below, refuse_own, usable
from spl_batch.engine.plan.worker_memory import WORKER_BASE_BYTES
from spl_batch.engine.report.verdict import card_rows
from spl_batch.engine.tasks.input_changes import stamp
from spl_batch.engine.tasks.ledger import Ledger
from spl_batch.engine.tasks.step import Step
from spl_batch.engine.tasks.task import Receipt, Task
from spl_batch.engine.verbs.receiver import Prepared, Receiver, none_usable
from spl_batch.errors import InputError, WorkflowError, grouped
from spl_batch.formats.crs import projected_crs
from spl_batch.geiger.coincidence import files
from spl_batch.geiger.coincidence.settings import CoincidenceWorkflow
from spl_batch.geiger.coincidence.surface.coincide import halo, reach_q
from spl_batch.geiger.coincidence.tables import Detections, Frames, Table
from spl_batch.geiger.coincidence.tasks import CoincidenceContext
from spl_batch.lattice import density
from spl_batch.lattice.density import Box
from spl_batch.lattice.tiles import Bounds, parse_cell, quanta

RATES_POINTS_PER_S: Final[Mapping[str, float]] = MappingProxyType(
    {"index": 0.4e6, "coincidence": 30_000.0, "deliver": 0.5e6}
)
"""Detections per second and worker until a store has measured its own; points when delivering."""


@dataclass(frozen=True, slots=True)
class L1File:
    """An input file that can be used."""

    path: Path  #: Where it lies.
    name: str
    key: int
    rows: int  #: Frames or detections in it [count].
    #: Its size [byte] and time of writing [ns since 1970] when it was looked at.
    written: tuple[int, int]
    #: Of each row group west, south, east, north [m] and its rows, where the footer has them.
    extents: tuple[files.Extent, ...] | None = None

    @property
    def args(self) -> dict[str, Any]:
        """The file as the arguments of a task name it."""
        return {
            "source": str(self.key),
            "path": str(self.path),
            "name": self.name,
            "stamp": list(self.written),
        }


@dataclass(frozen=True, slots=True)
class L1Inputs:
    """Everything that a workflow names, checked."""

    #: Files that can be used, by name.
    frames: tuple[L1File, ...]
    detections: tuple[L1File, ...]
    bad: tuple[InputError, ...]  #: Files that cannot.
    warnings: tuple[Finding, ...]  #: What a user should know before the work starts.
    crs: CRS | None
    unread_frames: tuple[str, ...]  #: Names of the files of frames that cannot be used.
    unanswered: bool  #: Whether there are such files of detections.

    @property
    def sources(self) -> tuple[L1File, ...]:
        """Files that can be used."""
        return (*self.frames, *self.detections)


@dataclass
class L1Ledger(Ledger[L1Inputs, CoincidenceWorkflow]):
    """Inputs and finished tasks of a run."""

    @cached_property
    def tiles(self) -> dict[str, int]:
        """Detections of each tile, itself and those around; complete once the index is."""
        own = Counter[str]()
        for receipt in self.of("index_file").values():
            own.update(receipt.facts["tiles"])
        least = self.workflow.coincidence.bridge_sign.detections_min
        return {tile: n for tile, n in sorted(own.items()) if _with_halo(tile, own) >= least}

    @property
    def answered(self) -> list[list[int]] | None:
        """Numbers of frames whose detections are known, first and last; None where all are.

        A look whose detection lies in a file that cannot be read would count as one without.
        """
        indexed = self.of("index_file")
        if not self.inputs.unanswered and len(indexed) == len(self.inputs.detections):
            return None
        return sorted(receipt.facts["numbers"] for receipt in indexed.values())


def _with_halo(tile: str, own: Counter[str]) -> int:
    i, j = parse_cell(tile)
    return sum(own[f"{p}_{q}"] for p in (i - 1, i, i + 1) for q in (j - 1, j, j + 1))


def index_frames(ledger: L1Ledger) -> Iterator[Task]:
    """Files of frames, each to be read."""
    for file in ledger.inputs.frames:
        yield Task("index_frames", str(file.key), file.args, (), file.rows)


def index_file(ledger: L1Ledger) -> Iterator[Task]:
    """Files of detections, each to be read."""
    done, inputs = ledger.of("index_frames"), ledger.inputs
    unread = [*inputs.unread_frames, *(f.name for f in inputs.frames if str(f.key) not in done)]
    shared = {"frames": sorted(done), "unread_frames": sorted(unread)}
    needs = tuple(("index_frames", key) for key in sorted(done))
    for file in inputs.detections:
        yield Task("index_file", str(file.key), file.args | shared, needs, file.rows)


def coincide_tile(ledger: L1Ledger) -> Iterator[Task]:
    """Tiles whose points are made."""
    frames, files = ledger.of("index_frames"), ledger.of("index_file")
    numbers = {key: receipt.facts["numbers"] for key, receipt in (*frames.items(), *files.items())}
    bounds = [receipt.facts["bounds"] for receipt in files.values()]
    if not bounds:
        return
    heights = [min(b[2] for b in bounds), max(b[5] for b in bounds)]
    halo_m = reach_q(ledger.workflow.coincidence, ledger.workflow.array) / QUANTA_PER_M
    for tile, n in ledger.tiles.items():
        near = [k for k, r in frames.items() if _may_look(r, tile, ledger, halo_m)]
        using = [k for k in files if any(_overlap(numbers[k], numbers[k_near]) for k_near in near)]
        args = {
            "tile": tile,
            "frames": near,
            "reach_m": [frames[k].facts["reach_m"] for k in near],
            "files": using,
            "heights_q": heights,
            "detections": n,
            "answered": ledger.answered,
        }
        needs = [*(("index_frames", k) for k in near), *(("index_file", k) for k in using)]
        yield Task("coincide_tile", tile, args, tuple(needs), n)


def _overlap(one: Sequence[float], other: Sequence[float]) -> bool:
    return one[0] <= other[1] and other[0] <= one[1]


def _may_look(frames: Receipt, tile: str, ledger: L1Ledger, halo_m: float) -> bool:
    """Whether a file's sensor came near enough to a tile to see it."""
    west, east, south, north = frames.facts["places_m"]
    edge, reach = ledger.workflow.tiling.tile_m, frames.facts["reach_m"] + halo_m
    i, j = parse_cell(tile)
    return _overlap((west - reach, east + reach), (i * edge, (i + 1) * edge)) and _overlap(
        (south - reach, north + reach), (j * edge, (j + 1) * edge)
    )


def deliver_tile(ledger: L1Ledger) -> Iterator[Task]:
    """Tiles that are delivered."""
    for tile, receipt in ledger.of("coincide_tile").items():
        n = receipt.facts["points"]
        if n:
            yield Task("deliver_tile", tile, {"tile": tile}, (("coincide_tile", tile),), n)


Run = Prepared[L1Ledger, CoincidenceContext]


class Coincidence(Receiver[L1Ledger, CoincidenceContext]):
    """Detections and looks to points."""

    delivered: ClassVar[tuple[str, ...]] = ("points/*",)

    ledger = L1Ledger

    def gather(self, workflow: CoincidenceWorkflow, base: Path, output: Path) -> L1Inputs:
        """Find and check every file of a workflow, from headers alone."""
        faults: list[str] = []
        named = {}
        for key in ("frames", "detections"):
            named[key] = expand(getattr(workflow.survey, key), base, f"survey.{key}", faults)
            refuse_own(named[key], output, f"survey.{key}", faults)
        crs = projected_crs(workflow.survey.crs, "survey.crs", faults)
        if faults:
            raise WorkflowError("; ".join(faults))
        frames, no_frames = usable(named["frames"], base, partial(_look, Frames))
        detections, no_detections = usable(named["detections"], base, partial(_look, Detections))
        bad = (*no_frames, *no_detections)
        check_keys((*frames, *detections))
        if not frames or not detections:
            reasons = "; ".join(map(str, bad)) or "survey.frames and survey.detections hold no rows"
            raise WorkflowError(f"no input is usable: {reasons}")
        warnings = [] if crs is not None else [Finding("K01", {"kind": "crs"})]
        known = {file.path for file in (*frames, *detections)} | {Path(e.path) for e in bad}
        empty = [path for paths in named.values() for path in paths if path not in known]
        warnings += [Finding("K01", {"kind": "empty"}, name_below(p, base)) for p in empty]
        without = tuple(name_below(Path(error.path), base) for error in no_frames)
        unanswered = bool(no_detections)
        return L1Inputs(frames, detections, bad, tuple(warnings), crs, without, unanswered)

    def cost(self, prepared: Run) -> Cost:
        """What a run is expected to cost."""
        ledger, context = prepared.ledger, prepared.context
        inputs, chosen = ledger.inputs, ledger.workflow.coincidence
        detections = sum(file.rows for file in inputs.detections)
        tiles, held = _tiles(ledger)
        rates, measured = measured_rates(RATES_POINTS_PER_S, context)
        voxels = (chosen.volume_voxels + 2 * halo(chosen) + 2) ** 3
        most_frames = max(file.rows for file in inputs.frames)
        # Peak memory [byte], what takes it, and what helps.
        needs = [
            # Four rasters, and points.
            (60 * voxels, "a sub-volume", "a smaller coincidence.volume_voxels"),
            # Detections are indexed a stretch at a time, whatever the size of their file.
            (100 * 2**20, "a file's index", ""),
            # Frames of a file are sorted at once.
            (400 * most_frames, "a file of frames", "split the files of frames"),
            # Detections of all frames that look at it.
            (round(held * 150), "a tile", "a smaller tiling.tile_m"),
        ]
        most, heaviest, remedy = max(needs)
        return Cost(
            points=detections,
            tasks=len(inputs.sources) + 2 * tiles,
            disk_bytes=detections * (16 + 12),  # In the store, and delivered.
            memory_bytes=WORKER_BASE_BYTES + most,
            heaviest=heaviest,
            remedy=remedy,
            stages_s={stage: detections / rate for stage, rate in rates.items()},
            workers=ledger.workers,
            measured=measured,
        )

    def plan_rows(self, prepared: Run, cost: Cost) -> list[tuple[str, str]]:  # noqa: ARG002 - all have it
        """Label and value of what a plan prints beside disk, memory and time."""
        workflow = prepared.context.workflow
        frames = sum(file.rows for file in prepared.ledger.inputs.frames)
        return [
            ("frames", f"{grouped(frames)} of {grouped(workflow.array.detectors)} looks each"),
            ("voxels", f"{workflow.voxel_q} mm, tiles of {workflow.tiling.tile_m:g} m"),
        ]

    def after(self, step: Step, prepared: Run, failed: Sequence[Receipt]) -> Iterable[Finding]:
        """Stop where no file could be read."""
        if step.name in {"index_frames", "index_file"} and not prepared.ledger.of(step.name):
            none_usable(failed, {step.name})
        if step.name == "index_frames":
            _refuse_twice(prepared.ledger)
        if step.name == "index_file" and prepared.ledger.answered is not None:
            yield Finding("K01", {"kind": "unread"})

    def not_read(self, ledger: L1Ledger) -> int:
        """Detections that files promise which could not be read to their end [count]."""
        indexed = ledger.of("index_file")
        return sum(f.rows for f in ledger.inputs.detections if str(f.key) not in indexed)

    def screen(self, report: Any) -> list[tuple[str, str]]:
        """Label and value of each number that the console shows after a run."""
        from spl_batch.geiger.coincidence.report.summarise import cards  # noqa: PLC0415 - draws

        return card_rows(cards(report), report)

    def results(self, output: Path) -> list[tuple[str, list[Path]]]:
        """What a user looks at first."""
        return [("report", [output / "report.html"]), ("points", [output / "points"])]


def _look(kind: type[Table], path: Path, name: str, key: int) -> L1File | None:
    written = stamp(path)
    rows = files.inspect(path, kind.types())
    return L1File(path, name, key, rows, written, files.extents(path)) if rows else None


def _tiles(ledger: L1Ledger) -> tuple[int, float]:
    """Number of tiles, and detections of the frames that look at the fullest of them.

    As if each row group spread its rows evenly over its extent; where a file's footer has no
    extents, all its rows count to every tile.
    """
    array, tile_q = ledger.workflow.array, ledger.workflow.tile_q
    # From the side looks reach a tile from 5 cm away for each metre of the gate.
    around_m = 0.5 * 0.05 * (array.gate_stop_m - array.gate_start_m)
    around_m += 0.5 * max(array.rows, array.columns) * array.ifov_rad * array.gate_stop_m
    inputs = ledger.inputs.detections
    boxes = [
        Box(Bounds(quanta(west), quanta(south), quanta(east) + 1, quanta(north) + 1), rows)
        for file in inputs
        for west, south, east, north, rows in file.extents or ()
    ]
    pieces = list(density.from_boxes(boxes, tile_q))
    fullest = density.largest(piece.peak(tile_q, quanta(around_m)) for piece in pieces)
    anywhere = sum(file.rows for file in inputs if file.extents is None)
    return sum(piece.units(tile_q) for piece in pieces), fullest.points + anywhere


def _refuse_twice(ledger: L1Ledger) -> None:
    """Stop where frames of two files share numbers."""
    done = ledger.of("index_frames").values()
    spans = sorted((*receipt.facts["numbers"], receipt.facts["name"]) for receipt in done)
    for (_, last, one), (first, _, other) in pairwise(spans):
        if first <= last:
            text = (
                f"{one} and {other}: frames run to {last} in the one and from {first} in the other"
            )
            raise WorkflowError(f"{text}; number frames through, file after file")


RECEIVER: Final[Receiver[Any, Any]] = Coincidence()
"""The one there is."""
