"""One job, done here or on a worker, and what those who do and watch it agree on."""

import contextlib
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Protocol

from spl_batch.engine.tasks.context import RunContext
from spl_batch.engine.tasks.runner import code_version, run_task
from spl_batch.engine.tasks.spare_memory import limit_memory
from spl_batch.engine.tasks.task import Receipt, Task, WorkersSeen
from spl_batch.errors import StoppedError
from spl_batch.formats.files.atomic import owned_by

Job = tuple[Task, str]
"""A task and its key."""

OnReceipt = Callable[[Receipt], None]


class Observer(Protocol):
    """Someone who is told what happens to tasks and workers."""

    def ready(self, scheduler: str, dashboard: str) -> None:
        """Tell of workers: a scheduler elsewhere or "", the link to a dashboard or ""."""

    def started(self, task: Task, worker: str) -> None:
        """Tell of a task that a worker has begun."""

    def seen(self, workers: WorkersSeen) -> None:
        """Tell how the workers are."""

    def noted(self, text: str) -> None:
        """Tell of something that has happened to a worker."""

    def compiled(self, done: int, of: int) -> None:
        """Tell how many kernels of how many are compiled [count]."""


class Executor(Protocol):
    """Something that does jobs."""

    def make_ready(self) -> None:
        """Do what comes before the first job, if it is not done."""

    def run(self, jobs: Iterable[Job], context: RunContext[Any], on_receipt: OnReceipt) -> None:
        """Do jobs in any order and report each receipt as it comes."""


@dataclass(frozen=True, slots=True)
class Footing:
    """What every worker has to find: this code, and this run's mark on the shared path."""

    receiver: str
    code: str  #: Version of the code that this receiver's tasks run.
    mark: str
    content: str


@dataclass(frozen=True, slots=True)
class InProcess:
    """Does one job after the other, here; for debugging and for tests."""

    observer: Observer

    def make_ready(self) -> None:
        """Do nothing: what a task needs is compiled when it is called."""

    def run(self, jobs: Iterable[Job], context: RunContext[Any], on_receipt: OnReceipt) -> None:
        """Do jobs in order; there is no other worker that could try one again."""
        for task, key in jobs:
            self.observer.started(task, "this process")
            on_receipt(run_task(task, key, context))


def work(
    task: Task, key: str, context: RunContext[Any], footing: Footing, topic: str
) -> tuple[str, Receipt]:
    """Do a task on a worker; its address and the receipt."""
    from distributed import get_worker  # noqa: PLC0415

    worker = get_worker()
    fault = misfit(footing)
    if fault:
        raise StoppedError(f"worker {worker.address} {fault}; mend it and run again")
    limit_memory(worker.memory_manager.memory_limit)
    worker.log_event(topic, {"kind": task.kind, "name": task.name, "worker": worker.address})
    with owned_by(footing.mark, footing.content):
        return worker.address, run_task(task, key, context)


@cache
def misfit(footing: Footing) -> str:
    """Why this process cannot work for a run; empty where it can."""
    code = code_version(footing.receiver)
    if code != footing.code:
        return (
            f"has spl_batch {code}, here it is {footing.code} "
            "(the version, and a hash of code and libraries)"
        )
    # A shared file system may take a while to show a new file everywhere.
    for wait_s in (0.0, 0.2, 1.0, 4.0):
        time.sleep(wait_s)
        with contextlib.suppress(OSError):
            if Path(footing.mark).read_text(encoding="utf-8") == footing.content:
                return ""
    return f"does not see {footing.mark} as it is here: all machines must share that path"
