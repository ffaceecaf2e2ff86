"""What a run will do, from headers alone: points, tasks, disk, memory, time."""

import shutil
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from spl_batch.engine.findings import Finding
from spl_batch.engine.plan.budget import Cost, refuse_too_large
from spl_batch.engine.report.parts import FindingReport
from spl_batch.engine.report.reported import reported
from spl_batch.engine.report.run_record import REPORT_FILES
from spl_batch.engine.store.output_owner import gone_inputs, usable
from spl_batch.engine.tasks.runner import kinds, stages
from spl_batch.engine.tasks.worklist import Worklist
from spl_batch.engine.verbs.preparing import prepare
from spl_batch.engine.verbs.receiver import Prepared
from spl_batch.engine.watch.listing import listed
from spl_batch.errors import grouped, refuse_without, storage, told_together
from spl_batch.formats.files.atomic import names_in

LOOKED_AT: Final = 50_000
"""Finished tasks that a plan looks at one by one: more take it minutes [count]."""


@dataclass(frozen=True, slots=True)
class Left:
    """What earlier runs in the same output have left to do.

    Parameters
    ----------
    finished : int
        Tasks that they have finished, as far as can be told before others are done [count].
    stage : str
        First stage that has something to do; empty where nothing is left.
    tasks, of : int
        Tasks of its first unfinished kind that are left, and all of them [count].
    time_s : float
        Time that this stage and those behind it take at most, with the run's workers [s].
    counted : bool
        Whether each task was looked at; of more than :data:`LOOKED_AT` only how many there are
        is told, and what they were done for may have changed since.
    """

    finished: int
    stage: str = ""
    tasks: int = 0
    of: int = 0
    time_s: float = 0.0
    counted: bool = True


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
    left : Left or None
        What is left to do; None where nothing of this work is finished.
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
    left: Left | None = None
    unusable: int = 0

    def __repr__(self) -> str:
        needed, limit = (grouped(n / 2**20) for n in (self.cost.memory_bytes, self.limit_bytes))
        own = (
            ("files", f"{grouped(self.files)}, {grouped(self.unusable)} unusable beside them"),
            ("points", grouped(self.points)),
            *self.rows,
            ("tasks", grouped(self.cost.tasks)),
            ("disk", storage(self.cost.disk_bytes)),
            ("memory", f"{needed} of each worker's {limit} MiB"),
            ("time", f"{grouped(self.cost.time_s)} s"),
        )
        odd = (("warning", one.text) for one in self.findings)
        return listed("PlanSummary", (*own, *odd, *(("unusable", text) for text in self.faults)))

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
    output, left = prepared.context.output, _left(prepared, cost)
    whole = left is None and prepared.context.store.url is None
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
                *(one for phase in receiver.phases for one in receiver.aside(phase, prepared)),
                *_too_full(output, cost.disk_bytes if whole else 0),
            ),
            prepared.context.workflow.report.ignore,
            notes=True,
        ),
        left,
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
    free = shutil.disk_usage(_existing(output)).free
    if needed <= free:
        return []
    return [Finding("E01", {"kind": "disk", "needed": storage(needed), "free": storage(free)})]


def _existing(path: Path) -> Path:
    """The path, or the nearest one above it that exists."""
    return next(place for place in (path, *path.parents) if place.exists())


def _left(prepared: Prepared[Any, Any], cost: Cost) -> Left | None:
    """What a run would find finished, phase after phase up to the first that has work to do."""
    context, done = prepared.context, 0
    folders = [context.store.path("receipts", kind) for kind in kinds(context.workflow.kind)]
    receipts = sum(len(names_in(folder, ".json")) for folder in folders)
    if receipts > LOOKED_AT:
        return Left(receipts, counted=False)
    for phase in prepared.receiver.phases:
        work = Worklist(phase, prepared.ledger, context)
        deque(work.look(), maxlen=0)
        done += work.ready
        if work.left and not done:
            return None
        if work.left:
            return _left_from(phase.kind, work, done, prepared, cost)
    if all((context.output / name).exists() for name in REPORT_FILES):
        return Left(done)
    return Left(done, "report", 1, 1)


def _left_from(
    kind: str, work: Worklist, done: int, prepared: Prepared[Any, Any], cost: Cost
) -> Left:
    """What is left where a kind of task is the first that is not finished."""
    receiver = prepared.context.workflow.kind
    known, order = kinds(receiver), stages(receiver)
    stage, whole = known[kind].stage, work.left + work.ready
    last = [phase.kind for phase in prepared.receiver.phases if known[phase.kind].stage == stage][
        -1
    ]
    share = work.left / whole if kind == last else 1.0
    after = order[order.index(stage) + 1 :]
    left_s = share * cost.stages_s.get(stage, 0.0) + sum(cost.stages_s.get(s, 0.0) for s in after)
    return Left(done, stage, work.left, whole, left_s / cost.workers)
