"""Run a workflow: step after step, skipping what is finished, isolating what fails.

A survey has a receipt for each tile and step; to look at each takes minutes on a million tiles. So
a run that has finished everything records what decides its results, the times of its inputs, of
what it has delivered and of the folders of its store. A later one that finds them as they were has
nothing to do. A file that was altered within the store is noticed where it is read.
"""

import os
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

from spl_batch.engine.flow.cluster import executor, refuse_no_address
from spl_batch.engine.plan.budget import Cost
from spl_batch.engine.report.number_format import as_ascii, duration
from spl_batch.engine.report.run_record import REPORT_FILES, RunFacts, remember, report_code
from spl_batch.engine.store.output_lock import locked, was_stopped
from spl_batch.engine.store.working_store import read_json, write_json
from spl_batch.engine.tasks.input_changes import stamp_if_there
from spl_batch.engine.tasks.step import Step, stages
from spl_batch.engine.verbs.graph import Graph
from spl_batch.engine.verbs.output_owner import input_paths, usable
from spl_batch.engine.verbs.planning import fitting_cost, prepare
from spl_batch.engine.verbs.progress import Progress, failures
from spl_batch.engine.verbs.receiver import Prepared
from spl_batch.engine.watch.events import Listener, ReportStarted, RunEnded, RunStarted, ignore
from spl_batch.errors import (
    DamagedError,
    SplBatchError,
    StoppedError,
    WorkflowError,
    merged_faults,
    refuse_without,
    system_fault,
)
from spl_batch.formats.files.atomic import json_digest, remove, stop_if_full
from spl_batch.receivers import report_model, summariser

REST: Final = "rest.json"
"""File beside the receipts that records the state of a finished run."""


@dataclass(frozen=True, slots=True)
class RunResult:
    """How a run ended."""

    exit_status: int  #: 0 all done, 1 some files or tiles failed.
    output: Path  #: Folder of the results.
    report: Any  #: The receiver's model of its report; None when the run was to stop before it.
    screen: tuple[tuple[str, str], ...] = ()  #: Label and value of the numbers that matter.
    #: Label and paths of what a user looks at first.
    results: tuple[tuple[str, list[Path]], ...] = ()


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
    steps, reports = _steps(prepared, until), until in {None, "report"}
    if reports:
        refuse_without("matplotlib", "reports", "report")
    context, output = prepared.context, prepared.context.output
    cost = fitting_cost(prepared)
    usable(prepared)  # before the lock, which would leave a file in somebody else's folder
    look = prepared.receiver.first_look(prepared)  # refuses what a plan refuses
    new, stopped = not output.exists(), was_stopped(output)
    with locked(output) as mark:
        prepared = replace(prepared, context=replace(context, mark=mark))
        deliveries = usable(prepared, stopped=stopped)
        gone = [*deliveries.gone_inputs()]
        if fresh:
            context.store.clear()
        deliveries.begin()
        progress = Progress(prepared, workers, deliveries, listener, reports)
        progress.notify(_started(prepared, workflow, workers, cost))
        with _logging_the_end(progress), _stopped_by_system():
            if stopped:
                progress.tidy()
            if new and not output.is_relative_to(context.base):  # a slip would show
                progress.note(f"created folder {output}")
            progress.warn((*prepared.ledger.remarks, *gone, *prepared.ledger.inputs.warnings))
            for text in (*merged_faults(prepared.ledger.inputs.bad), *look.late):
                progress.note(text, "error")
            warm_up = prepared.receiver.warm_up(context.workflow, until, workers)
            if new and warm_up and not workers and scheduler is None:
                progress.note(warm_up.what)
            result = _rested(progress, start) if reports and not fresh else None
            if result is None:
                remove(context.store.local / REST)
            while result is None:
                with executor(
                    prepared.context,
                    workers=workers,
                    memory_bytes=prepared.ledger.memory_bytes,
                    scheduler=scheduler,
                    observer=progress,
                    warm_up=None if scheduler else warm_up,
                ) as pool:
                    again = True
                    while again:
                        Graph(steps, pool, progress).run()
                        again = progress.repair()
                progress.withdraw(steps)
                compile_s = warm_up.waited_s if warm_up else None
                result = _concluded(progress, start, compile_s, reports=reports)
        progress.notify(RunEnded(result.exit_status))
    return result


