"""Do one task alone, here, from what a run has finished: to see a failure where it happens."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from spl_batch.engine.store.output_lock import locked, was_stopped
from spl_batch.engine.tasks.runner import run_task
from spl_batch.engine.tasks.task import Job, Receipt
from spl_batch.engine.tasks.worklist import Worklist
from spl_batch.engine.verbs.output_owner import claim, this_survey, usable
from spl_batch.engine.verbs.preparing import prepare
from spl_batch.engine.verbs.receiver import Prepared
from spl_batch.errors import WorkflowError
from spl_batch.formats.files.atomic import write_bytes


@dataclass(frozen=True, slots=True)
class AloneResult:
    """What has come of a single task."""

    receipt: Receipt  #: With a reason where it failed.
    traceback: Path | None  #: File with where in the code it failed.

    @property
    def exit_status(self) -> int:
        """0 done, 1 failed."""
        return int(self.receipt.failed)


def run_alone(
    workflow: Path | str,
    task: str,
    *,
    workers: int = 2,
    memory: str | int | None = None,
    overrides: Sequence[str] = (),
) -> AloneResult:
    """Do one task in this process, whether it is finished or not.

    If it succeeds, the next run finds it finished.

    Parameters
    ----------
    workflow : Path or str
        Workflow file.
    task : str
        Kind and name of the task, as the report's failures give it, e.g. ``"ground 3_4"``.
    workers, memory : int, str or int, optional
        Those of the run, as work is cut by them; nothing is started.
    overrides : sequence of str
        ``key.path=value``, applied to the workflow.

    Raises
    ------
    WorkflowError
        If there is no such task, or what it needs is not finished.
    """
    prepared = prepare(Path(workflow), overrides, memory=memory, workers=workers)
    usable(prepared)
    stopped = was_stopped(prepared.context.output)
    with locked(prepared.context.output):
        deliveries = usable(prepared, stopped=stopped)
        claim(prepared.context.store)
        deliveries.begin(this_survey(prepared))
        job = _find(task, prepared)
        prepared.receiver.before(prepared.steps[job.task.kind], prepared)
        receipt = run_task(job.task, job.key, prepared.context)
        deliveries.wrote(receipt)
        deliveries.save()
    if not receipt.failed:
        return AloneResult(receipt, None)
    name = f"{job.task.kind}_{job.task.name.replace('/', '~')}.txt"
    path = prepared.context.output / "store" / "tracebacks" / name
    write_bytes(path, str(receipt.facts.get("traceback", "")).encode())
    return AloneResult(receipt, path)


def _find(wanted: str, prepared: Prepared[Any, Any]) -> Job:
    """The task of a name, made from what is finished."""
    kind, _, name = wanted.strip().partition(" ")
    if kind not in prepared.steps or not name:
        raise WorkflowError(
            f"--only {wanted!r}: write kind and name of a task, such as 'ground 3_4'; kinds are "
            f"{', '.join(prepared.steps)}"
        )
    for step in prepared.steps.values():
        work = Worklist(step, prepared.ledger, prepared.context)
        if step.name == kind:
            break
        for _ in work.look():
            pass  # what is finished is put where later steps find it
        prepared.ledger.of(step.name).sort()
    jobs = []
    for task in step.planned(prepared.ledger):
        job = work.job(task)
        if job is not None and task.name == name:
            return job
        if job is not None:
            jobs.append(task.name)
    there = ", ".join(jobs[:5])
    raise WorkflowError(
        f"--only {wanted!r}: no such task; "
        + (f"there are {there}{', ...' if len(jobs) > 5 else ''}" if jobs else "")
        + ("what it needs is not finished: run without --only first" if not jobs else "")
    )
