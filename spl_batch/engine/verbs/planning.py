"""What a run will do, from headers alone: points, tasks, disk, memory, time."""

import shutil
from collections.abc import Iterator, Sequence
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
    """What a run will do."""

    #: Usable input files, and points that their headers promise [count].
    files: int
    points: int
    cost: Any  #: Tasks, disk, memory and time: a Cost, as the receiver extends it.
    limit_bytes: int  #: Memory limit of a worker [byte].
    shared: bool  #: Whether that is the workers' share of this machine, as none was given.
    rows: tuple[tuple[str, str], ...]  #: Label and value of what the receiver adds.
    faults: tuple[str, ...]  #: What is wrong with the inputs and the output.
    findings: tuple[FindingReport, ...]  #: What to warn of.
    finished: int = 0  #: Tasks that earlier runs have finished, whatever has changed since [count].
    unusable: int = 0  #: Input files that cannot be used; ``faults`` has the reasons [count].

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
    """Estimate what a run would do, and name what is wrong with all inputs at once.

    Parameters
    ----------
    workflow, workers, memory, overrides : optional
        As :func:`~spl_batch.engine.verbs.running.run` takes them.

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
    look = prepared.receiver.first_look(prepared)
    store = prepared.context.store
    folders = (store.path("receipts", kind) for kind in prepared.steps)
    finished = sum(len(names_in(folder, ".json")) for folder in folders)
    findings = (
        *prepared.ledger.remarks,
        *inputs.warnings,
        *gone_inputs(prepared, deliveries),
        *_too_full(prepared.context.output, 0 if finished or store.url else cost.disk_bytes),
    )
    units, ignored = prepared.context.shown_units, prepared.context.workflow.report.ignore
    return PlanSummary(
        len(inputs.sources) - look.unreadable,
        cost.points - look.unreadable_points,
        cost,
        prepared.ledger.memory_bytes,
        prepared.ledger.shared,
        tuple(prepared.receiver.plan_rows(prepared, cost)),
        (*told_together(inputs.bad), *look.faults, *look.late),
        reported(findings, ignored, notes=True, units=units),
        finished,
        len(inputs.bad) + look.unreadable,
    )


def fitting_cost(prepared: Prepared[Any, Any]) -> Cost:
    """Cost of a run; PlanError, which names the heaviest task, where that does not fit a worker."""
    cost = prepared.receiver.cost(prepared)
    refuse_too_large(cost, prepared.ledger.memory_bytes, shared=prepared.ledger.shared)
    return cost


def _too_full(output: Path, needed: int) -> Iterator[Finding]:
    """A note where the file system of the output has less room than is expected to be taken."""
    there = next(place for place in (output, *output.parents) if place.exists())
    free = shutil.disk_usage(there).free
    if needed > free:
        yield Finding("E01", {"kind": "disk", "needed": storage(needed), "free": storage(free)})
