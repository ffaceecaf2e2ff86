"""What a run will do, from headers alone: points, tiles, tasks, disk, memory, time."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from spl_batch.api.preparing import DEFAULT_MEMORY, Prepared, prepare
from spl_batch.constants import QUANTA_PER_M
from spl_batch.errors import PlanError
from spl_batch.plan.cost import Cost, estimate
from spl_batch.plan.survey import Survey
from spl_batch.tiling import Bounds, CellId, cells_touching, quanta


@dataclass(frozen=True, slots=True)
class PlanSummary:
    """What a run will do.

    Parameters
    ----------
    files, points : int
        Usable input files and their points [count].
    area_km2 : float
        Area of the files' bounding boxes, overlaps once [km2].
    tiles : int
        Tiles that those boxes touch [count].
    cost : Cost
        Tasks, disk, memory and time.
    faults, warnings : tuple of str
        What is wrong with the inputs; what is odd about them.
    """

    files: int
    points: int
    area_km2: float
    tiles: int
    cost: Cost
    faults: tuple[str, ...]
    warnings: tuple[str, ...]


def plan(
    workflow: Path | str,
    *,
    workers: int = 2,
    memory: str | int = DEFAULT_MEMORY,
    overrides: Sequence[str] = (),
) -> PlanSummary:
    """Say what a run would do, and what is wrong with all inputs at once.

    Parameters
    ----------
    workflow : Path or str
        Workflow file.
    workers : int
        Worker processes [count].
    memory : str or int
        Memory limit of a worker [byte].
    overrides : sequence of str
        ``key.path=value``, applied to the workflow.

    Raises
    ------
    WorkflowError
        If the workflow is wrong or no input is usable.
    PlanError
        If a task cannot fit into the memory limit.
    """
    prepared = prepare(Path(workflow), overrides, memory=memory, workers=workers)
    survey = prepared.survey
    tiles, points, cost = fitting_cost(prepared)
    return PlanSummary(
        len(survey.inputs.sources),
        points,
        tiles * survey.workflow.tiling.tile_m**2 / 1e6,
        tiles,
        cost,
        tuple(str(b) for b in survey.inputs.bad),
        survey.inputs.warnings,
    )


def fitting_cost(prepared: Prepared) -> tuple[int, int, Cost]:
    """Tiles, points and cost of a run that fits into its memory limit.

    Raises
    ------
    PlanError
        If a task cannot; it names the heaviest one.
    """
    survey = prepared.survey
    tiles = _tiles(survey)
    points = sum(s.facts.n_points for s in survey.inputs.sources)
    cost = estimate(survey, points, tiles, prepared.context)
    if cost.memory_bytes > survey.memory_bytes:
        raise PlanError(
            f"{cost.heaviest} needs {cost.memory_bytes / 2**20:.0f} MiB, more than --memory "
            f"{survey.memory_bytes / 2**20:.0f} MiB; raise it or lower {cost.remedy}"
        )
    return len(tiles), points, cost


def _tiles(survey: Survey) -> set[CellId]:
    """Tiles that the files' bounding boxes touch."""
    found: set[CellId] = set()
    for source in survey.inputs.sources:
        if source.facts.n_points:
            west, south = (math.floor(v * QUANTA_PER_M) for v in source.facts.mins_m[:2])
            east, north = (math.floor(v * QUANTA_PER_M) + 1 for v in source.facts.maxs_m[:2])
            box = Bounds(west, south, east, north)
            found.update(cells_touching(box, quanta(survey.workflow.tiling.tile_m)))
    return found
