"""Costs, findings and failures of one run as they come in; events are passed on and logged."""

import os
import threading
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path, PurePosixPath
from typing import Any, Final

from spl_batch.engine.findings import Finding, settled
from spl_batch.engine.report.parts import FindingReport
from spl_batch.engine.report.reported import reported
from spl_batch.engine.report.run_record import StageCost
from spl_batch.engine.store.deliveries import Deliveries
from spl_batch.engine.store.working_store import (
    Store,
    append_log,
    forget_receipt,
    read_receipts,
)
from spl_batch.engine.tasks.ledger import Ledger
from spl_batch.engine.tasks.step import Steps
from spl_batch.engine.tasks.task import Need, Receipt, Task, WorkersSeen
from spl_batch.engine.verbs.failures import Failed, Invocation, plain_name
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
"""How often the log has how the workers are [s]."""

TRIES: Final = 3
"""Times that a run makes a damaged file again: a disk that fails for good fails each time."""

METADATA: Final = "zarr.json"
"""File that describes arrays: a run makes it before the tasks that fill them."""


@dataclass
class Progress:
    """State of a run, and those who listen to it."""

    listener: Listener
    invocation: Invocation  #: How the run was started.
    store: Store
    deliveries: Deliveries  #: What this run and those before it have written into the output.
    steps: Steps  #: What the receiver does.
    names: Mapping[str, str] = field(default_factory=dict)  #: Names of the input files by key.
    ignored: tuple[str, ...] = ()  #: Codes that the report is silent about.
    costs: dict[str, StageCost] = field(default_factory=dict)
    failures: list[Failed] = field(default_factory=list)
    findings: list[Finding] = field(default_factory=list)
    #: How often damaged files were made again, by what receipts call them [count].
    repaired: Counter[str] = field(default_factory=Counter)
    logged_s: float = -1e9
    lock: threading.RLock = field(default_factory=threading.RLock)

    def __post_init__(self) -> None:
        end_last_line(self.store.output / "log.jsonl")

    def tell(self, event: Event) -> None:
        """Pass an event on, to the log as well."""
        with self.lock:  # workers report their beginnings in another thread
            append_log(self.store.output, as_record(event))
            self.listener(event)

    def note(self, text: str, level: str = "info") -> None:
        """Pass on something that a user should read."""
        self.tell(Note(level, text))

    def warn(self, findings: Iterable[Finding]) -> None:
        """Report what was found, alike ones together, once."""
        new = settled(findings, self.ignored, self.findings)
        self.findings += new
        for one in reported(new, notes=True):
            self.note(one.text, "info" if one.severity == "note" else one.severity)

    def late(self, findings: Iterable[FindingReport]) -> None:
        """Report what only the whole survey shows; the rest was reported as it was found."""
        known = {(one.code, one.values.get("kind")) for one in self.findings}
        for one in findings:
            if (one.code, one.values.get("kind")) not in known:
                self.note(one.text, "warning")

    def tidy(self) -> None:
        """Remove what a killed run has left unfinished."""
        count, total = sweep(self.store.output)
        if count:
            left = counted(count, "unfinished files")
            self.note(f"{left} of a killed run removed ({total / 1e6:.1f} MB)")

    @property
    def failed(self) -> list[Receipt]:
        """Receipts of tasks that did not do their work."""
        return [failure.receipt for failure in self.failures]

    def mends(self, receipt: Receipt) -> bool:
        """Whether a task failed over a damaged file that may still be made again."""
        damaged = receipt.facts.get("damaged")
        if damaged is None:
            return False
        name = PurePosixPath(self.store.name_of(damaged))
        return all(self.repaired[str(part)] < TRIES for part in (name, *name.parents))

    def can_mend(self, receipt: Receipt) -> bool:
        """Whether a task failed over a damaged file that some task makes again."""
        if not self.mends(receipt):
            return False
        name = self.store.name_of(receipt.facts["damaged"])
        return bool(makers(self.store, self.steps, [name]))

    def repair(self, ledger: Ledger[Any, Any], found: Iterable[DamagedError] = ()) -> bool:
        """Begin again where damaged files can be made again; whether there are any.

        ``found`` are damaged files that no task has met.
        """
        reasons = {error.path: error.told for error in found}
        reasons |= {r.facts["damaged"]: r.reason for r in self.failed if "damaged" in r.facts}
        again = makers(self.store, self.steps, map(self.store.name_of, reasons))
        again = {name: need for name, need in again.items() if self.repaired[name] < TRIES}
        if not again:
            for one in (one for one in self.failures if self.mends(one.receipt)):
                self.note(f"failed: {plain_name(one.task, self.names)}: {one.receipt.reason}")
            return False
        for name, need in again.items():
            self.repaired[name] += 1
            if need is not None:
                forget_receipt(self.store, *need)
        ledger.done.clear()
        for name, member in vars(type(ledger)).items():
            if isinstance(member, cached_property):
                ledger.__dict__.pop(name, None)
        self.note(f"made again: {named([*reasons.values()], LISTED)}")
        self.costs.clear()
        self.failures.clear()
        return True

    def mended(self) -> None:
        """Report what was damaged and is sound again."""
        lost = {self.store.name_of(r.facts["damaged"]) for r in self.failed if "damaged" in r.facts}
        if rebuilt := sorted(self.repaired.keys() - lost):
            self.note(f"damaged, rebuilt: {named(rebuilt, LISTED)}")

    def ended(self, task: Task, receipt: Receipt) -> None:
        """Count a task in."""
        step, command = self.steps[task.kind], ""
        self.costs.setdefault(step.stage, StageCost()).add(receipt)
        if receipt.failed:
            command = self.invocation.alone(task)
            self.failures.append(Failed(step.stage, task, receipt, command))
        self.tell(
            TaskEnded(
                step.stage,
                task.kind,
                task.name,
                task.points,
                receipt.wall_s,
                receipt.reason,
                receipt.peak_rss_mb,
                command,
                receipt.facts.get("traceback", ""),
                plain_name(task, self.names),
                receipt.failed and step.essential,
                self.mends(receipt),
            )
        )

    def ready(self, scheduler: str, dashboard: str) -> None:
        """Report workers to run tasks on."""
        self.tell(WorkersReady(scheduler, dashboard))

    def started(self, task: Task, worker: str) -> None:
        """Report a task that a worker has begun."""
        called = plain_name(task, self.names)
        self.tell(TaskStarted(self.steps[task.kind].stage, task.kind, task.name, worker, called))

    def seen(self, workers: WorkersSeen) -> None:
        """Report how the workers are; the log has it now and then."""
        if time.monotonic() - self.logged_s >= LOG_WORKERS_S:
            self.logged_s = time.monotonic()
            self.tell(workers)
        else:
            self.listener(workers)

    def compiled(self, done: int, of: int) -> None:
        """Report how many kernels are compiled; the log does without."""
        self.listener(Compiling(done, of))

    def noted(self, text: str) -> None:
        """Report something that has happened to a worker."""
        self.note(text)


