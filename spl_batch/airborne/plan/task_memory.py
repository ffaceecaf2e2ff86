"""What tasks hold in memory, and which of them cannot fit into a worker.

A task's need is that of a worker that has loaded its kernels and the points that the
task holds at once times the bytes of each; `benchmarks/engine/memory.py` measures them.
"""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Final, NamedTuple

from spl_batch.airborne.ground.multiscale_surface import BLOCK_M
from spl_batch.airborne.plan.ground_cells import GroundCells
from spl_batch.airborne.plan.halo import halo_m, surface_reach_m
from spl_batch.airborne.settings.workflow import Workflow
from spl_batch.airborne.tasks.delivery import PASS_POINTS
from spl_batch.airborne.tasks.index import CHUNK_POINTS
from spl_batch.airborne.tasks.surfaces import strip_q
from spl_batch.constants import QUANTUM_M
from spl_batch.engine.plan.worker_memory import (
    LOADED_BASE_BYTES,
    USABLE_SHARE,
    enough_mib,
    usable_bytes,
)
from spl_batch.errors import grouped
from spl_batch.formats.trajectory.merge import WAITING_RECORDS
from spl_batch.lattice.density import Box, Peak, Piece, largest
from spl_batch.lattice.tiles import Bounds, quanta

BYTES_PER_POINT: Final[Mapping[str, int]] = MappingProxyType(
    {
        "index_file": 300,
        "gather": 380,
        "gather_range": 300,
        "observe": 380,
        "scatter": 540,
        "build_tile": 280,
        "denoise": 150,
        "denoise_part": 100,
        "ground": 215,
        "strip_patches": 80,
        "surface": 150,
        "deliver_tile": 280,
        "deliver_copc": 280,
        "accuracy": 300,
    }
)
"""Peak memory of a task by each of the points that it holds at once [byte]."""

BAND_BYTES: Final = 300
"""Memory of a ground cell that is done in bands, by each point of a band: twice that of a cell at
once, as tiles are read whole [byte]."""

BANDED_LABEL_BYTES: Final = 60
"""And by each point that the cell owns, whose labels are put in order [byte]."""

CELL_BYTES: Final = 72 * 2**20
"""Memory of a surface cell that is done in strips: its rasters and squares, whatever it holds."""

GATHERED_BYTES: Final = 33
"""And by each of its points: what all strips tell [byte]."""

STRIP_BYTES: Final = 150
"""And by each point of a strip [byte]."""

STRIP_COST: Final = 0.08
"""Time that a surface cell takes longer with each further strip, over that of one at once."""

LEAST_PART_Q: Final = quanta(12.5)
"""Least side of a part that a block is cut into where memory is short [quanta]: smaller ones would
read little but their halo."""

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

STRETCH_POINTS: Final = 2_000_000
"""Points that a stretch holds on average, where memory allows [count]."""

LEAST_STRETCH_POINTS: Final = 125_000
"""The same in the smallest worker [count]."""

UNEVEN: Final = 2
"""A stretch is a span of time: where much returns, it holds more than the average, up to this."""


class Need(NamedTuple):
    """Memory of a task."""

    task: str  #: What it is, and where.
    memory_bytes: int
    remedy: str  #: How to make it lighter, beside more memory.
    kind: str = ""  #: Of a ground cell: what is done with it.
    parts: int = 1  #: And in how many parts [count].


def task_bytes(kind: str, points: float) -> int:
    """Memory of a task that holds so many points, its worker included [byte]."""
    return LOADED_BASE_BYTES + int(points * BYTES_PER_POINT[kind])


def stretch_bytes(points: int) -> int:
    """Memory of a task on the fullest stretch, where they hold so many points on average [byte]."""
    return task_bytes("scatter", UNEVEN * points)


def points_within(kind: str, limit: int) -> int:
    """Points that a task can hold within a worker's memory limit [count]."""
    return max(usable_bytes(limit) - LOADED_BASE_BYTES, 0) // BYTES_PER_POINT[kind]


def part_points(limit: int) -> tuple[int, int]:
    """Points that a denoise block may hold, and that a part of one may [count].

    A part is small beside its halo, of which the outer half is looked at for haze alone.
    """
    return points_within("denoise", limit), points_within("denoise_part", limit)


