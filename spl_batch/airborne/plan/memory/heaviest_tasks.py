"""What the heaviest tasks of a survey hold in memory, told by the headers of its files."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Final, NamedTuple

from spl_batch.airborne.plan.ground_cells import GroundCells
from spl_batch.airborne.plan.halo import filter_reach_m, halo_m, surface_reach_m
from spl_batch.airborne.plan.memory.cell_memory import cell_parts
from spl_batch.airborne.plan.task_memory import (
    LEAST_PART_Q,
    NAMES,
    UNEVEN,
    part_bytes,
    task_bytes,
)
from spl_batch.airborne.settings.workflow import Workflow
from spl_batch.airborne.steps import STEPS
from spl_batch.airborne.tasks.delivery import PASS_POINTS
from spl_batch.airborne.tasks.index import CHUNK_POINTS
from spl_batch.constants import QUANTUM_M
from spl_batch.engine.plan.worker_memory import LOADED_BASE_BYTES, usable_bytes
from spl_batch.engine.tasks.input_changes import stamp_if_there
from spl_batch.errors import grouped
from spl_batch.formats.trajectory.merge import WAITING_RECORDS
from spl_batch.lattice.density import Box, Peak, Piece, largest
from spl_batch.lattice.eastings import Eastings
from spl_batch.lattice.tiles import grow, quanta

BYTES_PER_LABEL: Final = 3
"""Labels of a point of the file that is delivered [byte]."""

BYTES_PER_DIAGNOSTIC: Final = 9
"""And where diagnostics are delivered [byte]."""

BYTES_PER_RECORD: Final = 200
"""A trajectory's record that waits for its place in time [byte]."""

RECORD_BYTES: Final[Mapping[str, int]] = MappingProxyType(
    {".out": 136, ".sbet": 136, ".parquet": 20, ".pq": 20}
)
"""Size of a trajectory's record on disk, at the least [byte]."""

CSV_RECORD_BYTES: Final = 30
"""The same where a record is a line of text [byte]."""


class Need(NamedTuple):
    """Memory of a task."""

    task: str  #: What it is, and where.
    memory_bytes: int
    remedy: str  #: How to make it lighter, beside more memory.
    kind: str = ""  #: Of a ground cell: what is done with it.
    parts: int = 1  #: And in how many parts [count].


def needs(
    pieces: Sequence[Piece],
    workflow: Workflow,
    stretch_points: int,
    *,
    files: Sequence[int],
    limit: int,
    boxes: Sequence[Box] = (),
    trajectory: Iterable[Path] = (),
) -> list[Need]:
    """Memory of the heaviest task of each kind.

    Parameters
    ----------
    pieces : sequence of Piece
        Where the points lie.
    stretch_points : int
        Points that a stretch holds on average [count].
    files : sequence of int
        Points of each file of the survey [count].
    limit : int
        Memory limit of a worker: what does not fit is done in parts, where it can be [byte].
    boxes : sequence of Box
        Bounding boxes of its files: ground cells at its edge own what is left over there.
    """
    tile_q = quanta(workflow.tiling.tile_m)
    tiles = largest(piece.peak(tile_q, 0) for piece in pieces)
    found = [_need("build_tile", tiles), _part(pieces, workflow, limit)]
    found += _cells(pieces, workflow, limit, boxes)
    points = sum(files)
    stretch = min(points, UNEVEN * stretch_points)
    labels = min(max(files, default=0), PASS_POINTS) * BYTES_PER_LABEL
    labels += labels // BYTES_PER_LABEL * BYTES_PER_DIAGNOSTIC * workflow.outputs.diagnostics
    chunk = min(points, CHUNK_POINTS)
    records = sum(_records(path) for path in trajectory)
    if workflow.outputs.copc:
        octree = max(files, default=0)
        task = f"{NAMES['deliver_copc']} with {grouped(octree)} points"
        found.append(Need(task, task_bytes("deliver_copc", octree), STEPS["deliver_copc"].remedy))
    return [
        *found,
        Need("reading a file", task_bytes("index_file", chunk), ""),
        Need("a stretch of a flightline", task_bytes("scatter", stretch), ""),
        Need(
            "a file's labels",
            task_bytes("deliver_tile", tiles.points) + labels,
            "lower tiling.tile_m",
        ),
        Need(
            f"a trajectory of about {grouped(records)} records",
            LOADED_BASE_BYTES + min(records, WAITING_RECORDS) * BYTES_PER_RECORD,
            "",
        ),
    ]


def _cells(
    pieces: Sequence[Piece], workflow: Workflow, limit: int, boxes: Sequence[Box]
) -> Iterator[Need]:
    """The ground cells that read most; the points of a file spread evenly over its box."""
    edge = quanta(workflow.ground.cell_m)
    cells = GroundCells.of_workflow((box.bounds for box in boxes), workflow)
    for kind, reach_m in (
        ("ground", workflow.ground.buffer_m),
        ("surface", surface_reach_m(workflow)),
        ("strip_patches", 0.0),
    ):
        reach = quanta(reach_m)
        squares = (piece.peak(edge, reach) for piece in pieces)
        peak = largest([largest(squares), cells.fullest_joined(boxes, reach)])
        slabs = boxes or [Box(grow(peak.core, reach), peak.points)]
        spread = partial(Eastings.of_slabs, slabs)
        parts = cell_parts(kind, peak.core, spread, workflow, limit)
        need = _need(kind, peak, parts.memory_bytes)
        yield need._replace(kind=kind, parts=parts.strips)


def _part(pieces: Sequence[Piece], workflow: Workflow, limit: int) -> Need:
    """The fullest denoise block, or the fullest of the largest parts of blocks that fit."""
    edge = (workflow.tiling.block_tiles or 1) * quanta(workflow.tiling.tile_m)
    halo, near = quanta(halo_m(workflow)), quanta(filter_reach_m(workflow))

    def fullest(reach: int) -> Peak:
        return largest(piece.peak(edge, reach) for piece in pieces)

    peak, usable = fullest(halo), usable_bytes(limit)
    if task_bytes("denoise", peak.points) <= usable:
        return _need("denoise", peak)
    needed = usable + 1
    while needed > usable and edge >= 2 * LEAST_PART_Q:
        edge //= 2
        peak = fullest(halo)
        needed = part_bytes(peak.points, fullest(near).points)
    return _need("denoise", peak, needed)


def _need(kind: str, peak: Peak, needed: int | None = None) -> Need:
    """What the fullest task of a kind needs."""
    most = task_bytes(kind, peak.points) if needed is None else needed
    return Need(_place(kind, peak), most, STEPS[kind].remedy)


def _place(kind: str, peak: Peak) -> str:
    x, y = (sum(ends) / 2 * QUANTUM_M for ends in (peak.core[::2], peak.core[1::2]))
    return f"{NAMES[kind]} around x {x:.0f}, y {y:.0f} with {grouped(peak.points)} points in reach"


def _records(path: Path) -> int:
    size = RECORD_BYTES.get(path.suffix.lower(), CSV_RECORD_BYTES)
    return stamp_if_there(path)[0] // size
