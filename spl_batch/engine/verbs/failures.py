"""What did not make it: what it needed, what to do, and how to see it fail alone."""

import shlex
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from spl_batch.engine.findings import table
from spl_batch.engine.report.parts import Failure
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
    ledger, receiver = prepared.ledger, prepared.receiver
    for bad in ledger.inputs.bad:
        yield Failure(
            code="F01",
            stage="index",
            place=bad.path,
            reason="; ".join(bad.faults),
            remedy=table()["F01"].remedy,
            inputs=(bad.path,),
        )
    names = {str(s.key): s.name for s in ledger.inputs.sources}
    for one in failed:
        task = one.task
        edge_m = receiver.edge_m(task.kind, ledger)
        yield Failure(
            code=one.receipt.facts.get("code", "F04"),
            stage=one.stage,
            place=names.get(task.name) or str(task.args.get("path", task.name)),
            reason=one.receipt.reason,
            remedy=_remedy(one, receiver.remedies),
            task=f"{task.kind} {task.name}",
            extent_m=extent_m(task.name, edge_m) if edge_m else None,
            inputs=tuple(inputs(task, names, receiver.words)),
            command=one.command,
        )


def extent_m(name: str, edge_m: float) -> tuple[float, float, float, float]:
    """West, east, south and north edges of a unit of squares with an edge of ``edge_m`` [m].

    Units are named by the column and row of their first square, and by how many squares lie along
    their sides where these are several: ``"-3_12"``, ``"-4_12_2_3"``.
    """
    numbers = [*name.split("_"), "1", "1"][:4]
    west, south, wide, high = (int(number) * edge_m for number in numbers)
    return (west, west + wide, south, south + high)


def inputs(task: Task, names: Mapping[str, str], words: Mapping[str, str]) -> list[str]:
    """Files, tiles and stretches that a task reads, in the words of a user.

    Parameters
    ----------
    task : Task
        The task.
    names : mapping of str to str
        Names of the input files by key.
    words : mapping of str to str
        What a user calls the result of a kind of task.
    """
    found = [names[str(task.args["source"])]] if task.args.get("source") in names else []
    found += [str(path) for path in task.args.get("paths", ())]
    if task.kind == "reference":
        found.append(str(task.args["path"]))
    for kind, name in task.needs:
        word = words.get(kind)
        if word == "file":
            found.append(names.get(name, name))
        elif word is not None:
            found.append(f"{word} {name}")
    return list(dict.fromkeys(found))


def plain_name(task: Task, names: Mapping[str, str]) -> str:
    """What a user calls a task: its kind, and the input file instead of the file's key.

    Parameters
    ----------
    task : Task
        The task.
    names : mapping of str to str
        Names of the input files by key.
    """
    parts = [task.kind.replace("_", " ")]
    if task.name != "all":
        known = names.get(str(task.args.get("source"))) or names.get(task.name)
        read = Path(str(task.args["path"])).name if "path" in task.args else ""
        parts.append(known or read or task.name)
    if task.kind.endswith("_part") and "part" in task.args:
        parts.append(str(task.args["part"]))
    return " ".join(parts)


def _remedy(one: Failed, remedies: Mapping[str, str]) -> str:
    """What its code advises, with what makes its kind of task lighter where memory was short."""
    code = one.receipt.facts.get("code", "F04")
    lighter = remedies.get(one.task.kind) if code == "F02" else None
    remedy = table()[code].remedy
    return f"{lighter}, or {remedy}" if lighter else remedy
