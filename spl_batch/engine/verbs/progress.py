"""Costs, findings and failures of one run as they come in; events are passed on and logged.

What did not make it is named with what it needed, and damaged files of the store are made again.
"""

import os
import threading
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property, partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final

from spl_batch.engine.findings import Finding, settled, table
from spl_batch.engine.report.parts import Failure, FindingReport
from spl_batch.engine.report.reported import reported
from spl_batch.engine.report.run_record import StageCost
from spl_batch.engine.store.working_store import (
    Store,
    append_log,
    forget_receipt,
    read_receipts,
)
from spl_batch.engine.tasks.ledger import Ledger
from spl_batch.engine.tasks.step import Step, Steps
from spl_batch.engine.tasks.task import Need, Receipt, Task
from spl_batch.engine.verbs.output_owner import Deliveries
from spl_batch.engine.verbs.receiver import Prepared
from spl_batch.engine.watch.events import (
    Compiling,
    Event,
    Listener,
    Note,
    TaskEnded,
    TaskStarted,
    WorkersReady,
    WorkersSeen,
    as_record,
)
from spl_batch.errors import DamagedError, counted, named
from spl_batch.formats.files.atomic import sweep
from spl_batch.receivers import summariser

LOG_WORKERS_S: Final = 10.0
"""How often the log has how the workers are [s]."""

TRIES: Final = 3
"""Times that a run makes a damaged file again: a disk that fails for good fails each time."""


@dataclass
class Progress:
    """State of a run, and those who listen to it."""

    prepared: Prepared[Any, Any]
    workers: int
    deliveries: Deliveries  #: What this run and those before it have written into the output.
    listener: Listener
    reports: bool = True  #: Whether the run writes a report.
    costs: dict[str, StageCost] = field(default_factory=dict)
    failures: list[tuple[Task, Receipt]] = field(default_factory=list)
    findings: list[Finding] = field(default_factory=list)
    #: Damaged files that tasks have met, and what is wrong with each.
    damaged: dict[str, str] = field(default_factory=dict)
    gave_up: bool = False  #: Whether none of them could be made again.
    #: How often damaged files were made again, by what receipts call them [count].
    repaired: dict[str, int] = field(default_factory=dict)
    logged_s: float = -1e9
    lock: threading.RLock = field(default_factory=threading.RLock)

    def __post_init__(self) -> None:
        sources = self.prepared.ledger.inputs.sources
        self.names = {str(source.key): source.name for source in sources}
        end_last_line(self.prepared.context.output / "log.jsonl")

    def notify(self, event: Event) -> None:
        """Pass an event on, to the log as well."""
        with self.lock:  # workers report their beginnings in another thread
            if isinstance(event, WorkersReady) and self.reports and find_spec("matplotlib"):
                # What draws a report takes seconds to import; while workers are busy, none.
                load = partial(summariser, self.prepared.context.workflow.kind)
                threading.Thread(target=load, name="load report", daemon=True).start()
            logged = not isinstance(event, Compiling)
            if isinstance(event, WorkersSeen):
                logged = time.monotonic() - self.logged_s >= LOG_WORKERS_S
                self.logged_s = time.monotonic() if logged else self.logged_s
            if logged:
                append_log(self.prepared.context.output, as_record(event))
            self.listener(event)

    def note(self, text: str, level: str = "info") -> None:
        """Pass on something that a user should read."""
        self.notify(Note(level, text))

    def warn(self, findings: Iterable[Finding]) -> None:
        """Report what was found, alike ones together, once."""
        ignored = self.prepared.context.workflow.report.ignore
        new = settled(findings, ignored, self.findings)
        self.findings += new
        units = self.prepared.context.shown_units
        for one in reported(new, notes=True, units=units):
            self.note(one.text, "info" if one.severity == "note" else one.severity)

    def late(self, findings: Iterable[FindingReport]) -> None:
        """Report what only the whole survey shows; the rest was reported as it was found."""
        known = {(one.code, one.values.get("kind")) for one in self.findings}
        for one in findings:
            if (one.code, one.values.get("kind")) not in known:
                self.note(one.text, "warning")

    def tidy(self) -> None:
        """Remove what a killed run has left unfinished."""
        count, total = sweep(self.prepared.context.output)
        if count:
            left = counted(count, "unfinished files")
            self.note(f"{left} of a killed run removed ({total / 1e6:.1f} MB)")

    def withdraw(self, steps: Iterable[Step]) -> None:
        """Delete what earlier runs delivered and this one does not vouch for, if it delivers."""
        if not any(step.delivers for step in steps):
            return
        for text in self.deliveries.withdraw(failed=bool(self.failures)):
            self.note(text)
        if self.deliveries.spared:
            self.warn([Finding("E02", {"files": self.deliveries.spared})])

    @property
    def begins_again(self) -> bool:
        """Whether the rest waits until damaged files are made again."""
        return bool(self.damaged) and not self.gave_up

    def repair(self, found: Iterable[DamagedError] = ()) -> bool:
        """Begin again where files are damaged, those that can be made again first; whether so.

        Where none can, the rest is done all the same, once. ``found`` are damaged files that no
        task has met.
        """
        store = self.prepared.context.store
        reasons = self.damaged | {error.path: error.fault for error in found}
        names = map(store.name_of, reasons)
        again = forget_makers(store, self.prepared.steps, names, self.repaired)
        if not again and not self.begins_again:
            return False
        self.gave_up = not again
        how, level = ("made again", "info") if again else ("damaged for good", "error")
        self.note(f"{how}: {named([*reasons.values()])}", level)
        forget_finished(self.prepared.ledger)
        for kept in (self.damaged, self.costs, self.failures):
            kept.clear()
        return True

    def found(self, stage: str, receipt: Receipt) -> None:
        """Take note of a task that was finished before."""
        self.deliveries.wrote(receipt)
        self.costs.setdefault(stage, StageCost()).skip(receipt)

    def ended(self, task: Task, receipt: Receipt) -> None:
        """Count a task in."""
        stage = self.prepared.steps[task.kind].stage
        self.deliveries.wrote(receipt)
        self.costs.setdefault(stage, StageCost()).add(receipt)
        if receipt.failed:
            self.failures.append((task, receipt))
        if "damaged" in receipt.facts:
            self.damaged[receipt.facts["damaged"]] = receipt.reason
        self.notify(
            TaskEnded(
                stage,
                task.kind,
                task.name,
                task.points,
                receipt.wall_s,
                receipt.reason,
                receipt.peak_rss_mb,
                plain_name(task, self.names),
                receipt.facts.get("code", "F04") if receipt.failed else "",
                receipt.facts.get("traceback", "") if receipt.failed else "",
            )
        )

    def started(self, task: Task, worker: str) -> None:
        """Report a task that a worker has begun."""
        stage, called = self.prepared.steps[task.kind].stage, plain_name(task, self.names)
        self.notify(TaskStarted(stage, task.kind, task.name, worker, called))


