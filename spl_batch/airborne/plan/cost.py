"""What a run will do and cost: stretches, tiles, blocks, tasks, disk, memory, time."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

from spl_batch.airborne.context import Context
from spl_batch.airborne.plan import reference_tasks
from spl_batch.airborne.plan.block_layout import CORE_COST
from spl_batch.airborne.plan.block_size import choose_sizes, count_blocks
from spl_batch.airborne.plan.ground_cells import GroundCells
from spl_batch.airborne.plan.halo import halo_m
from spl_batch.airborne.plan.inputs.point_boxes import point_boxes
from spl_batch.airborne.plan.memory.cell_memory import strips_cost
from spl_batch.airborne.plan.memory.heaviest_tasks import Need, needs
from spl_batch.airborne.plan.survey_ledger import Survey
from spl_batch.airborne.products.product_table import ABOVE_GEOID, products
from spl_batch.airborne.settings.workflow import Workflow
from spl_batch.airborne.tasks.index import parts_of
from spl_batch.engine.plan.budget import Cost, measured_rates
from spl_batch.lattice import density
from spl_batch.lattice.density import Box, Piece

STORE_BYTES_PER_POINT: Final = 60
"""Working store, all of it [byte]."""

DELIVERED_BYTES_PER_POINT: Final = 12
"""Classified LAZ, as files, as tiles or as an octree [byte]."""

REFERENCE_BYTES_PER_POINT: Final = 35
"""A point of the reference in the working store while its file is cut into squares [byte]."""

MUCH_READ: Final = 1.35
"""Points that blocks read, over those of the survey, from which on a plan looks for a memory limit
with which they read less."""

RATES_POINTS_PER_S: Final[Mapping[str, float]] = MappingProxyType(
    {
        "index": 2.2e6,
        "shots": 4.0e6,
        "shuffle": 1.4e6,
        "denoise": 0.44e6,
        "ground": 2.0e6,
        "surfaces": 1.7e6,
        "deliver": 7.0e6,
        "report": 0.5e6,
    }
)
"""Points per second and worker until a store has measured its own, those of ``denoise`` without the
halos that blocks read, those of ``report`` of the reference; ``benchmarks/end_to_end.py``,
two workers, 53 % noise, and a little less."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SurveyCost(Cost):
    """What a run on an airborne survey will do, and what it is expected to cost."""

    #: Stretches of flightlines, tiles, denoise blocks and ground cells [count].
    stretches: int
    tiles: int
    blocks: int
    cells: int
    block_tiles: int  #: Tiles along the longest side of a block [count].
    block_reads: float  #: Points that all blocks read, halos included, over those of the survey.
    #: Where blocks read much: a memory limit of twice or four times the bytes with which they read
    #: less than :data:`MUCH_READ`, and what they read then.
    roomier: tuple[int, float] | None
    strips: int  #: In how many strips the fullest surface cell is done [count].
    ground_strips: int  #: In how many the ground of the fullest cell is found [count].
    halo_m: float  #: Halo of a block, the sum of the reaches of the filter's steps [m].


