"""What a run will do, from headers alone: points, tiles, tasks, disk, memory, time."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from spl_batch.api.preparing import DEFAULT_MEMORY, Prepared, prepare
from spl_batch.plan.cost import Cost, estimate, refuse_too_large
from spl_batch.plan.memory import surface_reach_m


@dataclass(frozen=True, slots=True)
class PlanSummary:
    """What a run will do.

    Parameters
    ----------
    files : int
        Usable input files [count].
    area_km2 : float
        Area of the tiles that the files' bounding boxes touch, overlaps once [km2].
    ground_buffer_m, surface_reach_m : float
        What a ground cell reads around it for its ground and for its rasters [m].
    cost : Cost
        Points, stretches, tiles, blocks, tasks, disk, memory and time.
    faults, warnings : tuple of str
        What is wrong with the inputs; what is odd about them.
    """

    files: int
    area_km2: float
    ground_buffer_m: float
    surface_reach_m: float
    cost: Cost
    faults: tuple[str, ...]
    warnings: tuple[str, ...]

    @property
    def points(self) -> int:
        """Points of all usable files [count]."""
        return self.cost.points

    @property
    def tiles(self) -> int:
        """Tiles that the files' bounding boxes touch [count]."""
        return self.cost.tiles


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
    survey, cost = prepared.survey, fitting_cost(prepared)
    settings = survey.workflow
    return PlanSummary(
        len(survey.inputs.sources),
        cost.tiles * settings.tiling.tile_m**2 / 1e6,
        settings.ground.buffer_m,
        surface_reach_m(settings),
        cost,
        tuple(str(b) for b in survey.inputs.bad),
        survey.inputs.warnings,
    )


def fitting_cost(prepared: Prepared) -> Cost:
    """Cost of a run that fits into its memory limit.

    Raises
    ------
    PlanError
        If a task cannot; it names the heaviest one.
    """
    cost = estimate(prepared.survey, prepared.context)
    refuse_too_large(cost, prepared.survey.memory_bytes)
    return cost
