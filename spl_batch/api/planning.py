"""What a run will do, from headers alone: points, tasks, disk, memory, time."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from spl_batch.api.preparing import DEFAULT_MEMORY, prepare
from spl_batch.api.receiver import Prepared
from spl_batch.plan.budget import Cost, refuse_too_large


@dataclass(frozen=True, slots=True)
class PlanSummary:
    """What a run will do.

    Parameters
    ----------
    files : int
        Usable input files [count].
    cost : Cost
        Points, tasks, disk, memory and time; of an airborne survey, a
        :class:`~spl_batch.plan.cost.SurveyCost`.
    rows : tuple of (str, str)
        Label and value of what the receiver tells beside them.
    faults, warnings : tuple of str
        What is wrong with the inputs; what is odd about them.
    """

    files: int
    cost: Any
    rows: tuple[tuple[str, str], ...]
    faults: tuple[str, ...]
    warnings: tuple[str, ...]

    @property
    def points(self) -> int:
        """Points of all usable files [count]."""
        return int(self.cost.points)


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
    cost, inputs = fitting_cost(prepared), prepared.ledger.inputs
    return PlanSummary(
        len(inputs.sources),
        cost,
        tuple(prepared.receiver.plan_rows(prepared, cost)),
        tuple(str(bad) for bad in inputs.bad),
        tuple(inputs.warnings),
    )


def fitting_cost(prepared: Prepared[Any, Any]) -> Cost:
    """Cost of a run that fits into its memory limit.

    Raises
    ------
    PlanError
        If a task cannot; it names the heaviest one.
    """
    cost = prepared.receiver.cost(prepared)
    refuse_too_large(cost, prepared.ledger.memory_bytes)
    return cost
