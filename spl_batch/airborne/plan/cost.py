"""What a run will do and cost: stretches, tiles, cells, tasks, disk, memory, time."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final, NamedTuple

import numpy as np

from spl_batch.airborne.context import Context, reprojection
from spl_batch.airborne.plan import reference_tasks
from spl_batch.airborne.plan.grid import denoise_grid
from spl_batch.airborne.plan.inputs.survey_inputs import Source
from spl_batch.airborne.plan.survey_ledger import Survey
from spl_batch.airborne.plan.task_memory import STRETCH_POINTS, halo_m, needs
from spl_batch.airborne.products.product_table import ABOVE_GEOID, PRODUCTS
from spl_batch.airborne.settings.workflow import Workflow
from spl_batch.airborne.tasks.index import parts_of
from spl_batch.airborne.tasks.reference import REFERENCE_POINT_BYTES
from spl_batch.constants import QUANTA_PER_M
from spl_batch.engine.plan.budget import Cost, measured_rates
from spl_batch.formats.units import Units
from spl_batch.lattice import density
from spl_batch.lattice.tiles import Bounds, quanta

STORE_BYTES_PER_POINT: Final = 60
"""Working store, all of it [byte]."""

DELIVERED_BYTES_PER_POINT: Final = 12
"""Classified LAZ, as files, as tiles or as an octree [byte]."""


class Pace(NamedTuple):
    """What a stage takes of a worker."""

    points_per_s: float
    task_s: float  #: What a task takes however few points it has [s].


PACES: Final[Mapping[str, Pace]] = MappingProxyType(
    {
        "index": Pace(1.8e6, 0.01),
        "shots": Pace(2.0e6, 0.005),
        "shuffle": Pace(0.95e6, 0.015),
        "denoise": Pace(0.45e6, 1.0),
        "ground": Pace(1.5e6, 0.3),
        "surfaces": Pace(1.05e6, 0.3),
        "deliver": Pace(2.9e6, 0.03),
        "report": Pace(0.85e6, 0.02),
    }
)
"""Of each stage until a store has measured its points per second, those of ``report`` of the
reference, those of ``denoise`` of cells and of margins as :data:`~.grid.MARGIN_COST` has them.
Tasks open files and put them in place, and look through air and raster cells. From ``python -m
benchmarks.plan_cost FOLDER``, by the logs of its runs on an idle machine; the sparse one of them
has little but tasks."""

COPC_POINTS_PER_S: Final = 0.64e6
"""Points per second that become an octree: a line of 3 million returns in 4.6 s."""

ALONE_S: Final = 5.0
"""Wall time in which nobody works beside: workers start, and the report's page is written [s]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SurveyCost(Cost):
    """What a run on an airborne survey will do, and what it is expected to cost."""

    #: Stretches of flightlines, tiles, cells of denoise and ground cells [count].
    stretches: int
    tiles: int
    denoise_cells: int
    cells: int
    side: int  #: Tiles along one side of a cell of denoise [count].
    halo_m: float  #: Its margin, the sum of the reaches of the filter's steps [m].


