"""What the heaviest tasks of a survey hold in memory, by the headers of its files."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Final, NamedTuple

from spl_batch.airborne.plan.halo import halo_m, surface_reach_m
from spl_batch.airborne.plan.task_memory import (
    NAMES,
    STRETCH_POINTS,
    UNEVEN,
    cell_bytes,
    remedy,
    task_bytes,
)
from spl_batch.airborne.settings.workflow import Workflow
from spl_batch.airborne.steps import STEPS
from spl_batch.airborne.tasks.delivery import PASS_POINTS
from spl_batch.airborne.tasks.index import CHUNK_POINTS
from spl_batch.constants import QUANTUM_M
from spl_batch.engine.plan.worker_memory import LOADED_BASE_BYTES
from spl_batch.engine.tasks.input_changes import stamp_if_there
from spl_batch.errors import grouped
from spl_batch.formats.trajectory.positions import WAITING_RECORDS
from spl_batch.lattice.density import Piece, largest
from spl_batch.lattice.tiles import quanta

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


def needs(
    pieces: Sequence[Piece],
    workflow: Workflow,
    files: Sequence[int],
    side: int,
    trajectory: Iterable[Path] = (),
) -> list[Need]:
    """Memory of the heaviest task of each kind.

    Parameters
    ----------
    pieces : sequence of Piece
        Where the points lie.
    files : sequence of int
        Points of each file of the survey [count].
    side : int
        Tiles along one side of a cell of ``denoise`` [count].
    """
    points, most = sum(files), max(files, default=0)
    labels = min(most, PASS_POINTS) * BYTES_PER_LABEL
    labels += labels // BYTES_PER_LABEL * BYTES_PER_DIAGNOSTIC * workflow.outputs.diagnostics
    records = sum(_records(path) for path in trajectory)
    found = list(_cells(pieces, workflow, side))
    if workflow.outputs.copc:
        task = f"{NAMES['deliver_copc']} with {grouped(most)} points"
        found.append(Need(task, task_bytes("deliver_copc", most), STEPS["deliver_copc"].remedy))
    tiles = largest(piece.peak(quanta(workflow.tiling.tile_m), 0) for piece in pieces)
    return [
        *found,
        Need("reading a file", task_bytes("index_file", min(points, CHUNK_POINTS)), ""),
        Need(
            "a stretch of a flightline",
            task_bytes("scatter", min(points, UNEVEN * STRETCH_POINTS)),
            "",
        ),
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


def _cells(pieces: Sequence[Piece], workflow: Workflow, side: int) -> Iterator[Need]:
    """The cells that read most; the points of a file spread evenly over its box."""
    tile_m, cell_m = workflow.tiling.tile_m, workflow.ground.cell_m
    for kind, edge_m, margin_m in (
        ("build_tile", tile_m, 0.0),
        ("denoise", side * tile_m, halo_m(workflow)),
        ("ground", cell_m, workflow.ground.buffer_m),
        ("surface", cell_m, surface_reach_m(workflow)),
        ("strip_patches", cell_m, 0.0),
    ):
        peak = largest(piece.peak(quanta(edge_m), quanta(margin_m)) for piece in pieces)
        x, y = (sum(ends) / 2 * QUANTUM_M for ends in (peak.core[::2], peak.core[1::2]))
        place = f"around x {x:.0f}, y {y:.0f} with {grouped(peak.points)} points in reach"
        needed = cell_bytes(kind, peak.core, peak.points, workflow)
        yield Need(f"{NAMES[kind]} {place}", needed, remedy(kind, peak.points, needed))


def _records(path: Path) -> int:
    size = RECORD_BYTES.get(path.suffix.lower(), CSV_RECORD_BYTES)
    return stamp_if_there(path)[0] // size
