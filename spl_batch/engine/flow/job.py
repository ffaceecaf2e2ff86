"""A job, done here or on a worker, and what those who do and watch it agree on."""

import contextlib
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache
from itertools import chain
from pathlib import Path
from typing import Any, Final, Protocol

from spl_batch.engine.store.working_store import read_receipt
from spl_batch.engine.tasks.context import RunContext
from spl_batch.engine.tasks.runner import code_version, do
from spl_batch.engine.tasks.spare_memory import limit_memory
from spl_batch.engine.tasks.task import Job, Outcome, Task
from spl_batch.engine.watch.events import Event
from spl_batch.errors import StoppedError
from spl_batch.formats.files.atomic import owned_by


class Observer(Protocol):
    """Someone who is notified of what happens to tasks and workers."""

    def tell(self, event: Event) -> None:
        """Take in what has happened to the workers."""

    def started(self, task: Task, worker: str) -> None:
        """Take in that a worker has begun a task."""


@dataclass(frozen=True, slots=True)
class Handshake:
    """What every worker has to find: this code, and this run's mark on the shared path."""

    receiver: str
    code: str  #: Version of the code that this receiver's tasks run.
    mark: str
    content: str


@dataclass(slots=True)
class InProcess:
    """Does one job after the other, here; for debugging and for tests."""

    observer: Observer
    waiting: deque[tuple[Job, RunContext[Any]]] = field(default_factory=deque)

    @property
    def has_room(self) -> bool:
        """Whether it has nothing to do: what a job needs is finished before it is submitted."""
        return not self.waiting

    def batch_of(self, _count: int) -> int:
        """One at a time."""
        return 1

    def submit(self, jobs: Sequence[Job], context: RunContext[Any]) -> None:
        """Take jobs."""
        self.waiting.extend((job, context) for job in jobs)

    def ended(self) -> Sequence[Outcome]:
        """Do the next job; there is no other worker that could try one again."""
        job, context = self.waiting.popleft()
        self.observer.started(job.task, "this process")
        return [do(job, context)]


REPORT_S: Final = 0.5
"""A worker reports at most once in so long at which task of a batch it is [s]."""


class TryAgainError(Exception):
    """A task has failed for the first time in a run: its scheduler gives it another try."""


def work(
    jobs: Sequence[Job],
    context: RunContext[Any],
    handshake: Handshake,
    topic: str,
    *needed: Sequence[Outcome],
) -> list[Outcome]:
    """Do jobs on a worker, where what they waited for has come to its end.

    One of several that fails for the first time in this run is to be done again by itself.

    Raises
    ------
    TryAgainError
        If a single one does.
    """
    from distributed import get_worker  # noqa: PLC0415

    worker = get_worker()
    fault = misfit(handshake)
    if fault:
        raise StoppedError(f"worker {worker.address} {fault}; mend it and run again")
    limit_memory(worker.memory_manager.memory_limit)
    known, outcomes, reported_s = [*chain.from_iterable(needed)], [], -REPORT_S
    for job in jobs:
        if time.monotonic() - reported_s >= REPORT_S:
            worker.log_event(topic, {"need": job.need, "worker": worker.address})
            reported_s = time.monotonic()
        before = read_receipt(context.store, *job.need)
        with owned_by(handshake.mark, handshake.content):
            outcome = do(job, context, known, handshake.content)
        receipt = outcome.receipt
        # A damaged file is damaged for all; it is made again, which takes more than a try.
        if receipt and receipt.failed and "damaged" not in receipt.facts:
            tried = before is not None and before.facts.get("run") == handshake.content
            if not tried and len(jobs) == 1:
                raise TryAgainError(receipt.reason)
            outcome = outcome if tried else Outcome(job.need, None, again=True)
        outcomes.append(outcome)
    return outcomes


@cache
def misfit(handshake: Handshake) -> str:
    """Why this process cannot work for a run; empty where it can."""
    code = code_version(handshake.receiver)
    if code != handshake.code:
        return (
            f"has spl_batch {code}, here it is {handshake.code} "
            "(the version, and a hash of code and libraries)"
        )
    # A shared file system may take a while to show a new file everywhere.
    for wait_s in (0.0, 0.2, 1.0, 4.0):
        time.sleep(wait_s)
        with contextlib.suppress(OSError):
            if Path(handshake.mark).read_text(encoding="utf-8") == handshake.content:
                return ""
    return f"does not see {handshake.mark} as it is here: all machines must share that path"
