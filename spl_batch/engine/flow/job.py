"""A job, done here or on a worker, and what those who do and watch it agree on."""

import contextlib
import threading
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache
from itertools import chain
from pathlib import Path
from typing import Any, Final, Protocol

from spl_batch.engine.store.output_lock import lock_file
from spl_batch.engine.tasks.context import RunContext
from spl_batch.engine.tasks.runner import code_version, do
from spl_batch.engine.tasks.spare_memory import limit_memory
from spl_batch.engine.tasks.task import Job, Outcome, Task
from spl_batch.engine.watch.events import Event
from spl_batch.errors import StoppedError
from spl_batch.formats.files.atomic import owned_by
from spl_batch.receivers import steps


class Observer(Protocol):
    """Someone who is notified of what happens to tasks and workers."""

    def notify(self, event: Event) -> None:
        """Take in what has happened to the workers."""

    def started(self, task: Task, worker: str) -> None:
        """Take in that a worker has begun a task."""


@dataclass(slots=True)
class InProcess:
    """Does one job after the other, here; for debugging and for tests."""

    context: RunContext[Any]
    observer: Observer
    waiting: deque[Job] = field(default_factory=deque)

    @property
    def has_room(self) -> bool:
        """Whether it has nothing to do: what a job needs is finished before it is submitted."""
        return not self.waiting

    def batch_of(self, _count: int) -> int:
        """One at a time."""
        return 1

    def submit(self, jobs: Sequence[Job]) -> None:
        """Take jobs."""
        self.waiting.extend(jobs)

    def ended(self) -> Sequence[Outcome]:
        """Do the next job; there is no other worker that could try one again."""
        job = self.waiting.popleft()
        self.observer.started(job.task, "this process")
        return [do(job, self.context)]


REPORT_S: Final = 0.5
"""A worker reports at most once in so long at which task of a batch it is [s]."""


FAILED: Final = "failed"
"""What a try has come to that raised something: such a job gets another one in a run."""


def work(
    jobs: Sequence[Job], context: RunContext[Any], topic: str, *needed: Sequence[Outcome]
) -> list[Outcome]:
    """Do jobs on a worker, where what they waited for has come to its end."""
    from distributed import get_worker  # noqa: PLC0415

    worker = get_worker()
    fault = misfit(context)
    if fault:
        raise StoppedError(f"worker {worker.address} {fault}; mend it and run again")
    limit_memory(worker.memory_manager.memory_limit)
    _load_ahead(context.workflow.kind)
    known, outcomes, reported_s = [*chain.from_iterable(needed)], [], -REPORT_S
    for job in jobs:
        if time.monotonic() - reported_s >= REPORT_S:
            worker.log_event(topic, {"need": job.need, "worker": worker.address})
            reported_s = time.monotonic()
        with owned_by(str(lock_file(context.output)), context.mark):
            outcome = do(job, context, known)
        receipt = outcome.receipt
        # A damaged file is damaged for all; it is made again, which takes more than a try.
        final = FAILED in job.tried or receipt is None or "damaged" in receipt.facts
        if receipt and receipt.failed and not final:
            outcome = Outcome(job.need, None, again=(*job.tried, FAILED))
        outcomes.append(outcome)
    return outcomes


@cache
def _load_ahead(receiver: str) -> None:
    """Import what later steps call beside the first tasks, once in a process.

    In a small survey each task waits for the one before, and would wait for its modules as well.
    """

    def load() -> None:
        for step in steps(receiver).values():
            step.loaded()

    threading.Thread(target=load, name="load steps", daemon=True).start()


def misfit(context: RunContext[Any]) -> str:
    """Why this process cannot work for a run; empty where it can."""
    own = code_version(context.workflow.kind)
    if own != context.code:
        return (
            f"has spl_batch {own}, here it is {context.code} "
            "(the version, and a hash of code and libraries)"
        )
    return _unseen(lock_file(context.output), context.mark)


@cache
def _unseen(lock: Path, mark: str) -> str:
    """Why a run's mark cannot be seen here: a shared file system may take a while to show it."""
    for wait_s in (0.0, 0.2, 1.0, 4.0):
        time.sleep(wait_s)
        with contextlib.suppress(OSError):
            if lock.read_text(encoding="utf-8") == mark:
                return ""
    return f"does not see {lock} as it is here: all machines must share that path"
