"""What a run will do, from headers alone: points, tasks, disk, memory, time."""

import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from spl_batch.engine.findings import Finding
from spl_batch.engine.plan.budget import Cost, refuse_too_large
from spl_batch.engine.report.parts import FindingReport
from spl_batch.engine.report.reported import reported
from spl_batch.engine.verbs.output_owner import gone_inputs, usable
from spl_batch.engine.verbs.preparing import prepare
from spl_batch.engine.verbs.receiver import Prepared
from spl_batch.errors import refuse_without, storage, told_together
from spl_batch.formats.files.atomic import names_in


@dataclass(frozen=True, slots=True)
class PlanSummary:
    """What a run will do.

    Parameters
    ----------
    files, points : int
        Usable input files, and points that their headers promise [count].
    cost : Cost
        Tasks, disk, memory and time; of an airborne survey, a
        :class:`~spl_batch.airborne.plan.cost.SurveyCost`.
    limit_bytes : int
        Memory limit of a worker [byte].
    shared : bool
        Whether it is the workers' share of this machine, as nobody has said otherwise.
    rows : tuple of (str, str)
        Label and value of what the receiver tells beside them.
    faults : tuple of str
        What is wrong with the inputs and the output.
    findings : tuple of FindingReport
        What is odd about them.
    finished : int
        Tasks that earlier runs have finished there, whatever has changed since [count].
    unusable : int
        Input files that cannot be used [count]; ``faults`` has the reasons.
    """

    files: int
    points: int
    cost: Any
    limit_bytes: int
    shared: bool
    rows: tuple[tuple[str, str], ...]
    faults: tuple[str, ...]
    findings: tuple[FindingReport, ...]
    finished: int = 0
    unusable: int = 0

    @property
    def exit_status(self) -> int:
        """What the command ends with: 1 where a run would leave files out."""
        return int(bool(self.faults))


def plan(
    workflow: Path | str,
    *,
    workers: int = 2,
    memory: str | int | None = None,
    overrides: Sequence[str] = (),
) -> PlanSummary:
    """Say what a run would do, and what is wrong with all inputs at once.

    Parameters
    ----------
    workflow : Path or str
        Workflow file.
    workers : int
        Worker processes [count].
    memory : str or int, optional
        Memory limit of a worker [byte]; a share of the machine's unless told.
    overrides : sequence of str
        ``key.path=value``, applied to the workflow.

    Raises
    ------
    WorkflowError
        If the workflow is wrong, no input is usable, or the output cannot be used.
    PlanError
        If a task cannot fit into the memory limit.
    MissingPackageError
        If a package is missing that a report needs.
    """
    prepared = prepare(Path(workflow), overrides, memory=memory, workers=workers)
    refuse_without("matplotlib", "reports", "report")
    cost, inputs = fitting_cost(prepared), prepared.ledger.inputs
    deliveries = usable(prepared)
    receiver = prepared.receiver
    look = receiver.first_look(prepared)
    output, store = prepared.context.output, prepared.context.store
    folders = (store.path("receipts", kind) for kind in prepared.steps)
    finished = sum(len(names_in(folder, ".json")) for folder in folders)
    needed = 0 if finished or store.url else cost.disk_bytes
    return PlanSummary(
        len(inputs.sources) - look.unreadable,
        cost.points - look.unreadable_points,
        cost,
        prepared.ledger.memory_bytes,
        prepared.ledger.shared,
        (*look.rows, *receiver.plan_rows(prepared, cost)),
        (*told_together(inputs.bad), *look.faults, *look.late),
        reported(
            (
                *prepared.ledger.remarks,
                *inputs.warnings,
                *gone_inputs(prepared, deliveries),
                *look.warnings,
                *(
                    one
                    for step in prepared.steps.values()
                    for one in receiver.aside(step, prepared)
                ),
                *_too_full(output, needed),
            ),
            prepared.context.workflow.report.ignore,
            notes=True,
        ),
        finished,
        len(inputs.bad) + look.unreadable,
    )


def fitting_cost(prepared: Prepared[Any, Any]) -> Cost:
    """Cost of a run that fits into its memory limit.

    Raises
    ------
    PlanError
        If a task cannot; it names the heaviest one.
    """
    cost = prepared.receiver.cost(prepared)
    ledger = prepared.ledger
    refuse_too_large(cost, ledger.memory_bytes, shared=ledger.shared)
    return cost


def _too_full(output: Path, needed: int) -> list[Finding]:
    """A note where the file system of the output has less room than is expected to be taken."""
    there = next(place for place in (output, *output.parents) if place.exists())
    free = shutil.disk_usage(there).free
    if needed <= free:
        return []
    return [Finding("E01", {"kind": "disk", "needed": storage(needed), "free": storage(free)})]
