"""Tasks on dask: the only module that imports it.

dask is the scheduler, not the data structure: tasks are coarse, few are in flight at a
time, and nothing but names and small facts travels in a message.
"""

import contextlib
import signal
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any, Protocol

from spl_batch.errors import StoppedError
from spl_batch.model import Receipt, Task
from spl_batch.runner import failure, run_task
from spl_batch.runner.context import Context

IN_FLIGHT_PER_THREAD = 3
"""Tasks handed to the scheduler for each worker thread [count]."""

Job = tuple[Task, str]
"""A task and its key."""

OnReceipt = Callable[[Receipt], None]


class Executor(Protocol):
    """Something that does jobs."""

    def run(self, jobs: Iterable[Job], context: Context, on_receipt: OnReceipt) -> None:
        """Do jobs in any order and report each receipt as it comes."""


@dataclass(frozen=True, slots=True)
class InProcess:
    """Does one job after the other, here; for debugging and for tests."""

    def run(self, jobs: Iterable[Job], context: Context, on_receipt: OnReceipt) -> None:
        """Do jobs in order."""
        for task, key in jobs:
            on_receipt(run_task(task, key, context))


@dataclass(frozen=True, slots=True)
class OnDask:
    """Does jobs on the workers of a dask scheduler."""

    client: Any

    def run(self, jobs: Iterable[Job], context: Context, on_receipt: OnReceipt) -> None:
        """Do jobs as workers become free; a job that breaks its worker is tried once more.

        Raises
        ------
        StoppedError
            If the scheduler is lost or a task met something that concerns everything.
        """
        from distributed import as_completed  # noqa: PLC0415 - slow import, only when used

        left, retries = iter(jobs), deque[Job]()
        running: dict[Any, Job] = {}
        again: set[str] = set()
        pool = as_completed(with_results=False)
        limit = IN_FLIGHT_PER_THREAD * max(self._threads(), 1)
        try:
            while True:
                while len(running) < limit and (job := next(left, None) or _pop(retries)):
                    self._submit(job, context, running, pool)
                if not running:
                    return
                future = next(pool)
                task, key = running.pop(future)
                receipt = self._receipt(future, task, key)
                if task.name not in again and _worth_retrying(receipt):
                    again.add(task.name)
                    retries.append((task, key))
                    continue
                on_receipt(receipt)
        finally:
            for future in running:
                with contextlib.suppress(Exception):
                    future.cancel()

    def _submit(self, job: Job, context: Context, running: dict[Any, Job], pool: Any) -> None:
        try:
            future = self.client.submit(run_task, *job, context, pure=False)
        except Exception as error:
            raise StoppedError(f"the scheduler is lost ({error}); run again to continue") from error
        running[future] = job
        pool.add(future)

    def _threads(self) -> int:
        return sum(self.client.nthreads().values())

    def _receipt(self, future: Any, task: Task, key: str) -> Receipt:
        from distributed.client import FutureCancelledError  # noqa: PLC0415
        from distributed.scheduler import KilledWorker  # noqa: PLC0415

        try:
            receipt: Receipt = future.result()
        except StoppedError:
            raise
        except KilledWorker:
            return failure(task, key, "LostWorker: its worker died, by memory or a signal")
        except (FutureCancelledError, OSError, TimeoutError) as error:
            raise StoppedError(f"the scheduler is lost ({error}); run again to continue") from error
        return receipt


def _pop(retries: deque[Job]) -> Job | None:
    return retries.popleft() if retries else None


def _worth_retrying(receipt: Receipt) -> bool:
    """Whether another try can help: not where the input itself is at fault."""
    kind, _, _ = receipt.reason.partition(":")
    return receipt.failed and kind.isidentifier()


@contextlib.contextmanager
def executor(
    *, workers: int, memory_bytes: int, scheduler: str | None
) -> Iterator[tuple[Executor, str]]:
    """Give somewhere to run tasks.

    Parameters
    ----------
    workers : int
        Worker processes of a local cluster; 0 works in this process.
    memory_bytes : int
        Memory limit of each local worker [byte].
    scheduler : str or None
        Address of a running scheduler, which is used instead.

    Yields
    ------
    executor : Executor
        Where to run tasks.
    dashboard : str
        Link to dask's dashboard; empty where there is none.

    Raises
    ------
    StoppedError
        If the scheduler cannot be reached.
    """
    if scheduler is None and workers == 0:
        yield InProcess(), ""
        return
    import dask  # noqa: PLC0415 - slow import, only when used
    from distributed import Client, LocalCluster  # noqa: PLC0415

    settings = {
        "distributed.scheduler.worker-saturation": 1.1,
        "distributed.comm.timeouts.connect": "10s",
        "distributed.worker.daemon": True,
        "distributed.admin.log-format": "%(name)s - %(levelname)s - %(message)s",
        "logging.distributed": "error",
    }
    with contextlib.ExitStack() as stack:
        stack.enter_context(dask.config.set(settings))
        address: Any = scheduler
        if scheduler is None:
            with _deaf_children():
                address = stack.enter_context(
                    LocalCluster(
                        n_workers=workers,
                        threads_per_worker=1,
                        processes=True,
                        memory_limit=memory_bytes,
                        dashboard_address=":0",
                        silence_logs=40,
                    )
                )
        try:
            client = stack.enter_context(Client(address, timeout="10s"))
        except (OSError, TimeoutError, ValueError) as error:
            raise StoppedError(
                f"--scheduler {scheduler}: no answer ({error}); is `dask scheduler` running there?"
            ) from error
        yield OnDask(client), str(client.dashboard_link or "") if scheduler else ""


@contextlib.contextmanager
def _deaf_children() -> Iterator[None]:
    """Start processes that leave Ctrl-C to this one, which then ends them in order."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