def estimate(survey: Survey, context: Context | None = None) -> SurveyCost:
    """Cost of a survey whose files spread their points evenly over their bounding boxes."""
    workflow, sources = survey.workflow, survey.inputs.sources
    points = sum(s.facts.n_points for s in sources)
    boxes = [_box(s) for s in sources if s.facts.n_points]
    pieces = list(density.from_boxes(boxes, survey.tile_q))
    denoised = denoise_grid(
        pieces, [box.bounds for box in boxes], workflow, survey.memory_bytes, survey.workers
    )
    side = denoised.grid.edge // survey.tile_q
    edges = survey.tile_q, quanta(workflow.ground.cell_m)
    tiles, cells = (sum(piece.units(edge) for piece in pieces) for edge in edges)
    stretches = sum(-(-s.facts.n_points // STRETCH_POINTS) for s in sources)
    files = [s.facts.n_points for s in sources]
    units = Units.of(survey.inputs.crs)
    held = needs(pieces, workflow, files, side, units)
    heaviest = max(held, key=lambda need: need.memory_bytes)
    usual = {stage: pace.points_per_s for stage, pace in PACES.items()}
    rates, measured = measured_rates(usual, context)
    references = survey.inputs.reference
    compared = sum(facts.n_points for facts in references.usable)
    work = dict.fromkeys(rates, float(points)) | {"report": float(compared)}
    # What a store has measured has margins, the time of its tasks and its octrees in it.
    typical = {stage for stage, rate in rates.items() if rate == usual[stage]}
    if "denoise" in typical:
        work["denoise"] = denoised.work
    delivered = len(sources) * (1 + workflow.outputs.copc) + len(survey.inputs.areas)
    delivered += tiles if workflow.outputs.tiles != "none" else 0
    flown, found = len(survey.inputs.trajectory), survey.filtering and not survey.inputs.trajectory
    # every file is indexed by parts, and most likely is a flightline; each stretch is
    # observed and scattered; without a trajectory flightlines have a path, which lines of sight of
    # stretches show
    tasks = {
        "index": len(sources)
        + sum(map(parts_of, files))
        + (flown and survey.filtering) * (flown + 1),
        "shots": len(sources) + stretches + found * (len(sources) + stretches),
        "shuffle": stretches + tiles,
        "denoise": denoised.cells,
        "ground": cells,
        "surfaces": cells,
        # flightlines are compared by ground cell; the few tasks beside are not counted
        "deliver": delivered + len(PRODUCTS) + cells * (len(sources) > 1),
        "report": len(references.usable + references.bad) + reference_tasks.squares(survey),
    }
    alone = {stage: PACES[stage].task_s * tasks[stage] * (stage in typical) for stage in rates}
    if "deliver" in typical:
        alone["deliver"] += workflow.outputs.copc * points / COPC_POINTS_PER_S
    alone["report"] += ALONE_S * survey.workers
    return SurveyCost(
        points=points,
        stretches=stretches,
        tiles=tiles,
        denoise_cells=denoised.cells,
        cells=cells,
        side=side,
        halo_m=halo_m(workflow),
        tasks=sum(tasks.values()),
        disk_bytes=points * (STORE_BYTES_PER_POINT + _copies(workflow) * DELIVERED_BYTES_PER_POINT)
        + compared * REFERENCE_POINT_BYTES
        + _raster_bytes(survey, tiles * (survey.tile_q / QUANTA_PER_M) ** 2),
        memory_bytes=heaviest.memory_bytes,
        heaviest=heaviest.task,
        remedy=heaviest.remedy,
        stages_s={stage: work[stage] / rate + alone[stage] for stage, rate in rates.items()},
        workers=survey.workers,
        measured=measured,
    )


def _box(source: Source) -> density.Box:
    """Points of a file, by its header as if they spread evenly over their box."""
    west, south = (math.floor(v * QUANTA_PER_M) for v in source.facts.mins_m[:2])
    east, north = (math.floor(v * QUANTA_PER_M) + 1 for v in source.facts.maxs_m[:2])
    return density.Box(Bounds(west, south, east, north), source.facts.n_points)


def _copies(workflow: Workflow) -> int:
    """How often each point is delivered: in its file, tiles, a COPC twin, another CRS [count]."""
    outputs = workflow.outputs
    tiles = (outputs.tiles != "none") + (outputs.client_tiles is not None)
    elsewhere = outputs.crs is not None or outputs.units is not None
    return 1 + tiles + outputs.copc + elsewhere


def _raster_bytes(survey: Survey, area_m2: float) -> int:
    """Rasters of an area in the working store and as they are delivered [byte].

    Deflated, with overviews, a value takes 3.0 to 3.7 bytes; in the store it takes the four it has.
    """
    workflow, outputs = survey.workflow, survey.workflow.outputs
    cells, again = area_m2 / workflow.products.cell_m**2, 0.0
    moved = reprojection(outputs, survey.inputs.crs)
    if moved is not None:
        cell = outputs.cell or moved.in_units(workflow.products.cell_m)
        again = area_m2 * (moved.in_units(1.0) / cell) ** 2
    cut = again if moved is not None and outputs.crs is None else cells
    delivered = sum(one.delivered for one in PRODUCTS)
    above_geoid = len(ABOVE_GEOID) * (outputs.geoid is not None)
    values = cells * (2 * len(PRODUCTS) + above_geoid) + again * delivered
    values += cut * delivered * (outputs.client_tiles is not None)
    return math.ceil(values) * np.dtype(np.float32).itemsize
