"""Plan of coincidence processing: inputs, steps, cost."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

from pyproj import CRS

from spl_batch.constants import QUANTA_PER_M
from spl_batch.engine.findings import Finding
from spl_batch.engine.plan.budget import Cost, measured_rates
from spl_batch.engine.plan.input_files import check_keys, expand, name_below, refuse_own, usable
from spl_batch.engine.plan.worker_memory import WORKER_BASE_BYTES
from spl_batch.engine.tasks.context import RunContext
from spl_batch.engine.tasks.input_changes import stamp
from spl_batch.engine.tasks.ledger import Ledger
from spl_batch.engine.tasks.task import Receipt, Task
from spl_batch.errors import InputError, WorkflowError
from spl_batch.formats.crs import projected_crs
from spl_batch.geiger.coincidence.formats import l1_files as files
from spl_batch.geiger.coincidence.settings import CoincidenceWorkflow
from spl_batch.geiger.coincidence.surface.coincide import halo, reach_q
from spl_batch.geiger.coincidence.tables import Detections, Frames
from spl_batch.lattice import density
from spl_batch.lattice.density import Box
from spl_batch.lattice.tiles import Bounds, parse_cell, quanta

RATES_POINTS_PER_S: Final[Mapping[str, float]] = MappingProxyType(
    {"index": 0.4e6, "coincidence": 30_000.0, "deliver": 0.5e6}
)
"""Detections per second and worker until a store has measured its own; points when delivering.
``python -m benchmarks.geiger.coincidence.known_scene`` prints them."""

INDEX_BYTES: Final = 100 * 2**20
"""Peak memory of indexing detections, of a file of any size [byte]."""

INDEX_BYTES_PER_FRAME: Final = 400
"""Peak memory of indexing a file of frames, which is sorted at once [byte]."""

BYTES_PER_VOXEL: Final = 60
"""Peak memory per voxel of a sub-volume: four rasters and its points [byte]."""

HELD_BYTES_PER_DETECTION: Final = 150
"""Peak memory of a tile by the detections of all frames that look at it [byte]."""

SLANT: Final = 0.05
"""Distance from which looks reach a tile from the side, per metre of gate [m/m]."""

STORE_BYTES_PER_DETECTION: Final = 16
DELIVERED_BYTES_PER_DETECTION: Final = 12


@dataclass(frozen=True, slots=True)
class L1File:
    """An input file that can be used."""

    path: Path  #: Where it lies.
    name: str
    key: int
    rows: int  #: Frames or detections in it [count].
    #: Its size [byte] and time of writing [ns since 1970] when it was looked at.
    written: tuple[int, int]
    #: Of each row group west, south, east, north [m] and its rows, where the footer tells them.
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
    #: Names of the files that cannot be used.
    unread_frames: tuple[str, ...]
    unread_detections: tuple[str, ...]

    @property
    def sources(self) -> tuple[L1File, ...]:
        """Files that can be used."""
        return (*self.frames, *self.detections)


def gather(workflow: CoincidenceWorkflow, base: Path, output: Path) -> L1Inputs:
    """Find and check every file of a workflow, from headers alone.

    ``output``: folder of the results: no input may lie there.

    Raises
    ------
    WorkflowError
        If the request as a whole is wrong; one line with every fault.
    """
    faults: list[str] = []
    named = {
        key: expand(getattr(workflow.survey, key), base, f"survey.{key}", faults)
        for key in ("frames", "detections")
    }
    for key, paths in named.items():
        refuse_own(paths, output, f"survey.{key}", faults)
    crs = projected_crs(workflow.survey.crs, "survey.crs", faults)
    if faults:
        raise WorkflowError("; ".join(faults))
    frames, bad = usable(named["frames"], base, partial(_look, Frames.names()))
    detections, more = usable(named["detections"], base, partial(_look, Detections.names()))
    without, bad = len(bad), [*bad, *more]
    unread = [name_below(Path(error.path), base) for error in bad]
    check_keys((*frames, *detections))
    if not frames or not detections:
        reasons = "; ".join(map(str, bad)) or "survey.frames and survey.detections hold no rows"
        raise WorkflowError(f"no input is usable: {reasons}")
    warnings = [] if crs is not None else [Finding("K01", {"kind": "crs"})]
    known = {file.path for file in (*frames, *detections)} | {Path(e.path) for e in bad}
    empty = [path for paths in named.values() for path in paths if path not in known]
    warnings += [Finding("K01", {"kind": "empty"}, name_below(p, base)) for p in empty]
    return L1Inputs(
        frames=frames,
        detections=detections,
        bad=tuple(bad),
        warnings=tuple(warnings),
        crs=crs,
        unread_frames=tuple(unread[:without]),
        unread_detections=tuple(unread[without:]),
    )


def _look(columns: Sequence[str], path: Path, name: str, key: int) -> L1File | None:
    written = stamp(path)
    rows = files.inspect(path, columns)
    return L1File(path, name, key, rows, written, files.extents(path)) if rows else None


@dataclass
class L1Ledger(Ledger[L1Inputs, CoincidenceWorkflow]):
    """Inputs and finished tasks of a run."""

    @cached_property
    def tiles(self) -> dict[str, int]:
        """Detections of each tile, itself and those around; complete once the index is."""
        own: dict[str, int] = {}
        for receipt in self.of("index_file").values():
            for tile, n in receipt.facts["tiles"].items():
                own[tile] = own.get(tile, 0) + n
        return {tile: n for tile, n in sorted(own.items()) if _with_halo(tile, own) >= self.least}

    @property
    def answered(self) -> list[list[int]] | None:
        """Numbers of frames whose detections are known, first and last; None where all are.

        A look whose detection lies in a file that cannot be read would count as one without.
        """
        indexed = self.of("index_file")
        if not self.inputs.unread_detections and len(indexed) == len(self.inputs.detections):
            return None
        return sorted(r.facts["numbers"] for r in indexed.values() if r.facts["numbers"])

    @property
    def least(self) -> int:
        """Detections that a tile needs for anything to be found in it [count]."""
        return self.workflow.coincidence.bridge_sign.detections_min


def _with_halo(tile: str, own: Mapping[str, int]) -> int:
    i, j = parse_cell(tile)
    return sum(own.get(f"{p}_{q}", 0) for p in (i - 1, i, i + 1) for q in (j - 1, j, j + 1))


def frames(ledger: L1Ledger) -> Iterator[Task]:
    """Files of frames, each to be read."""
    for file in ledger.inputs.frames:
        yield Task("frames", str(file.key), file.args, (), file.rows)


def index_file(ledger: L1Ledger) -> Iterator[Task]:
    """Files of detections, each to be read."""
    done, inputs = ledger.of("frames"), ledger.inputs
    unread = [*inputs.unread_frames, *(f.name for f in inputs.frames if str(f.key) not in done)]
    shared = {"frames": sorted(done), "unread_frames": sorted(unread)}
    needs = tuple(("frames", key) for key in shared["frames"])
    for file in inputs.detections:
        yield Task("index_file", str(file.key), {**file.args, **shared}, needs, file.rows)


def coincide(ledger: L1Ledger) -> Iterator[Task]:
    """Tiles whose points are made."""
    frames = {k: r for k, r in ledger.of("frames").items() if r.facts["frames"]}
    files = {k: r for k, r in ledger.of("index_file").items() if r.facts["points"]}
    if not files:
        return
    heights = [
        min(r.facts["bounds"][2] for r in files.values()),
        max(r.facts["bounds"][5] for r in files.values()),
    ]
    halo_m = reach_q(ledger.workflow.coincidence, ledger.workflow.array) / QUANTA_PER_M
    for tile, n in ledger.tiles.items():
        near = [k for k, r in frames.items() if _may_look(r, tile, ledger, halo_m)]
        spans = [frames[k].facts["numbers"] for k in near]
        using = [k for k, r in files.items() if _shares(r.facts["numbers"], spans)]
        args = {
            "tile": tile,
            "frames": near,
            "reach_m": [frames[k].facts["reach_m"] for k in near],
            "files": using,
            "heights_q": heights,
            "detections": n,
            "answered": ledger.answered,
        }
        needs = [*(("frames", k) for k in near), *(("index_file", k) for k in using)]
        yield Task("coincide", tile, args, tuple(needs), n)


def _may_look(frames: Receipt, tile: str, ledger: L1Ledger, halo_m: float) -> bool:
    """Whether a file's sensor came near enough to a tile to see it."""
    west, east, south, north = frames.facts["places_m"]
    edge, reach = ledger.workflow.tiling.tile_m, frames.facts["reach_m"] + halo_m
    i, j = parse_cell(tile)
    return bool(
        west - reach <= (i + 1) * edge
        and east + reach >= i * edge
        and south - reach <= (j + 1) * edge
        and north + reach >= j * edge
    )