def makers(store: Store, kinds: Iterable[str], damaged: Iterable[str]) -> dict[str, Need | None]:
    """Damaged files, as receipts call them, with the task that makes each; None for metadata."""
    names = [*damaged]
    # A chunk is part of an output that is a directory.
    parts = {part for name in names for part in (name, *map(str, PurePosixPath(name).parents))}
    found: dict[str, Need | None] = {n: None for n in names if n.endswith(f"/{METADATA}")}
    found |= {name: need for name, need in _made(store, kinds if parts else ()) if name in parts}
    return dict(sorted(found.items()))


def forget_makers(store: Store, kinds: Iterable[str], damaged: Iterable[str]) -> bool:
    """Have damaged files made again by the next run; whether it will."""
    found = [need for need in makers(store, kinds, damaged).values() if need is not None]
    for need in found:
        forget_receipt(store, *need)
    return bool(found)


def _made(store: Store, kinds: Iterable[str]) -> Iterator[tuple[str, Need]]:
    """Outputs of all receipts, and who made them."""
    for kind in kinds:
        for receipt in read_receipts(store, kind):
            yield from ((name, (receipt.kind, receipt.name)) for name in receipt.outputs)


def end_last_line(log: Path) -> None:
    """End the line that a killed run may have left half, so that the next one stands alone."""
    with suppress(FileNotFoundError), log.open("rb+") as stream:
        if stream.seek(0, os.SEEK_END):
            stream.seek(-1, os.SEEK_END)
            if stream.read(1) != b"\n":
                stream.write(b"\n")
