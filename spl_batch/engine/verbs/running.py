"""Run a workflow: phase after phase, skipping what is finished, isolating what fails."""

import threading
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import cache, partial
from itertools import chain
from pathlib import Path
from typing import Any, Final

from spl_batch.engine.findings import of_receipts
from spl_batch.engine.flow.executor import Ahead, Executor, Footing, executor, refuse_no_address
from spl_batch.engine.plan.budget import Cost
from spl_batch.engine.report.run_record import StageCost
from spl_batch.engine.store.output_lock import lock_file, locked
from spl_batch.engine.store.output_owner import gone_inputs, this_survey, usable
from spl_batch.engine.store.store_owner import claim
from spl_batch.engine.tasks.ledger import Phase, waves
from spl_batch.engine.tasks.receipt_index import delivers
from spl_batch.engine.tasks.runner import kinds
from spl_batch.engine.tasks.task import Receipt
from spl_batch.engine.tasks.worklist import Worklist
from spl_batch.engine.verbs.conclusion import RunResult, concluded, kind_of, stages_of
from spl_batch.engine.verbs.failures import Invocation
from spl_batch.engine.verbs.planning import fitting_cost
from spl_batch.engine.verbs.preparing import prepare
from spl_batch.engine.verbs.receiver import Prepared, Receiver
from spl_batch.engine.verbs.repair import Repairs
from spl_batch.engine.watch.events import Listener, Note, PhaseStarted, RunEnded, RunStarted, ignore
from spl_batch.engine.watch.progress import Progress
from spl_batch.errors import (
    SplBatchError,
    StoppedError,
    WorkflowError,
    refuse_without,
    told_by_system,
    told_together,
)
from spl_batch.formats.files.atomic import stop_if_full

COMPILING: Final = (
    "getting the kernels ready; the first run on a machine compiles them, which usually takes a "
    "minute or two, and later runs load them in seconds"
)