def end_last_line(log: Path) -> None:
    """End the line that a killed run may have left half, so that the next one is whole."""
    with suppress(FileNotFoundError), log.open("rb+") as stream:
        if stream.seek(0, os.SEEK_END):
            stream.seek(-1, os.SEEK_END)
            if stream.read(1) != b"\n":
                stream.write(b"\n")


def failures(
    prepared: Prepared[Any, Any], failed: Iterable[tuple[Task, Receipt]]
) -> Iterator[Failure]:
    """What did not make it, inputs first."""
    ledger, first = prepared.ledger, next(iter(prepared.steps.values()))
    for bad in ledger.inputs.bad:
        yield Failure(
            code="F01",
            stage=first.stage,
            place=bad.path,
            reason="; ".join(bad.faults),
            remedy=table()["F01"].remedy,
            inputs=(bad.path,),
        )
    names = {str(s.key): s.name for s in ledger.inputs.sources}
    for task, receipt in failed:
        step, code = prepared.steps[task.kind], receipt.facts.get("code", "F04")
        lighter = f"{step.remedy}, or " if code == "F02" and step.remedy else ""
        yield Failure(
            code=code,
            stage=step.stage,
            place=names.get(task.name) or str(task.args.get("path", task.name)),
            reason=receipt.reason,
            remedy=f"{lighter}{table()[code].remedy}",
            task=f"{task.kind} {task.name}",
            inputs=tuple(inputs(task, names, prepared.steps)),
        )


def inputs(task: Task, names: Mapping[str, str], steps: Steps) -> list[str]:
    """Files and units of earlier steps that a task reads; ``names``: of input files, by key."""
    found = [names[str(task.args["source"])]] if task.args.get("source") in names else []
    found += [str(path) for path in task.args.get("paths", ())]
    if "path" in task.args and not found:
        found.append(str(task.args["path"]))
    for kind, name in task.needs:
        word = steps[kind].unit
        if name in names or word:
            found.append(names.get(name) or f"{word} {name}")
    return list(dict.fromkeys(found))


def plain_name(task: Task, names: Mapping[str, str]) -> str:
    """What a user calls a task; ``names``: names of the input files by key."""
    parts = [task.kind.replace("_", " ")]
    if task.name != "all":
        known = names.get(str(task.args.get("source"))) or names.get(task.name)
        read = Path(str(task.args["path"])).name if "path" in task.args else ""
        parts.append(known or read or task.name)
    if "part" in task.args:
        parts.append(str(task.args["part"]))
    return " ".join(parts)


def makers(store: Store, kinds: Iterable[str], damaged: Iterable[str]) -> dict[str, Need]:
    """Damaged files, as receipts call them, with the task that makes each."""
    found: dict[str, Need] = {}
    files = set(damaged)
    for kind in kinds if files else ():
        for receipt in read_receipts(store, kind):
            made = files & receipt.outputs.keys()
            found.update(dict.fromkeys(made, (receipt.kind, receipt.name)))
    return dict(sorted(found.items()))


def forget_makers(
    store: Store, kinds: Iterable[str], damaged: Iterable[str], known: dict[str, int]
) -> list[str]:
    """Have damaged files made again by the next look at the tasks; those that can be.

    ``known``: how often this was done, by their names [count]; it is counted on.
    """
    found = makers(store, kinds, damaged)
    again = {name: need for name, need in found.items() if known.get(name, 0) < TRIES}
    for name, need in again.items():
        known[name] = known.get(name, 0) + 1
        forget_receipt(store, *need)
    return [*again]


def forget_finished(ledger: Ledger[Any, Any]) -> None:
    """Forget what is finished, and what was derived of it."""
    ledger.done.clear()
    for name, member in vars(type(ledger)).items():
        if isinstance(member, cached_property):
            ledger.__dict__.pop(name, None)
