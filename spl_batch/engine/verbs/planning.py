"""What is settled before work starts, and what a run will do: settings, inputs, limits, cost.

All of it from headers alone: points, tasks, disk, memory, time.
"""

import shutil
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from spl_batch.engine.findings import Finding
from spl_batch.engine.flow.cluster import byte_count, machine_memory
from spl_batch.engine.plan.budget import Cost, refuse_too_large
from spl_batch.engine.report.parts import FindingReport
from spl_batch.engine.report.reported import reported
from spl_batch.engine.settings.workflow_file import load_any
from spl_batch.engine.tasks.runner import code_version
from spl_batch.engine.verbs.output_owner import usable
from spl_batch.engine.verbs.receiver import Prepared, Receiver
from spl_batch.errors import WorkflowError, grouped, merged_faults, refuse_without, storage
from spl_batch.formats.files.atomic import names_in, real_path
from spl_batch.receivers import receiver

REMOTE_BYTES: Final = 4 * 2**30
"""Memory limit of a worker of a running scheduler by default [byte]."""

MACHINE_SHARE: Final = 0.8
"""Part of this machine's memory that its workers share by default: what else runs there and the
files that the system keeps in memory have the rest."""

MOST_BYTES: Final = 16 * 2**30
"""Highest default of the memory limit of a worker of this machine: cells hardly read less with more
[byte]."""

STEP_BYTES: Final = 2**28
"""The smallest limit, and what the default is a multiple of [byte]."""


@dataclass(frozen=True, slots=True)
class PlanSummary:
    """What a run will do."""

    #: Usable input files, and points that their headers promise [count].
    files: int
    points: int
    cost: Any  #: Tasks, disk, memory and time: a Cost, as the receiver extends it.
    limit_bytes: int  #: Memory limit of a worker [byte].
    shared: bool  #: Whether that is the workers' share of this machine, as none was given.
    rows: tuple[tuple[str, str], ...]  #: Label and value of what the receiver adds.
    faults: tuple[str, ...]  #: What is wrong with the inputs and the output.
    findings: tuple[FindingReport, ...]  #: What to warn of.
    finished: int = 0  #: Tasks that earlier runs have finished, whatever has changed since [count].
    unusable: int = 0  #: Input files that cannot be used; ``faults`` has the reasons [count].

    @property
    def exit_status(self) -> int:
        """What the command ends with: 1 where a run would leave files out."""
        return int(bool(self.faults))


def plan(
    workflow: Path | str,
    *,
    workers: int = 2,
    memory: str | int | None = None,
    overrides: Sequence[str] = (),
) -> PlanSummary:
    """Estimate what a run would do, and name what is wrong with all inputs at once.

    Parameters
    ----------
    workflow, workers, memory, overrides : optional
        As :func:`~spl_batch.engine.verbs.running.run` takes them.

    Raises
    ------
    WorkflowError
        If the workflow is wrong, no input is usable, or the output cannot be used.
    PlanError
        If a task cannot fit into the memory limit.
    MissingPackageError
        If a package is missing that a report needs.
    """
    prepared = prepare(Path(workflow), overrides, memory=memory, workers=workers)
    refuse_without("matplotlib", "reports", "report")
    cost, inputs = fitting_cost(prepared), prepared.ledger.inputs
    deliveries = usable(prepared)
    look = prepared.receiver.first_look(prepared)
    store = prepared.context.store
    folders = (store.path("receipts", kind) for kind in prepared.steps)
    finished = sum(len(names_in(folder, ".json")) for folder in folders)
    findings = (
        *prepared.ledger.remarks,
        *inputs.warnings,
        *deliveries.gone_inputs(),
        *_too_full(prepared.context.output, 0 if finished or store.url else cost.disk_bytes),
    )
    units, ignored = prepared.context.shown_units, prepared.context.workflow.report.ignore
    return PlanSummary(
        len(inputs.sources) - look.unreadable,
        cost.points - look.unreadable_points,
        cost,
        prepared.ledger.memory_bytes,
        prepared.ledger.shared,
        tuple(prepared.receiver.plan_rows(prepared, cost)),
        (*merged_faults(inputs.bad), *look.faults, *look.late),
        reported(findings, ignored, notes=True, units=units),
        finished,
        len(inputs.bad) + look.unreadable,
    )


