"""Costs and failures of one run as they come in; what happens is told and logged."""

import os
import threading
import time
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from spl_batch.engine.findings import Finding, settled
from spl_batch.engine.report.parts import FindingReport
from spl_batch.engine.report.reported import reported
from spl_batch.engine.report.run_record import StageCost
from spl_batch.engine.store.deliveries import Deliveries
from spl_batch.engine.store.working_store import append_log
from spl_batch.engine.tasks.ledger import Ledger
from spl_batch.engine.tasks.step import Steps
from spl_batch.engine.tasks.task import Receipt, Task, WorkersSeen
from spl_batch.engine.verbs.failures import Failed, Invocation, plain_name
from spl_batch.engine.verbs.repair import Repairs
from spl_batch.engine.watch.events import (
    Compiling,
    Event,
    Listener,
    Note,
    TaskEnded,
    TaskStarted,
    WorkersReady,
    as_record,
)
from spl_batch.errors import DamagedError, counted, named
from spl_batch.formats.files.atomic import sweep

LISTED: Final = 5
"""Damaged files that a line names [count]."""

LOG_WORKERS_S = 10.0
"""How often the log says how the workers are [s]."""


@dataclass
class Progress:
    """State of a run, and those who are told of it."""

    output: Path
    listener: Listener
    invocation: Invocation  #: How the run was started.
    repairs: Repairs
    deliveries: Deliveries  #: What this run and those before it have written into the output.
    steps: Steps  #: What the receiver does.
    names: Mapping[str, str] = field(default_factory=dict)  #: Names of the input files by key.
    costs: dict[str, StageCost] = field(default_factory=dict)
    failures: list[Failed] = field(default_factory=list)
    ignored: tuple[str, ...] = ()  #: Codes that the report is silent about.
    findings: list[Finding] = field(default_factory=list)
    logged_s: float = -1e9
    lock: threading.RLock = field(default_factory=threading.RLock)

    def __post_init__(self) -> None:
        end_last_line(self.output / "log.jsonl")

    def stage(self, kind: str) -> str:
        """Stage that a kind of task belongs to."""
        return self.steps[kind].stage

    def tell(self, event: Event) -> None:
        """Pass an event on, to the log as well."""
        with self.lock:  # workers report their beginnings in another thread
            append_log(self.output, as_record(event))
            self.listener(event)

    def warn(self, findings: Iterable[Finding]) -> None:
        """Report what was found, alike ones together, once."""
        new = settled(findings, self.ignored, self.findings)
        self.findings += new
        for one in reported(new, notes=True):
            self.tell(Note("info" if one.severity == "note" else one.severity, one.text))

    def late(self, findings: Iterable[FindingReport]) -> None:
        """Report what only the whole survey shows; the rest was reported as it was found."""
        known = {(one.code, one.values.get("kind")) for one in self.findings}
        for one in findings:
            if (one.code, one.values.get("kind")) not in known:
                self.tell(Note("warning", one.text))

    def tidy(self) -> None:
        """Remove what a killed run has left unfinished."""
        count, total = sweep(self.output)
        if count:
            left = counted(count, "unfinished files")
            self.tell(Note("info", f"{left} of a killed run removed ({total / 1e6:.1f} MB)"))

    @property
    def failed(self) -> list[Receipt]:
        """Receipts of tasks that did not do their work."""
        return [failure.receipt for failure in self.failures]

    @property
    def idle(self) -> bool:
        """Whether everything was found finished so far."""
        return not any(cost.tasks for cost in self.costs.values())

    def repair(self, ledger: Ledger[Any, Any], found: Iterable[DamagedError] = ()) -> bool:
        """Begin again where files of the store are to be made again.

        ``found`` are damaged files that no task has met.
        """
        reasons = {error.path: error.told for error in found}
        again = self.repairs.begin(self.failed, ledger, reasons)
        if not again:
            self._tell_unmended()
            return False
        met = (r for r in self.failed if "damaged" in r.facts)
        reasons |= {r.facts["damaged"]: r.reason for r in met}
        said = f"made again: {named([*dict.fromkeys(reasons.values())], LISTED)}"
        self.tell(Note("info", said))
        self.costs.clear()
        self.failures.clear()
        return True

    def _tell_unmended(self) -> None:
        """Tell of failures that were to be mended, and now are not: nothing makes those files."""
        for one in self.failures:
            if self.repairs.may(one.receipt):
                called = plain_name(one.task, self.names)
                self.tell(Note("warning", f"failed: {called}: {one.receipt.reason}"))

    def altered(self, outputs: Sequence[str]) -> None:
        """Tell of outputs that are done again, as they are not as they were written."""
        self.tell(Note("info", f"gone or not as written, made again: {named(outputs, LISTED)}"))

    def mended(self) -> None:
        """Tell what was damaged and is sound again."""
        lost = {
            self.repairs.store.name_of(r.facts["damaged"])
            for r in self.failed
            if "damaged" in r.facts
        }
        if rebuilt := sorted(self.repairs.times.keys() - lost):
            self.tell(Note("info", f"damaged, rebuilt: {named(rebuilt, LISTED)}"))

    def ended(self, task: Task, receipt: Receipt) -> None:
        """Count a task in."""
        stage = self.stage(task.kind)
        self.costs.setdefault(stage, StageCost()).add(receipt)
        command = ""
        if receipt.failed:
            command = self.invocation.alone(task)
            self.failures.append(Failed(stage, task, receipt, command))
        self.tell(
            TaskEnded(
                stage,
                task.kind,
                task.name,
                task.points,
                receipt.wall_s,
                receipt.reason,
                receipt.peak_rss_mb,
                command,
                receipt.facts.get("traceback", ""),
                plain_name(task, self.names),
                receipt.failed and self.steps[task.kind].essential,
                self.repairs.may(receipt),
            )
        )

    def ready(self, scheduler: str, dashboard: str) -> None:
        """Tell of workers to run tasks on."""
        self.tell(WorkersReady(scheduler, dashboard))

    def started(self, task: Task, worker: str) -> None:
        """Tell of a task that a worker has begun."""
        called = plain_name(task, self.names)
        self.tell(TaskStarted(self.stage(task.kind), task.kind, task.name, worker, called))

    def seen(self, workers: WorkersSeen) -> None:
        """Tell how the workers are; the log hears of it now and then."""
        if time.monotonic() - self.logged_s >= LOG_WORKERS_S:
            self.logged_s = time.monotonic()
            self.tell(workers)
        else:
            self.listener(workers)

    def compiled(self, done: int, of: int) -> None:
        """Tell how many kernels are compiled; the log does without."""
        self.listener(Compiling(done, of))

    def noted(self, text: str) -> None:
        """Tell of something that has happened to a worker."""
        self.tell(Note("info", text))


def end_last_line(log: Path) -> None:
    """End the line that a killed run may have left half, so that the next one stands alone."""
    with suppress(FileNotFoundError), log.open("rb+") as stream:
        if stream.seek(0, os.SEEK_END):
            stream.seek(-1, os.SEEK_END)
            if stream.read(1) != b"\n":
                stream.write(b"\n")
