"""How a run ends: what is stale is deleted, the report is written, and a user is told."""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from spl_batch.engine.findings import Finding
from spl_batch.engine.report.number_format import as_ascii, duration
from spl_batch.engine.report.run_record import REPORT_FILES, RunFacts, stands
from spl_batch.engine.tasks.ledger import Ledger
from spl_batch.engine.tasks.runner import damaged_rasters
from spl_batch.engine.tasks.step import delivering, stages
from spl_batch.engine.verbs.failures import failures
from spl_batch.engine.verbs.receiver import Prepared
from spl_batch.engine.verbs.resting import rest
from spl_batch.engine.watch.earlier_runs import earlier_wall_s, log_bytes
from spl_batch.engine.watch.events import Note, ReportStarted
from spl_batch.engine.watch.listing import listed
from spl_batch.engine.watch.progress import Progress
from spl_batch.errors import DamagedError
from spl_batch.receivers import report_model


@dataclass(frozen=True, slots=True)
class RunResult:
    """How a run ended.

    Parameters
    ----------
    exit_status : int
        0 all done, 1 some files or tiles failed.
    output : Path
        Folder of the results.
    report : BaseModel or None
        The receiver's model of its report, that of an airborne survey is
        :class:`~spl_batch.airborne.report.model.Report`; None when the run was told to stop before
        it.
    screen : tuple of (str, str)
        Label and value of the numbers that matter.
    results : tuple of (str, list of Path)
        Label and paths of what a user looks at first.
    """

    exit_status: int
    output: Path
    report: Any
    screen: tuple[tuple[str, str], ...] = ()
    results: tuple[tuple[str, list[Path]], ...] = ()

    def __repr__(self) -> str:
        files = ((label, ", ".join(map(str, paths))) for label, paths in self.results if paths)
        own = (("exit status", str(self.exit_status)), ("output", str(self.output)))
        return listed("RunResult", (*own, *self.screen, *files))


def stages_of(prepared: Prepared[Any, Any]) -> tuple[str, ...]:
    """Stages of a run, in order."""
    return stages(kind_of(prepared))


def kind_of(prepared: Prepared[Any, Any]) -> str:
    """Kind of the workflow of a run."""
    return str(prepared.context.workflow.kind)


def concluded(
    prepared: Prepared[Any, Any],
    progress: Progress,
    until: str | None,
    took: tuple[float, float | None],
) -> RunResult | None:
    """Result of a run; None where a file that its report reads has to be made again."""
    try:
        return _conclude(prepared, progress, until, took)
    except DamagedError as error:
        also = damaged_rasters(prepared.ledger.done, prepared.context)
        if not progress.repair(prepared.ledger, [error, *also]):
            raise
        return None


def _conclude(
    prepared: Prepared[Any, Any],
    progress: Progress,
    until: str | None,
    took: tuple[float, float | None],
) -> RunResult:
    """Delete what is stale, and write the report unless the run was to stop before it.

    ``took`` is when the run began, and how long it has compiled [s].
    """
    ledger, context, receiver = prepared.ledger, prepared.context, prepared.receiver
    order = stages_of(prepared)
    first = prepared.steps[delivering(kind_of(prepared))[0]].stage
    if until is None or order.index(until) >= order.index(first):
        _withdraw(progress, ledger)
    if until is not None and until != "report":
        status = int(bool(progress.failures or ledger.inputs.bad))
        return RunResult(status, context.output, None)
    found = any(cost.skipped for cost in progress.costs.values())
    earlier_s = earlier_wall_s(context.output) if found else 0.0
    facts = RunFacts(
        time.perf_counter() - took[0] + (earlier_s or 0.0),
        progress.invocation.workers,
        progress.costs,
        tuple(failures(prepared, progress.failures)),
        progress.findings,
        receiver.reference(ledger),
        receiver.not_read(ledger),
        earlier_s,
        log_bytes(context.output),
        took[1],
    )
    written = _standing(prepared, facts) if progress.idle else None
    now = []
    if written is None:
        for damaged in damaged_rasters(ledger.done, context):
            raise damaged
        progress.tell(ReportStarted())
        written = receiver.report(ledger.done, context, facts)
        progress.late(written.findings)
    else:
        now = _looked(took[0])
    if not written.failures:
        rest(prepared, progress.deliveries)
    return _result(prepared, written, now)


def rested(prepared: Prepared[Any, Any], progress: Progress, start: float) -> RunResult | None:
    """Result of a run that finds everything as it has left it; None where its report is not.

    ``start``: when the run began [s].
    """
    written = _read_report(prepared)
    if written is None:
        return None
    progress.late(written.findings)
    return _result(prepared, written, _looked(start))


def _result(
    prepared: Prepared[Any, Any], written: Any, now: Sequence[tuple[str, str]]
) -> RunResult:
    output, receiver = prepared.context.output, prepared.receiver
    screen, shown = (*receiver.screen(written), *now), tuple(receiver.results(output))
    return RunResult(int(bool(written.failures)), output, written, screen, shown)


def _looked(start: float) -> list[tuple[str, str]]:
    seconds = as_ascii(duration(time.perf_counter() - start))
    return [("now", f"nothing was left to do: looked at in {seconds}")]


def _withdraw(progress: Progress, ledger: Ledger[Any, Any]) -> None:
    """Delete what is stale, and tell of it."""
    deliveries = progress.deliveries
    for text in deliveries.withdraw(ledger, failed=bool(progress.failures)):
        progress.tell(Note("info", text))
    if deliveries.spared:
        progress.warn([Finding("E02", {"files": list(deliveries.spared)})])


def _standing(prepared: Prepared[Any, Any], facts: RunFacts) -> Any:
    """The report that is there; None where it would say something else now."""
    return _read_report(prepared) if stands(prepared.ledger.done, prepared.context, facts) else None


def _read_report(prepared: Prepared[Any, Any]) -> Any:
    """The report that is there; None where it cannot be read."""
    context = prepared.context
    model = report_model(kind_of(prepared))
    try:
        return model.model_validate_json((context.output / REPORT_FILES[0]).read_bytes())
    except (OSError, ValueError):  # damaged in spite of its time of writing: it is written again
        return None