def fitting_cost(prepared: Prepared[Any, Any]) -> Cost:
    """Cost of a run; PlanError, which names the heaviest task, where that does not fit a worker."""
    cost = prepared.receiver.cost(prepared)
    refuse_too_large(cost, prepared.ledger.memory_bytes, shared=prepared.ledger.shared)
    return cost


def _too_full(output: Path, needed: int) -> Iterator[Finding]:
    """A note where the file system of the output has less room than is expected to be taken."""
    there = next(path for path in (output, *output.parents) if path.exists())
    free = shutil.disk_usage(there).free
    if needed > free:
        yield Finding("E01", {"kind": "disk", "needed": storage(needed), "free": storage(free)})


def prepare(
    path: Path,
    overrides: Sequence[str],
    *,
    memory: str | int | None = None,
    workers: int = 2,
    remote: bool = False,
) -> Prepared[Any, Any]:
    """Read the workflow and the headers of its files, as :func:`~.running.run` is given them.

    ``remote``: whether workers are those of a running scheduler. WorkflowError if the workflow or
    a limit is wrong, or no input is usable.
    """
    limit = limit_bytes(memory, workers, remote=remote)
    workflow = load_any(path, overrides)
    base = real_path(path).parent
    if "://" in workflow.output:
        raise WorkflowError(
            f"output: {workflow.output} is a URL: write a folder of this machine; "
            "outputs.store may lie on an object store"
        )
    output = real_path(base / workflow.output)
    found: Receiver[Any, Any] = receiver(workflow.kind)
    inputs = found.gather(workflow, base, output)
    crs = getattr(inputs, "crs", None)
    crs_wkt = crs.to_wkt() if crs is not None else ""
    context = found.context(workflow, base, output, crs_wkt, code_version(workflow.kind))
    ledger = found.ledger(inputs, workflow, limit, max(workers, 1))
    ledger.shared = memory is None and not remote
    total, there = max(workers, 1) * limit, machine_memory()
    if memory is not None and not remote and total > there:
        text = (
            f"--memory: the workers may take {grouped(total / 2**30, 1)} GiB together, this "
            f"machine has {grouped(there / 2**30, 1)} GiB; lower --memory or --workers"
        )
        ledger.remarks = (Finding("E01", {"kind": "memory", "what": text}),)
    if not inputs.sources:
        raise WorkflowError("no input is usable: " + "; ".join(merged_faults(inputs.bad)))
    context.store.root  # noqa: B018 - a store that cannot be used is a fault found here
    return Prepared(found, ledger, context)


def limit_bytes(memory: str | int | None, workers: int, *, remote: bool = False) -> int:
    """Memory limit of each worker [byte]: what is given for it, or a share of this machine's."""
    if workers < 0:
        raise WorkflowError(f"--workers {workers}: write 0 (in this process) or more")
    if memory is not None:
        return parse_bytes(memory)
    if remote:
        return REMOTE_BYTES
    share = int(MACHINE_SHARE * machine_memory() / max(workers, 1))
    return min(max(share // STEP_BYTES, 1) * STEP_BYTES, MOST_BYTES)


def parse_bytes(text: str | int) -> int:
    """Size such as ``4GiB`` or ``2000000000`` [byte]; WorkflowError below 256 MiB."""
    try:
        size = byte_count(str(text))
    except (ValueError, OverflowError):
        raise WorkflowError(f"--memory {text}: write a size such as 4GiB") from None
    if size < STEP_BYTES:
        raise WorkflowError(
            f"--memory {text}: that is {grouped(size)} bytes, a worker needs 256 MiB at least; "
            "write a size such as 4GiB"
        )
    return size