def estimate(survey: Survey, context: Context | None = None) -> SurveyCost:
    """Cost of a survey whose files spread their points evenly over their bounding boxes."""
    workflow, sources = survey.workflow, survey.inputs.sources
    points = sum(s.facts.n_points for s in sources)
    boxes = point_boxes(sources)
    pieces = list(density.from_boxes(boxes, survey.tile_q))
    limits = workflow, survey.memory_bytes
    sizes = survey.remembered if workflow.tiling.block_tiles is None else None
    sizes = sizes or choose_sizes(pieces, *limits, survey.workers)
    blocks = count_blocks(pieces, *limits, sizes)
    tiles = sum(piece.units(survey.tile_q) for piece in pieces)
    cells = _ground_cells(boxes, workflow)
    stretches = sum(-(-s.facts.n_points // survey.stretch_points) for s in sources)
    held = _needs(survey, pieces, boxes)
    heaviest = max(held, key=lambda need: need.memory_bytes)
    strips = {need.kind: need.parts for need in held if need.kind}
    typical = {
        **RATES_POINTS_PER_S,
        "denoise": RATES_POINTS_PER_S["denoise"] * CORE_COST / (CORE_COST - 1 + blocks.read),
        "ground": RATES_POINTS_PER_S["ground"] / strips_cost(strips["ground"]),
        "surfaces": RATES_POINTS_PER_S["surfaces"] / strips_cost(strips["surface"]),
    }
    rates, measured = measured_rates(typical, context)
    compared = sum(facts.n_points for facts in survey.inputs.reference.usable)
    work = {stage: compared if stage == "report" else points for stage in rates}
    delivered = len(sources) + (tiles if workflow.outputs.tiles != "none" else 0)
    # every file is indexed, a large one by parts, and most likely is a flightline; each stretch is
    # gathered and scattered; without a trajectory flightlines have a heading and a path, and
    # stretches are observed after that
    tasks = 2 * (len(sources) + stretches + cells) + tiles + blocks.blocks + delivered
    tasks += _rasters_and_comparisons(survey, cells)
    tasks += sum(parts_of(source.facts.n_points) for source in sources)
    tasks += sum(map(len, survey.inputs.reference)) + reference_tasks.squares(survey)
    if survey.filtering:
        files = len(survey.inputs.trajectory)
        tasks += 1 + files if files else 2 * len(sources) + stretches
    return SurveyCost(
        points=points,
        stretches=stretches,
        tiles=tiles,
        blocks=blocks.blocks,
        cells=cells,
        block_tiles=blocks.tiles,
        block_reads=blocks.read,
        roomier=_roomier(survey, pieces) if blocks.read > MUCH_READ else None,
        strips=strips["surface"],
        ground_strips=strips["ground"],
        halo_m=halo_m(workflow),
        tasks=tasks,
        disk_bytes=points * (STORE_BYTES_PER_POINT + _copies(workflow) * DELIVERED_BYTES_PER_POINT)
        + compared * REFERENCE_BYTES_PER_POINT,
        memory_bytes=heaviest.memory_bytes,
        heaviest=heaviest.task,
        remedy=heaviest.remedy,
        stages_s={stage: work[stage] / rate for stage, rate in rates.items()},
        workers=survey.workers,
        measured=measured,
    )


def _roomier(survey: Survey, pieces: Sequence[Piece]) -> tuple[int, float] | None:
    """A memory limit with which blocks read less, and what they read then."""
    if survey.workflow.tiling.block_tiles is not None or survey.remembered is not None:
        return None  # blocks stay as they are
    for memory_bytes in (2 * survey.memory_bytes, 4 * survey.memory_bytes):
        limits = survey.workflow, memory_bytes
        sizes = choose_sizes(pieces, *limits, survey.workers)
        read = count_blocks(pieces, *limits, sizes).read
        if read <= MUCH_READ:
            return memory_bytes, read
    return None


def _copies(workflow: Workflow) -> int:
    """How often each point is delivered: in its file, in a tile, in a COPC twin [count]."""
    return 1 + (workflow.outputs.tiles != "none") + workflow.outputs.copc


def _rasters_and_comparisons(survey: Survey, cells: int) -> int:
    """Mosaics, comparisons of flightlines, checkpoints, twins and catalogue [count]."""
    workflow, sources = survey.workflow, survey.inputs.sources
    maps, outputs = workflow.products.maps, workflow.outputs
    rasters = len(products(reflectance=False, maps=maps)) + maps
    rasters += len(ABOVE_GEOID) * (outputs.geoid is not None)
    # flightlines are told by the index; until it is there, each file counts as one
    spans = [receipt.facts["spans"] for receipt in survey.of("index_file").values()]
    lines = len({psid for span in spans for psid in span}) or len(sources)
    strips = cells + len(survey.of("strip_pairs")) if lines > 1 else 0
    checked = survey.inputs.checkpoints is not None
    return rasters + strips + checked + outputs.catalogue + outputs.copc * len(sources)


def _ground_cells(boxes: Sequence[Box], workflow: Workflow) -> int:
    """Ground cells that hold points [count]."""
    cells = GroundCells.of_workflow((box.bounds for box in boxes), workflow)
    kept = (box._replace(bounds=cells.kept(box.bounds)) for box in boxes)
    return sum(piece.units(cells.edge) for piece in density.from_boxes(kept, cells.edge))


def _needs(survey: Survey, pieces: Sequence[Piece], boxes: Sequence[Box]) -> list[Need]:
    inputs = survey.inputs
    return needs(
        pieces,
        survey.workflow,
        survey.stretch_points,
        files=[s.facts.n_points for s in inputs.sources],
        limit=survey.memory_bytes,
        boxes=boxes,
        trajectory=inputs.trajectory,
    )
