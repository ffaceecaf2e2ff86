"""Everything that is settled before work starts: settings, inputs, limits."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from spl_batch.engine.findings import Finding
from spl_batch.engine.flow.cluster import byte_count, machine_memory
from spl_batch.engine.settings.workflow_file import load_any
from spl_batch.engine.tasks.runner import code_version
from spl_batch.engine.verbs.receiver import Prepared, Receiver
from spl_batch.errors import WorkflowError, grouped, told_together
from spl_batch.formats.files.atomic import real_path
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
        raise WorkflowError("no input is usable: " + "; ".join(told_together(inputs.bad)))
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