def ground_bands(
    points: float, owned: float, side_q: int, workflow: Workflow, limit: int
) -> tuple[int, int]:
    """Fewest bands in which the ground of a cell can be found in memory: 1 where all of it fits.

    Parameters
    ----------
    points, owned : float
        Points of the cell with its buffer, and of the cell alone [count].
    workflow : Workflow
        Only the method that follows the data works in bands, and only without water.
    limit : int
        Memory limit of a worker [byte].

    Returns
    -------
    bands : int
        How many [count].
    memory_bytes : int
        What the task needs in them, its worker included [byte].
    """
    whole = task_bytes("ground", points)
    if whole <= usable_bytes(limit):
        return 1, whole
    if workflow.ground.method != "multiscale" or workflow.water is not None:
        return 1, whole
    labels = LOADED_BASE_BYTES + int(owned * BANDED_LABEL_BYTES)
    return _fewest_parts(side_q // quanta(BLOCK_M), labels, points * BAND_BYTES, limit)


def surface_strips(points: float, width_q: int, narrowest_q: int, limit: int) -> tuple[int, int]:
    """Fewest strips in which a surface cell fits into memory: 1 where all of it does.

    Parameters
    ----------
    points : float
        Points of the cell and its margin [count].
    width_q : int
        Its width, margin included [quanta].
    narrowest_q : int
        Width of the narrowest strip (:func:`~spl_batch.airborne.tasks.surfaces.strip_q`) [quanta].
    limit : int
        Memory limit of a worker [byte].

    Returns
    -------
    strips : int
        How many [count].
    memory_bytes : int
        What the task needs in them, its worker included [byte].
    """
    needed = task_bytes("surface", points)
    if needed <= usable_bytes(limit):
        return 1, needed
    gathered = LOADED_BASE_BYTES + CELL_BYTES + int(points * GATHERED_BYTES)
    return _fewest_parts(width_q // narrowest_q, gathered, points * STRIP_BYTES, limit)


def _fewest_parts(most: int, held: int, dealt: float, limit: int) -> tuple[int, int]:
    """Fewest parts, two or more, in which what they share fits beside what is held whole.

    Parameters
    ----------
    most : int
        No more parts than these, or two [count].
    held, dealt : int, float
        What each part takes in any case, and what all of them share [byte].
    limit : int
        Memory limit of a worker [byte].

    Returns
    -------
    parts : int
        How many; as many as there may be where none fits [count].
    memory_bytes : int
        What one of them needs [byte].
    """
    for parts in range(2, max(most, 2) + 1):
        needed = held + int(dealt / parts)
        if needed <= usable_bytes(limit):
            break
    return parts, needed


def strips_cost(strips: int) -> float:
    """Time of a surface cell in strips, over that of one at once."""
    return 1.0 + STRIP_COST * (strips - 1)


def stretch_points(limit: int) -> int:
    """Points that a stretch should hold on average under a memory limit [count].

    Halved as long as a full one does not fit, so that a run that is continued with a
    little more memory finds its stretches again.
    """
    points = STRETCH_POINTS
    while points > LEAST_STRETCH_POINTS and UNEVEN * points > points_within("scatter", limit):
        points //= 2
    return points


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
    cells = GroundCells.of_workflow((box.bounds for box in boxes), workflow)
    for kind, reach_m in (
        ("ground", workflow.ground.buffer_m),
        ("surface", surface_reach_m(workflow)),
    ):
        reach = quanta(reach_m)
        squares = (piece.peak(quanta(workflow.ground.cell_m), reach) for piece in pieces)
        peak = largest([largest(squares), cells.fullest_joined(boxes, reach)])
        if kind == "ground":
            side = longer_side(peak.core)
            owned = peak.points * (side / (side + 2 * reach)) ** 2
            parts, needed = ground_bands(peak.points, owned, side + 2 * reach, workflow, limit)
        else:
            width = peak.core.xmax - peak.core.xmin + 2 * reach
            parts, needed = surface_strips(peak.points, width, strip_q(workflow), limit)
        found.append(_need(kind, peak, needed)._replace(kind=kind, parts=parts))
    points = sum(files)
    stretch = min(points, UNEVEN * stretch_points)
    labels = min(max(files, default=0), PASS_POINTS) * BYTES_PER_LABEL
    labels += labels // BYTES_PER_LABEL * BYTES_PER_DIAGNOSTIC * workflow.outputs.diagnostics
    chunk = min(points, CHUNK_POINTS)
    records = sum(_records(path) for path in trajectory)
    if workflow.outputs.copc:
        octree = max(files, default=0)
        task = f"{NAMES['deliver_copc']} with {grouped(octree)} points"
        found.append(Need(task, task_bytes("deliver_copc", octree), REMEDIES["deliver_copc"]))
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


REMEDIES: Final[Mapping[str, str]] = MappingProxyType(
    {
        "build_tile": "lower tiling.tile_m",
        "denoise": "lower tiling.tile_m",
        "ground": "lower ground.cell_m or ground.buffer_m",
        "strip_patches": "lower ground.cell_m",
        "surface": "lower ground.cell_m or products.void_max_m",
        "accuracy": "cut the reference into files that fill their bounding boxes evenly",
        "deliver_copc": "set outputs.copc: false, and outputs.tiles: copc for octrees by tile",
    }
)
"""What makes a task lighter, by its kind."""

NAMES: Final[Mapping[str, str]] = MappingProxyType(
    {
        "build_tile": "a tile",
        "denoise": "a denoise block",
        "ground": "a ground cell",
        "strip_patches": "a ground cell whose flightlines are compared",
        "surface": "a surface cell",
        "accuracy": "a square of the reference",
        "deliver_copc": "an octree of a cloud",
    }
)
"""What a kind of task is called, in words."""


def refusal(kind: str, points: float, limit: int, needed: int | None = None) -> str:
    """Why a task cannot be started, and what helps; empty if it can.

    Parameters
    ----------
    limit : int
        Memory limit of a worker [byte].
    needed : int, optional
        What it needs, where that is not told by its points alone [byte].
    """
    needed = task_bytes(kind, points) if needed is None else needed
    if needed <= usable_bytes(limit):
        return ""
    return (
        f"{NAMES[kind]} with {grouped(points)} points in reach needs about "
        f"{grouped(needed / 2**20)} MiB, more than {100 * USABLE_SHARE:.0f} % of --memory "
        f"{grouped(limit / 2**20)} MiB; raise it to {enough_mib(needed)}MiB or {REMEDIES[kind]}"
    )


def longer_side(region: Bounds) -> int:
    """Longer side of a region [quanta]."""
    return max(region.xmax - region.xmin, region.ymax - region.ymin)


def _part(pieces: Sequence[Piece], workflow: Workflow, limit: int) -> Need:
    """The fullest denoise block, or the fullest of the largest parts of blocks that fit."""
    edge = (workflow.tiling.block_tiles or 1) * quanta(workflow.tiling.tile_m)
    halo, most = quanta(halo_m(workflow)), points_within("denoise_part", limit)
    peak = largest(piece.peak(edge, halo) for piece in pieces)
    if peak.points <= points_within("denoise", limit):
        return _need("denoise", peak)
    while peak.points > most and edge >= 2 * LEAST_PART_Q:
        edge //= 2
        peak = largest(piece.peak(edge, halo) for piece in pieces)
    return _need("denoise", peak, task_bytes("denoise_part", peak.points))


def _need(kind: str, peak: Peak, needed: int | None = None) -> Need:
    """What the fullest task of a kind needs."""
    most = task_bytes(kind, peak.points) if needed is None else needed
    return Need(_place(kind, peak), most, REMEDIES[kind])


def _place(kind: str, peak: Peak) -> str:
    x, y = (sum(ends) / 2 * QUANTUM_M for ends in (peak.core[::2], peak.core[1::2]))
    return f"{NAMES[kind]} around x {x:.0f}, y {y:.0f} with {grouped(peak.points)} points in reach"


def _records(path: Path) -> int:
    size = RECORD_BYTES.get(path.suffix.lower(), CSV_RECORD_BYTES)
    return path.stat().st_size // size
