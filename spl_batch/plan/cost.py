"""What a run will cost: tasks, disk, memory, time."""

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

from spl_batch.io.store import read_receipts
from spl_batch.plan.flightlines import STRETCH_POINTS
from spl_batch.plan.survey import Survey
from spl_batch.runner import KINDS
from spl_batch.runner.context import Context
from spl_batch.stages import denoise, geometry, ground, surface
from spl_batch.tiling import CellId

WORKER_BASE_BYTES: Final = 700 * 2**20
"""Resident memory of a worker that has compiled its kernels, rounded up [byte]."""

STORE_BYTES_PER_POINT: Final = 60
"""Working store, all of it [byte]."""

DELIVERED_BYTES_PER_POINT: Final = 12
"""Classified LAZ [byte]."""

RATES_POINTS_PER_S: Final[Mapping[str, float]] = MappingProxyType(
    {
        "index": 0.81e6,
        "shots": 0.45e6,
        "shuffle": 0.23e6,
        "denoise": 0.075e6,
        "ground": 0.17e6,
        "surfaces": 0.19e6,
        "deliver": 0.77e6,
    }
)
"""Points per second and worker until a store has measured its own; `benchmarks/stages.py`."""


@dataclass(frozen=True, slots=True)
class Cost:
    """Expected cost of a run.

    Parameters
    ----------
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

    tasks: int
    disk_bytes: int
    memory_bytes: int
    heaviest: str
    remedy: str
    time_s: float
    measured: bool


def estimate(
    survey: Survey, points: int, tiles: Collection[CellId], context: Context | None = None
) -> Cost:
    """Cost of a survey whose points spread evenly over its tiles.

    Parameters
    ----------
    survey : Survey
        Inputs and limits.
    points : int
        All points [count].
    tiles : collection of CellId
        Tiles that hold them.
    context : Context, optional
        Where measured rates may lie.
    """
    workflow = survey.workflow
    area_m2 = max(len(tiles), 1) * workflow.tiling.tile_m**2
    density = points / area_m2
    halo = denoise.reach_m(workflow.filter)
    block_points = density * (workflow.tiling.tile_m + 2 * halo) ** 2
    cell_points = density * (workflow.ground.cell_m + 2 * workflow.ground.buffer_m) ** 2
    needs = {
        ("a stretch of a flightline", "survey size"): min(points, STRETCH_POINTS)
        * 2
        * geometry.BYTES_PER_POINT,
        ("a denoise block", "tiling.tile_m"): block_points * denoise.BYTES_PER_POINT,
        ("a ground cell", "ground.cell_m"): cell_points * ground.BYTES_PER_POINT,
        ("a surface cell", "ground.cell_m"): cell_points * surface.BYTES_PER_POINT,
    }
    (heaviest, remedy), most = max(needs.items(), key=lambda item: item[1])
    rates, measured = _rates(context)
    cells = math.ceil(area_m2 / workflow.ground.cell_m**2)
    stretches = math.ceil(points / STRETCH_POINTS)
    tasks = 2 * len(survey.inputs.sources) + 2 * stretches + 2 * len(tiles) + 2 * cells + 6
    return Cost(
        tasks,
        points * (STORE_BYTES_PER_POINT + DELIVERED_BYTES_PER_POINT),
        WORKER_BASE_BYTES + int(most),
        heaviest,
        remedy,
        sum(points / rate for rate in rates.values()) / survey.workers,
        measured,
    )


def _rates(context: Context | None) -> tuple[Mapping[str, float], bool]:
    """Points per second by stage: measured where the store holds receipts."""
    if context is None:
        return RATES_POINTS_PER_S, False
    rates = dict(RATES_POINTS_PER_S)
    measured = False
    for stage in rates:
        points, wall = 0, 0.0
        for kind in (k for k, v in KINDS.items() if v.stage == stage):
            for receipt in read_receipts(context.store, kind):
                points += receipt.points
                wall += receipt.wall_s
        if points > 0 and wall > 1.0:
            rates[stage] = points / wall
            measured = True
    return rates, measured
