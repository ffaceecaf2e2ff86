"""What did not make it: what it needed, and what to do."""

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from spl_batch.engine.findings import table
from spl_batch.engine.report.parts import Failure
from spl_batch.engine.tasks.step import Steps
from spl_batch.engine.tasks.task import Receipt, Task
from spl_batch.engine.verbs.receiver import Prepared


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