def run(
    workflow: Path | str,
    *,
    workers: int = 2,
    memory: str | int | None = None,
    scheduler: str | None = None,
    fresh: bool = False,
    verify: bool = False,
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
        Memory limit of a worker, e.g. ``"4GiB"`` [byte]; a share of the machine's
        unless told, 4 GiB with a scheduler.
    scheduler : str, optional
        Address of a running dask scheduler, used instead of local workers.
    fresh : bool
        Forget what earlier runs finished.
    verify : bool
        Compare everything that is finished with its checksum, which reads all of it.
    until : str, optional
        Last stage to run.
    overrides : sequence of str
        ``key.path=value``, applied to the workflow.
    listener : callable
        Told what happens.

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
    order = stages_of(prepared)
    if until is not None and until not in order:
        raise WorkflowError(f"--until {until}: write one of {', '.join(order)}")
    if _reports(until):
        refuse_without("matplotlib", "reports", "report")
    cost = fitting_cost(prepared)
    output = prepared.context.output
    invocation = Invocation(workflow, workers, prepared.ledger.memory_bytes, overrides)
    usable(prepared)  # before the lock, which would leave a file in somebody else's folder
    look = prepared.receiver.first_look(prepared)  # refuses what a plan refuses
    new = not output.exists()
    with locked(output) as mark:
        deliveries = usable(prepared)
        claim(prepared.context.store)
        gone = [*gone_inputs(prepared, deliveries)]
        deliveries.begin(this_survey(prepared))
        if fresh:
            prepared.context.store.clear()
            claim(prepared.context.store)
        repairs = Repairs(prepared.context.store)
        progress = Progress(
            output,
            listener,
            invocation,
            repairs,
            deliveries,
            kinds(kind_of(prepared)),
            {str(source.key): source.name for source in prepared.ledger.inputs.sources},
            prepared.receiver.essential,
            ignored=prepared.context.workflow.report.ignore,
        )
        code = prepared.context.code
        phases = Counter(progress.stage(phase.kind) for phase in prepared.receiver.phases)
        anew = not prepared.context.store.path("receipts").exists()
        unusable = [
            {"path": bad.path, "reason": "; ".join(bad.faults)}
            for bad in prepared.ledger.inputs.bad
        ]
        expected_s = _expected_s(cost)
        progress.tell(
            RunStarted(str(workflow), workers, code, expected_s, order, phases, anew, unusable)
        )
        progress.tidy()
        compiles = prepared.receiver.compiles
        ahead = compiles and Ahead(compiles, COMPILING)
        with _telling_the_end(progress), _stopped_by_system():
            if new and not output.is_relative_to(prepared.context.base):  # a slip would show
                progress.tell(Note("info", f"created folder {output}"))
            progress.warn((*prepared.ledger.remarks, *gone))
            progress.warn(prepared.ledger.inputs.warnings)
            for text in (*told_together(prepared.ledger.inputs.bad), *look.late):
                progress.tell(Note("error", text))
            workforce = partial(
                executor,
                workers=workers,
                memory_bytes=prepared.ledger.memory_bytes,
                scheduler=scheduler,
                observer=progress,
                footing=Footing(kind_of(prepared), code, str(lock_file(output)), mark),
                ahead=ahead,
            )
            result = None
            while result is None:
                with workforce() as pool:
                    _process(prepared, pool, progress, until, verify=verify)
                compile_s = ahead.took_s if ahead else None
                result = concluded(prepared, progress, until, (start, compile_s))
        progress.mended()
        progress.tell(RunEnded(result.exit_status))
    return result


def _reports(until: str | None) -> bool:
    """Whether a run that ends with this stage writes a report."""
    return until in {None, "report"}


@contextmanager
def _telling_the_end(progress: Progress) -> Iterator[None]:
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
    except TimeoutError:  # of a cluster: who calls tells what helps
        raise
    except OSError as error:
        stop_if_full(error, error.filename or "output")
        text = told_by_system(error, "mend that, and run again to continue")
        raise StoppedError(text) from error


def _expected_s(cost: Cost) -> dict[str, float]:
    """Time that each stage is expected to take with these workers [s]."""
    return {stage: round(s / cost.workers, 1) for stage, s in cost.stages_s.items()}


def _process(
    prepared: Prepared[Any, Any],
    pool: Executor,
    progress: Progress,
    until: str | None,
    *,
    verify: bool,
) -> None:
    """Go through the phases, and once more where a file of the store had to be made again."""
    _run_phases(prepared, pool, progress, until, verify=verify)
    while progress.repair(prepared.ledger):
        _run_phases(prepared, pool, progress, until, verify=verify)


def _run_phases(
    prepared: Prepared[Any, Any],
    pool: Executor,
    progress: Progress,
    until: str | None,
    *,
    verify: bool,
) -> None:
    ledger, receiver, order = prepared.ledger, prepared.receiver, stages_of(prepared)
    last = order.index(until) if until else len(order)
    reports = _reports(until)
    for wave in waves(receiver.phases):
        phases = [p for p in wave if order.index(progress.stage(p.kind)) <= last]
        _run_wave(phases, prepared, pool, progress, verify=verify, reports=reports)
        if progress.repairs.wanted(progress.failed, ledger):
            return
        for phase in phases:
            progress.warn(receiver.after(phase, prepared, progress.failed))
            progress.warn(receiver.aside(phase, prepared))
            progress.warn(of_receipts(ledger.of(phase.kind)))


def _run_wave(
    phases: Sequence[Phase],
    prepared: Prepared[Any, Any],
    pool: Executor,
    progress: Progress,
    *,
    verify: bool,
    reports: bool,
) -> None:
    """Do what phases that do not wait for each other have left to do."""
    work: dict[str, Worklist] = {}
    targets: list[str] = []
    for phase in phases:
        prepared.receiver.before(phase, prepared)
        work[phase.kind] = Worklist(phase, prepared.ledger, prepared.context, verify=verify)
        targets += _begin_phase(
            work[phase.kind], phase.kind, prepared, pool, progress, reports=reports
        )
    for text in progress.deliveries.make_room(targets):
        progress.tell(Note("info", text))

    def on_receipt(receipt: Receipt) -> None:
        progress.deliveries.wrote(receipt)
        progress.ended(work[receipt.kind].ended(receipt), receipt)

    for some in work.values():
        for receipt in some.refused:
            on_receipt(receipt)
    if any(some.left for some in work.values()):
        jobs = chain.from_iterable(some.jobs() for some in work.values())
        pool.run(jobs, prepared.context, on_receipt)
    for kind in work:
        prepared.ledger.of(kind).sort()
    if any(map(delivers, work)):
        progress.deliveries.save()


def _begin_phase(
    work: Worklist,
    kind: str,
    prepared: Prepared[Any, Any],
    pool: Executor,
    progress: Progress,
    *,
    reports: bool,
) -> list[str]:
    """See what one phase has left to do, and tell of it; the files that it will deliver."""
    targets: list[str] = []
    stage = progress.stage(kind)
    for task, receipt in work.look():
        if receipt is None:
            targets += prepared.receiver.targets(task, prepared.context.workflow)
        else:
            progress.deliveries.wrote(receipt)
            progress.costs.setdefault(stage, StageCost()).skip(receipt)
    if work.altered:
        progress.altered(work.altered)
    if not work.left and not work.ready:
        return targets
    if work.left:
        pool.make_ready()
        if reports and progress.invocation.workers:
            _load_meanwhile(prepared.receiver)
    progress.tell(PhaseStarted(stage, kind, work.left, work.ready, work.points))
    return targets


@cache
def _load_meanwhile(receiver: Receiver[Any, Any]) -> None:
    """Once, load what is needed in the end, as long as workers do the work."""
    threading.Thread(target=receiver.load_report, name="load report", daemon=True).start()
