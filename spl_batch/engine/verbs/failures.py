"""What did not make it: what it needed, what to do, and how to see it fail alone."""

import shlex
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from spl_batch.engine.findings import table
from spl_batch.engine.report.parts import Failure
from spl_batch.engine.tasks.step import Step, Steps
from spl_batch.engine.tasks.task import Receipt, Task
from spl_batch.engine.verbs.receiver import Prepared


@dataclass(frozen=True, slots=True)
class Invocation:
    """The command line that a run was, or would have been, started by."""

    workflow: Path | str  #: Workflow file, as it was given.
    workers: int  #: Worker processes, by which work was cut.
    memory_bytes: int  #: Memory limit, by which work was cut [byte].
    overrides: Sequence[str] = ()  #: ``key.path=value``.

    def alone(self, task: Task) -> str:
        """Command that does one task of this run, in the process that it starts."""
        parts = ["spl-batch", "run", str(self.workflow), "--workers", str(self.workers)]
        parts += ["--memory", _size(self.memory_bytes)]
        for override in self.overrides:
            parts += ["--set", override]
        return shlex.join([*parts, "--only", f"{task.kind} {task.name}"])


def _size(count: int) -> str:
    """Bytes as ``--memory`` takes them, exactly, in the largest unit that fits."""
    for unit, name in ((2**30, "GiB"), (2**20, "MiB")):
        if count % unit == 0:
            return f"{count // unit}{name}"
    return str(count)


@dataclass(frozen=True, slots=True)
class Failed:
    """A task that failed."""

    stage: str  #: Stage of the command line.
    task: Task  #: The task.
    receipt: Receipt  #: With the reason.
    command: str  #: Command that does it alone.


def failures(prepared: Prepared[Any, Any], failed: Iterable[Failed]) -> Iterator[Failure]:
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
    for one in failed:
        task, step = one.task, prepared.steps[one.task.kind]
        yield Failure(
            code=one.receipt.facts.get("code", "F04"),
            stage=one.stage,
            place=names.get(task.name) or str(task.args.get("path", task.name)),
            reason=one.receipt.reason,
            remedy=_remedy(one, step),
            task=f"{task.kind} {task.name}",
            inputs=tuple(inputs(task, names, prepared.steps)),
            command=one.command,
        )


def inputs(task: Task, names: Mapping[str, str], steps: Steps) -> list[str]:
    """Files and units of earlier steps that a task reads; ``names``: of input files, by key."""
    found = [names[str(task.args["source"])]] if task.args.get("source") in names else []
    found += [str(path) for path in task.args.get("paths", ())]
    if "path" in task.args and not found:
        found.append(str(task.args["path"]))
    for kind, name in task.needs:
        word = steps[kind].unit
        if name in names:
            found.append(names[name])
        elif word:
            found.append(f"{word} {name}")
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


def _remedy(one: Failed, step: Step) -> str:
    """What its code advises, with what makes its kind of task lighter where memory was short."""
    code = one.receipt.facts.get("code", "F04")
    lighter = step.remedy if code == "F02" else ""
    remedy = table()[code].remedy
    return f"{lighter}, or {remedy}" if lighter else remedy