def _shares(numbers: Sequence[int], spans: Sequence[Sequence[int]]) -> bool:
    return any(numbers[0] <= last and first <= numbers[1] for first, last in spans)


def deliver_tile(ledger: L1Ledger) -> Iterator[Task]:
    """Tiles that are delivered."""
    for tile, receipt in ledger.of("coincide").items():
        n = receipt.facts["points"]
        if n:
            yield Task("deliver_tile", tile, {"tile": tile}, (("coincide", tile),), n)


def estimate(ledger: L1Ledger, context: RunContext[CoincidenceWorkflow] | None) -> Cost:
    """Cost of a run, from the headers of its files."""
    inputs, chosen = ledger.inputs, ledger.workflow.coincidence
    detections = sum(file.rows for file in inputs.detections)
    tiles, held = _tiles(ledger)
    rates, measured = measured_rates(RATES_POINTS_PER_S, context)
    volume = BYTES_PER_VOXEL * (chosen.volume_voxels + 2 * halo(chosen)) ** 3
    needs = [
        (volume, "a sub-volume", "a smaller coincidence.volume_voxels"),
        (INDEX_BYTES, "a file's index", ""),
        (
            INDEX_BYTES_PER_FRAME * max(file.rows for file in inputs.frames),
            "a file of frames",
            "split the files of frames",
        ),
        (round(held * HELD_BYTES_PER_DETECTION), "a tile", "a smaller tiling.tile_m"),
    ]
    most, heaviest, remedy = max(needs)
    return Cost(
        points=detections,
        tasks=len(inputs.sources) + 2 * tiles,
        disk_bytes=detections * (STORE_BYTES_PER_DETECTION + DELIVERED_BYTES_PER_DETECTION),
        memory_bytes=WORKER_BASE_BYTES + most,
        heaviest=heaviest,
        remedy=remedy,
        stages_s={stage: detections / rate for stage, rate in rates.items()},
        workers=ledger.workers,
        measured=measured,
    )


def _tiles(ledger: L1Ledger) -> tuple[int, float]:
    """Number of tiles, and detections of the frames that look at the fullest of them.

    As if each row group spread its rows evenly over its extent; where a file's footer tells no
    extents, all its rows count to every tile.
    """
    array, tile_q = ledger.workflow.array, ledger.workflow.tile_q
    around_m = 0.5 * SLANT * (array.gate_stop_m - array.gate_start_m)
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
