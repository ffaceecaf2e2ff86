"""How a run ends: what is stale is deleted, the report is written, a finished run is recorded.

A survey has a receipt for each tile and step; to look at each takes minutes on a million tiles. So
a run that has finished everything records what decides its results, the times of its inputs, of
what it has delivered and of the folders of its store. A later one that finds them as they were has
nothing to do. A file that was altered within the store is noticed where it is read.
"""

import hashlib
import json
import os
import time
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from spl_batch.engine.findings import Finding
from spl_batch.engine.report.number_format import as_ascii, duration
from spl_batch.engine.report.run_record import REPORT_FILES, RunFacts, report_code
from spl_batch.engine.store.deliveries import Deliveries
from spl_batch.engine.store.working_store import read_json, write_json
from spl_batch.engine.tasks.input_changes import stamp_if_there
from spl_batch.engine.tasks.step import delivering, stages
from spl_batch.engine.verbs.progress import Progress, failures
from spl_batch.engine.verbs.receiver import Prepared
from spl_batch.engine.watch.events import ReportStarted
from spl_batch.errors import DamagedError
from spl_batch.receivers import report_model

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


def concluded(
    progress: Progress, until: str | None, start: float, compile_s: float | None
) -> RunResult | None:
    """Delete what is stale, and write the report unless the run was to stop before it.

    None where a file that the report reads has to be made again. ``start``: when the run began;
    ``compile_s``: how long it has compiled [s].
    """
    prepared, kind = progress.prepared, progress.prepared.context.workflow.kind
    ledger, receiver, output = prepared.ledger, prepared.receiver, prepared.context.output
    order, first = stages(kind), prepared.steps[delivering(kind)[0]].stage
    if until is None or order.index(until) >= order.index(first):
        for text in progress.deliveries.withdraw(ledger, failed=bool(progress.failures)):
            progress.note(text)
        if progress.deliveries.spared:
            progress.warn([Finding("E02", {"files": list(progress.deliveries.spared)})])
    if until is not None and until != "report":
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
    progress.tell(ReportStarted())
    try:
        written = receiver.report(ledger.done, prepared.context, facts)
    except DamagedError as error:
        if not progress.repair([error]):
            raise
        return None
    progress.late(written.findings)
    if not written.failures:
        _rest(prepared, progress.deliveries)
    return result_of(receiver, output, written)


def result_of(
    receiver: Any, output: Path, written: Any, more: Iterable[tuple[str, str]] = ()
) -> RunResult:
    """Result of a run whose report is there."""
    screen = (*receiver.screen(written), *more)
    status = int(bool(written.failures))
    return RunResult(status, output, written, screen, tuple(receiver.results(output)))


def _rest(prepared: Prepared[Any, Any], deliveries: Deliveries) -> None:
    """Record that everything is finished."""
    store = prepared.context.store
    if store.url is None:  # folders elsewhere have no times
        below = (place for place, _, _ in os.walk(store.local))
        folders = sorted({str(Path(place).relative_to(store.local)) for place in below} - {"."})
        content = {"folders": folders, "state": _state(prepared, deliveries, folders)}
        write_json(store.local / REST, content)


def rested(prepared: Prepared[Any, Any], progress: Progress, start: float) -> RunResult | None:
    """Result of a run that finds everything as it was left; None where there is work to do.

    ``start``: when the run began [s].
    """
    file, output = prepared.context.store.local / REST, prepared.context.output
    model = report_model(prepared.context.workflow.kind)
    try:
        kept = read_json(file)
        if kept["state"] != _state(prepared, progress.deliveries, kept["folders"]):
            return None
        written = model.model_validate_json((output / REPORT_FILES[0]).read_bytes())
    except (DamagedError, OSError, ValueError):  # none, or none to be trusted: receipts have it
        return None
    progress.late(written.findings)
    took = as_ascii(duration(time.perf_counter() - start))
    now = [("now", f"nothing was left to do: looked at in {took}")]
    return result_of(prepared.receiver, output, written, now)


def _state(prepared: Prepared[Any, Any], deliveries: Deliveries, folders: Iterable[str]) -> str:
    """Hash of what decides the results, and of the times of what is there."""
    context, ledger = prepared.context, prepared.ledger
    inputs = [*(source.path for source in ledger.inputs.sources)]
    inputs += [Path(bad.path) for bad in ledger.inputs.bad]
    reports = (context.output / name for name in REPORT_FILES)
    parts = [
        context.workflow.model_dump(mode="json"),
        *(context.crs_wkt, context.code, report_code(context.workflow.kind)),
        ledger.memory_bytes,
        prepared.receiver.decisive(prepared),
        [[str(path), *stamp_if_there(path)] for path in (*inputs, *reports)],
        [[name, *stamp_if_there(context.output / name)] for name in sorted(deliveries.files)],
        [_written_ns(context.store.local / name) for name in folders],
    ]
    return hashlib.blake2b(json.dumps(parts, sort_keys=True).encode(), digest_size=16).hexdigest()


def _written_ns(folder: Path) -> int:
    """When a folder has got or lost a name [ns since 1970]; 0 without it."""
    try:
        return folder.stat().st_mtime_ns
    except OSError:
        return 0