def _steps(prepared: Prepared[Any, Any], until: str | None) -> list[Step]:
    """Steps up to a stage."""
    order = stages(prepared.context.workflow.kind)
    if until is not None and until not in order:
        raise WorkflowError(f"--until {until}: write one of {', '.join(order)}")
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
            progress.notify(RunEnded(status, str(error) or "interrupted"))
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
        text = system_fault(error, "mend that, and run again to continue")
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


def _concluded(
    progress: Progress, start: float, compile_s: float | None, *, reports: bool
) -> RunResult | None:
    """Write the report unless the run was to stop before it.

    None where a file that it reads has to be made again. ``start``: when the run began;
    ``compile_s``: how long it has waited for kernels [s].
    """
    prepared = progress.prepared
    ledger, receiver, output = prepared.ledger, prepared.receiver, prepared.context.output
    if not reports:
        return RunResult(int(bool(progress.failures or ledger.inputs.bad)), output, None)
    facts = RunFacts(
        time.perf_counter() - start,
        progress.workers,
        progress.costs,
        tuple(failures(prepared, progress.failures)),
        tuple(progress.findings),
        tuple(receiver.reference(ledger)),
        receiver.not_read(ledger),
        compile_s,
    )
    progress.notify(ReportStarted())
    try:
        summarise = summariser(prepared.context.workflow.kind)
        written = summarise(ledger.done, prepared.context, facts)
    except DamagedError as error:
        if not progress.repair([error]):
            raise
        return None
    remember(ledger.done, prepared.context, facts)
    progress.late(written.findings)
    if not written.failures:
        _rest(progress)
    return result_of(receiver, output, written)


def result_of(
    receiver: Any, output: Path, written: Any, more: Iterable[tuple[str, str]] = ()
) -> RunResult:
    """Result of a run whose report is there."""
    screen = (*receiver.screen(written), *more)
    status = int(bool(written.failures))
    return RunResult(status, output, written, screen, tuple(receiver.results(output)))


def _rest(progress: Progress) -> None:
    """Record that everything is finished."""
    store = progress.prepared.context.store
    if store.url is None:  # folders elsewhere have no times
        below = (folder for folder, _, _ in os.walk(store.local))
        folders = sorted({str(Path(folder).relative_to(store.local)) for folder in below} - {"."})
        content = {"folders": folders, "state": _state(progress, folders)}
        write_json(store.local / REST, content)


def _rested(progress: Progress, start: float) -> RunResult | None:
    """Result of a run that finds everything as it was left; None where there is work to do."""
    context = progress.prepared.context
    model, report = report_model(context.workflow.kind), context.output / REPORT_FILES[0]
    try:
        kept = read_json(context.store.local / REST)
        if kept["state"] != _state(progress, kept["folders"]):
            return None
        written = model.model_validate_json(report.read_bytes())
    except (DamagedError, OSError, ValueError):  # none, or none to be trusted: receipts have it
        return None
    progress.late(written.findings)
    took = as_ascii(duration(time.perf_counter() - start))
    now = [("now", f"nothing was left to do: looked at in {took}")]
    return result_of(progress.prepared.receiver, context.output, written, now)


def _state(progress: Progress, folders: Iterable[str]) -> str:
    """Hash of what decides the results, and of the times of what is there."""
    prepared, context = progress.prepared, progress.prepared.context
    reports = (context.output / name for name in REPORT_FILES)
    parts = [
        context.workflow.model_dump(mode="json"),
        *(context.crs_wkt, context.code, report_code(context.workflow.kind)),
        prepared.ledger.memory_bytes,
        prepared.receiver.decisive(prepared),
        [[str(path), *stamp_if_there(path)] for path in (*input_paths(prepared), *reports)],
        [[n, *stamp_if_there(context.output / n)] for n in sorted(progress.deliveries.files)],
        [_written_ns(context.store.local / name) for name in folders],
    ]
    return json_digest(parts, finite=False)


def _written_ns(folder: Path) -> int:
    """When a folder has got or lost a name [ns since 1970]; 0 without it."""
    try:
        return folder.stat().st_mtime_ns
    except OSError:
        return 0
