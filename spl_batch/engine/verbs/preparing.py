"""Everything that is settled before work starts: settings, inputs, limits."""

import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

from spl_batch.engine.findings import Finding
from spl_batch.engine.flow.cluster import machine_memory
from spl_batch.engine.settings.workflow_file import load_any
from spl_batch.engine.verbs.receiver import Limits, Place, Prepared, Receiver
from spl_batch.errors import WorkflowError, grouped, told_together
from spl_batch.formats.files.atomic import real_path
from spl_batch.receivers import receiver

REMOTE_BYTES: Final = 4 * 2**30
"""Memory limit of a worker of a running scheduler unless told otherwise [byte]."""

MACHINE_SHARE: Final = 0.8
"""Part of this machine's memory that its workers share unless told otherwise."""

MOST_BYTES: Final = 16 * 2**30
"""Memory limit that a worker of this machine is not given more than, unless told otherwise
[byte]: blocks hardly read less with more."""

STEP_BYTES: Final = 2**28
"""What such a limit is a multiple of [byte]."""

_UNITS = {"": 1, "k": 10**3, "m": 10**6, "g": 10**9, "t": 10**12}
_BINARY = {"k": 2**10, "m": 2**20, "g": 2**30, "t": 2**40}


def prepare(
    path: Path,
    overrides: Sequence[str],
    *,
    memory: str | int | None = None,
    workers: int = 2,
    remote: bool = False,
) -> Prepared[Any, Any]:
    """Read the workflow and the headers of its files.

    Parameters
    ----------
    path : Path
        Workflow file.
    overrides : sequence of str
        ``key.path=value``.
    memory : str or int, optional
        Memory limit of a worker [byte]; :func:`usual_bytes` unless told.
    workers : int
        Worker processes [count].
    remote : bool
        Whether they are those of a running scheduler.

    Raises
    ------
    WorkflowError
        If the workflow or a limit is wrong, or no input is usable.
    """
    limit = limit_bytes(memory, workers, remote=remote)
    workflow = load_any(path, overrides)
    base = real_path(path).parent
    if "://" in workflow.output:
        raise WorkflowError(
            f"output: {workflow.output} is a URL: write a folder of this machine; "
            "outputs.store may lie on an object store"
        )
    place = Place(path, base, real_path(base / workflow.output))
    found: Receiver[Any, Any] = receiver(workflow.kind)
    prepared = found.prepare(workflow, place, Limits(limit, max(workers, 1)))
    prepared.ledger.shared = memory is None and not remote
    if memory is not None and not remote:
        prepared.ledger.remarks = (*_more_than_there_is(limit, max(workers, 1)),)
    inputs = prepared.ledger.inputs
    if not inputs.sources:
        raise WorkflowError("no input is usable: " + "; ".join(told_together(inputs.bad)))
    prepared.context.store.root  # noqa: B018 - a store that cannot be used is a fault found here
    return prepared


def limit_bytes(memory: str | int | None, workers: int, *, remote: bool = False) -> int:
    """Memory limit of each worker, from what is told of it [byte].

    The arguments are those of :func:`prepare`, and so is the error for a wrong one.
    """
    if workers < 0:
        raise WorkflowError(f"--workers {workers}: write 0 (in this process) or more")
    if memory is not None:
        return parse_bytes(memory)
    return REMOTE_BYTES if remote else usual_bytes(workers)


def _more_than_there_is(limit: int, workers: int) -> Iterator[Finding]:
    """A remark where workers of this machine may take more memory than it has."""
    there = machine_memory()
    if workers * limit > there:
        total, have = (grouped(size / 2**30, 1) for size in (workers * limit, there))
        text = (
            f"--memory: {grouped(workers)} worker{'s' if workers > 1 else ''} may take {total} GiB "
            f"together, this machine has {have} GiB and ends what asks for more; lower --memory "
            "or --workers"
        )
        yield Finding("E01", {"kind": "memory", "what": text})


def usual_bytes(workers: int) -> int:
    """Memory limit of each of some workers of this machine, unless told otherwise [byte].

    They share :data:`MACHINE_SHARE` of it: what else runs there and the files that the system keeps
    in memory have the rest.
    """
    share = int(MACHINE_SHARE * machine_memory() / max(workers, 1))
    return min(max(share // STEP_BYTES, 1) * STEP_BYTES, MOST_BYTES)


def parse_bytes(text: str | int) -> int:
    """Size such as ``4GiB``, ``500 MB`` or ``2000000000`` [byte].

    Raises
    ------
    WorkflowError
        If it is no size, or less than 256 MiB.
    """
    pattern = r"\s*(\d+(?:\.\d+)?)\s*(?:([kmgt])(i?)b?|b?)\s*"
    match = re.fullmatch(pattern, str(text).lower())
    if match is None:
        raise WorkflowError(f"--memory {text}: write a size such as 4GiB")
    number, prefix, binary = match.groups()
    size = int(float(number) * (_BINARY if binary else _UNITS)[prefix or ""])
    if size < 2**28:
        meant = "" if prefix else f"; write {number}{'GiB' if float(number) < 256 else 'MiB'}"
        raise WorkflowError(
            f"--memory {text}: that is {grouped(size)} bytes, a worker needs 256 MiB at least"
            f"{meant}"
        )
    return size
