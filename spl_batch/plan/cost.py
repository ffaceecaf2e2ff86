"""What a run will do and cost: stretches, tiles, blocks, tasks, disk, memory, time."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from types import MappingProxyType
from typing import Final

from spl_batch.constants import QUANTA_PER_M
from spl_batch.errors import PlanError
from spl_batch.io.store import read_receipts
from spl_batch.plan import density
from spl_batch.plan.density import Box, Piece
from spl_batch.plan.inputs import Source
from spl_batch.plan.memory import Need, halo_m, needs, stretch_points, usable_bytes
from spl_batch.plan.space import choose_block_tiles
from spl_batch.plan.survey import Survey
from spl_batch.runner import KINDS
from spl_batch.runner.context import Context
from spl_batch.stages.surface import PRODUCTS
from spl_batch.tiling import Bounds

STORE_BYTES_PER_POINT: Final = 60
"""Working store, all of it [byte]."""

DELIVERED_BYTES_PER_POINT: Final = 12
"""Classified LAZ [byte]."""

RATES_POINTS_PER_S: Final[Mapping[str, float]] = MappingProxyType(
    {
        "index": 1.1e6,
        "shots": 0.42e6,
        "shuffle": 0.25e6,
        "denoise": 0.089e6,
        "ground": 0.32e6,
        "surfaces": 0.22e6,
        "deliver": 0.51e6,
    }
)
"""Points per second and worker until a store has measured its own; `benchmarks/stages.py`."""


SAMPLE: Final = 1000
"""Receipts of a kind that measured rates are taken from, at most [count]."""


@dataclass(frozen=True, slots=True)
class Cost:
    """What a run will do, and what it is expected to cost.

    Parameters
    ----------
    points, stretches, tiles, blocks, cells : int
        Points, stretches of flightlines, tiles, denoise blocks and ground cells [count].
    block_tiles : int
        Tiles along one side of a block [count].
    halo_m : float
        Halo of a block, the sum of the reaches of the filter's steps [m].
    tasks : int
        Tasks of all stages [count].
    disk_bytes : int
        Working store and results [byte].
    memory_bytes : int
        Memory of the heaviest task, its worker included [byte].
    heaviest, remedy : str
        That task, and the setting that makes it lighter.
    time_s : float
        Wall time with these workers [s].
    measured : bool
        Whether the rates were measured on this store.
    """

    points: int
    stretches: int
    tiles: int
    blocks: int
    cells: int
    block_tiles: int
    halo_m: float
    tasks: int
    disk_bytes: int
    memory_bytes: int
    heaviest: str
    remedy: str
    time_s: float
    measured: bool


def estimate(survey: Survey, context: Context | None = None) -> Cost:
    """Cost of a survey whose files spread their points evenly over their bounding boxes.

    Parameters
    ----------
    survey : Survey
        Inputs and limits.
    context : Context, optional
        Where measured rates may lie.
    """
    workflow, sources = survey.workflow, survey.inputs.sources
    points = sum(s.facts.n_points for s in sources)
    pieces = list(density.from_boxes(map(_box, sources), survey.tile_q))
    side = choose_block_tiles(pieces, workflow, survey.memory_bytes, survey.workers)
    tiles, blocks, cells = (
        sum(piece.units(edge) for piece in pieces)
        for edge in (survey.tile_q, side * survey.tile_q, survey.cell_q)
    )
    stretches = sum(-(-s.facts.n_points // stretch_points(survey.memory_bytes)) for s in sources)
    heaviest = _heaviest(survey, pieces)
    rates, measured = _rates(context)
    delivered = len(sources) + (tiles if workflow.outputs.tiles != "none" else 0)
    # every file is indexed and most likely is a flightline of its own; each stretch is
    # gathered and scattered; the noise map is a mosaic too
    mosaics = len(PRODUCTS) + 1
    tasks = 2 * (len(sources) + stretches + cells) + tiles + blocks + delivered + mosaics
    return Cost(
        points,
        stretches,
        tiles,
        blocks,
        cells,
        side,
        halo_m(workflow),
        tasks,
        points * (STORE_BYTES_PER_POINT + DELIVERED_BYTES_PER_POINT),
        heaviest.memory_bytes,
        heaviest.task,
        heaviest.remedy,
        sum(points / rate for rate in rates.values()) / survey.workers,
        measured,
    )


def refuse_too_large(cost: Cost, limit: int) -> None:
    """Refuse a run whose heaviest task cannot fit into a worker.

    Raises
    ------
    PlanError
        It names that task and what makes it lighter.
    """
    if cost.memory_bytes > usable_bytes(limit):
        remedies = " or ".join(filter(None, ("raise it", cost.remedy)))
        raise PlanError(
            f"{cost.heaviest} needs {cost.memory_bytes / 2**20:,.0f} MiB, more than a task may "
            f"use of --memory {limit / 2**20:,.0f} MiB ({usable_bytes(limit) / 2**20:,.0f} MiB); "
            f"{remedies}"
        )


def _box(source: Source) -> Box:
    """Bounding box of a file on the lattice."""
    west, south = (math.floor(v * QUANTA_PER_M) for v in source.facts.mins_m[:2])
    east, north = (math.floor(v * QUANTA_PER_M) + 1 for v in source.facts.maxs_m[:2])
    return Box(Bounds(west, south, east, north), source.facts.n_points)


def _heaviest(survey: Survey, pieces: Sequence[Piece]) -> Need:
    inputs = survey.inputs
    found: Iterable[Need] = needs(
        pieces,
        survey.workflow,
        survey.memory_bytes,
        points=sum(s.facts.n_points for s in inputs.sources),
        trajectory=inputs.trajectory,
    )
    return max(found, key=lambda need: need.memory_bytes)


def _rates(context: Context | None) -> tuple[Mapping[str, float], bool]:
    """Points per second by stage: measured where the store holds receipts."""
    if context is None:
        return RATES_POINTS_PER_S, False
    rates = dict(RATES_POINTS_PER_S)
    measured = False
    for stage in rates:
        points, wall = 0, 0.0
        for kind in (k for k, v in KINDS.items() if v.stage == stage):
            for receipt in islice(read_receipts(context.store, kind), SAMPLE):
                points += receipt.points
                wall += receipt.wall_s
        if points > 0 and wall > 1.0:
            rates[stage] = points / wall
            measured = True
    return rates, measured
