"""Run a workflow: step after step, skipping what is finished, isolating what fails."""

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from spl_batch.engine.flow.cluster import executor, refuse_no_address
from spl_batch.engine.flow.warm_up import WarmUp
from spl_batch.engine.plan.budget import Cost
from spl_batch.engine.store.output_lock import locked, was_stopped
from spl_batch.engine.tasks.step import stages
from spl_batch.engine.verbs.conclusion import REST, RunResult, concluded, rested
from spl_batch.engine.verbs.graph import Graph
from spl_batch.engine.verbs.output_owner import claim, gone_inputs, this_survey, usable
from spl_batch.engine.verbs.planning import fitting_cost
from spl_batch.engine.verbs.preparing import prepare
from spl_batch.engine.verbs.progress import Progress
from spl_batch.engine.verbs.receiver import FirstLook, Prepared
from spl_batch.engine.watch.events import Listener, RunEnded, RunStarted, ignore
from spl_batch.errors import (
    SplBatchError,
    StoppedError,
    WorkflowError,
    refuse_without,
    told_by_system,
    told_together,
)
from spl_batch.formats.files.atomic import remove, stop_if_full

COMPILING: Final = (
    "getting the kernels ready; the first run on a machine compiles them, which usually takes a "
    "minute or two, and later runs load them in seconds"
)
"""Note before tasks begin; workers count the kernels, tasks in this process compile as they go."""


def run(
    workflow: Path | str,
    *,
    workers: int = 2,
    memory: str | int | None = None,
    scheduler: str | None = None,
    fresh: bool = False,
    until: str | None = None,
    overrides: Sequence[str] = (),
    listener: Listener = ignore,
) -> RunResult:
    """Process a survey; run again, it continues where it stopped.

    Parameters
    ----------
    workflow : Path or str
        Workflow file.
    workers : int
        Worker processes on this machine; 0 works in this process.
    memory : str or int, optional
        Memory limit of a worker, e.g. ``"4GiB"`` [byte]; a share of the machine's by default,
        4 GiB with a scheduler.
    scheduler : str, optional
        Address of a running dask scheduler, used instead of local workers.
    fresh : bool
        Forget what earlier runs finished.
    until : str, optional
        Last stage to run.
    overrides : sequence of str
        ``key.path=value``, applied to the workflow.
    listener : callable
        Takes each event.

    Returns
    -------
    RunResult

    Raises
    ------
    WorkflowError, PlanError
        If nothing can be started.
    StoppedError
        If the run had to stop as a whole; the same call continues it.
    """
    start = time.perf_counter()
    refuse_no_address(scheduler)
    prepared = prepare(
        Path(workflow), overrides, memory=memory, workers=workers, remote=scheduler is not None
    )
    context, kind = prepared.context, prepared.context.workflow.kind
    if until is not None and until not in stages(kind):
        raise WorkflowError(f"--until {until}: write one of {', '.join(stages(kind))}")
    reports = until in {None, "report"}
    if reports:
        refuse_without("matplotlib", "reports", "report")
    cost, output = fitting_cost(prepared), context.output
    usable(prepared)  # before the lock, which would leave a file in somebody else's folder
    look = prepared.receiver.first_look(prepared)  # refuses what a plan refuses
    new, stopped = not output.exists(), was_stopped(output)
    with locked(output) as mark:
        prepared = replace(prepared, context=replace(context, mark=mark))
        deliveries = usable(prepared, stopped=stopped)
        gone = [*gone_inputs(prepared, deliveries)]
        deliveries.begin(this_survey(prepared))
        if fresh:
            context.store.clear()
        claim(context.store)
        progress = Progress(prepared, workers, deliveries, listener)
        progress.tell(_started(prepared, workflow, workers, cost))
        with _logging_the_end(progress), _stopped_by_system():
            if stopped:
                progress.tidy()
            if new and not output.is_relative_to(context.base):  # a slip would show
                progress.note(f"created folder {output}")
            progress.warn((*prepared.ledger.remarks, *gone, *prepared.ledger.inputs.warnings))
            _report_faults(prepared, look, progress)
            compiles = prepared.receiver.compiles
            warm_up = WarmUp(compiles, COMPILING) if compiles else None
            if new and compiles and not workers and scheduler is None:
                progress.note(COMPILING)
            result = rested(prepared, progress, start) if reports and not fresh else None
            if result is None:
                remove(context.store.local / REST)
            while result is None:
                with executor(
                    prepared.context,
                    workers=workers,
                    memory_bytes=prepared.ledger.memory_bytes,
                    scheduler=scheduler,
                    observer=progress,
                    warm_up=warm_up,
                ) as pool:
                    again = True
                    while again:
                        Graph(_steps(prepared, until), pool, progress).run()
                        again = progress.repair()
                compile_s = warm_up.took_s if warm_up else None
                result = concluded(progress, until, start, compile_s)
        progress.tell(RunEnded(result.exit_status))
    return result


def _report_faults(prepared: Prepared[Any, Any], look: FirstLook, progress: Progress) -> None:
    """Name the inputs that cannot be used."""
    for text in (*told_together(prepared.ledger.inputs.bad), *look.late):
        progress.note(text, "error")


def _steps(prepared: Prepared[Any, Any], until: str | None) -> list[Any]:
    """Steps up to a stage."""
    order = stages(prepared.context.workflow.kind)
    last = order.index(until) if until else len(order)
    return [step for step in prepared.steps.values() if order.index(step.stage) <= last]


@contextmanager
def _logging_the_end(progress: Progress) -> Iterator[None]:
    """Log why a run stops before its end, for those who watch it from elsewhere."""
    try:
        yield
    except (SplBatchError, KeyboardInterrupt) as error:
        status = error.exit_status if isinstance(error, SplBatchError) else 3
        try:
            progress.tell(RunEnded(status, str(error) or "interrupted"))
        except StoppedError as unwritten:
            raise error from unwritten
        raise


@contextmanager
def _stopped_by_system() -> Iterator[None]:
    """Make what the system refuses stop the run: its work has begun, and can be continued."""
    try:
        yield
    except TimeoutError:  # of a cluster: the caller knows what helps
        raise
    except OSError as error:
        stop_if_full(error, error.filename or "output")
        text = told_by_system(error, "mend that, and run again to continue")
        raise StoppedError(text) from error


def _started(
    prepared: Prepared[Any, Any], workflow: Path | str, workers: int, cost: Cost
) -> RunStarted:
    """What the log has of the beginning of a run."""
    unusable = [
        {"path": bad.path, "reason": "; ".join(bad.faults)} for bad in prepared.ledger.inputs.bad
    ]
    return RunStarted(
        str(workflow),
        workers,
        prepared.context.code,
        {stage: round(s / cost.workers, 1) for stage, s in cost.stages_s.items()},
        stages(prepared.context.workflow.kind),
        unusable,
    )
