"""Tasks on dask: the only storey that imports it.

dask is the scheduler, not the data structure: tasks are coarse, few are in flight, and messages
carry only names and small facts.
"""

import contextlib
import re
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from typing import Any, Final

from spl_batch.engine.flow.cluster import (
    SETTINGS,
    check_workers,
    local_cluster,
    machine_memory,
    silent,
)
from spl_batch.engine.flow.dask_flow import OnDask
from spl_batch.engine.flow.job import Executor, Footing, InProcess, Observer
from spl_batch.engine.flow.warm_up import Ahead, Work
from spl_batch.engine.tasks.context import RunContext
from spl_batch.engine.tasks.task import Job, Outcome
from spl_batch.errors import StoppedError, WorkflowError

__all__ = [
    "Ahead",
    "Executor",
    "Footing",
    "InProcess",
    "Job",
    "Observer",
    "OnDask",
    "Work",
    "executor",
    "machine_memory",
    "refuse_no_address",
]


_ADDRESS: Final = re.compile(r"((tcp|tls|ws|wss|ucx)://)?[^/\s]+:\d+")
"""What an address of a scheduler looks like."""


def refuse_no_address(scheduler: str | None) -> None:
    """Refuse what no scheduler listens to, before anything is done: a run may need no workers."""
    if scheduler is not None and not _ADDRESS.fullmatch(scheduler):
        raise WorkflowError(f"--scheduler {scheduler}: write tcp://HOST:PORT or tls://HOST:PORT")


@contextlib.contextmanager
def executor(
    *,
    workers: int,
    memory_bytes: int,
    scheduler: str | None,
    observer: Observer,
    footing: Footing,
    ahead: Ahead | None = None,
) -> Iterator[Executor]:
    """Give somewhere to run tasks; workers are started, or looked for, before the first of them.

    Parameters
    ----------
    workers : int
        Worker processes of a local cluster; 0 works in this process.
    memory_bytes : int
        Memory limit of each local worker, or what a task may need of others' workers [byte].
    scheduler : str or None
        Address of a running scheduler, which is used instead.
    observer : Observer
        Told what happens to tasks and workers.
    ahead : Ahead, optional
        What local workers do before their first task.

    Yields
    ------
    Executor
        Where to run tasks; before the first one it raises what follows.

    Raises
    ------
    WorkflowError
        If the workers that are there cannot do the work.
    StoppedError
        If the scheduler cannot be reached.
    """
    if scheduler is None and workers == 0:
        yield InProcess(observer)
        return
    with _closing_calmly(observer) as stack:

        def begin() -> Executor:
            client, dashboard = _client(stack, footing, workers, memory_bytes, scheduler)
            observer.ready(scheduler or "", dashboard)
            return OnDask(client, observer, footing, local=scheduler is None, ahead=ahead)

        pool = _WhenNeeded(begin)
        try:
            yield pool
        finally:
            pool.close()


class _WhenNeeded:
    """An executor that is begun before its first job: a run may find all its tasks finished."""

    def __init__(self, begin: Callable[[], Executor]) -> None:
        self._begin = begin
        self._begun: Executor | None = None

    @property
    def window(self) -> int:
        """Jobs that it holds at once [count]."""
        return 1 if self._begun is None else self._begun.window

    def submit(self, job: Job, context: RunContext[Any]) -> None:
        """Take a job; begin with the first."""
        if self._begun is None:
            self._begun = self._begin()
        self._begun.submit(job, context)

    def ended(self) -> Outcome:
        """Wait for the next job to end."""
        assert self._begun is not None, "nothing was submitted"  # noqa: S101 - for the type alone
        return self._begun.ended()

    def close(self) -> None:
        """Let go of jobs that are still on their way."""
        if self._begun is not None:
            self._begun.close()


def _client(
    stack: contextlib.ExitStack,
    footing: Footing,
    workers: int,
    memory_bytes: int,
    scheduler: str | None,
) -> tuple[Any, str]:
    """Client of a scheduler, and the link to its dashboard or ""; ended by a stack."""
    import dask  # noqa: PLC0415 - slow import, only when used
    from distributed import Client  # noqa: PLC0415

    stack.enter_context(dask.config.set(SETTINGS))
    stack.enter_context(silent())
    address: Any = scheduler
    if scheduler is None:
        address = stack.enter_context(local_cluster(workers, memory_bytes))
    try:
        client = stack.enter_context(Client(address))
    except (OSError, TimeoutError, TypeError, ValueError) as error:  # TypeError: TLS without keys
        raise StoppedError(
            f"--scheduler {scheduler}: no answer ({error}); is `dask scheduler` running there?"
        ) from error
    if scheduler is not None:
        check_workers(client, footing, memory_bytes)
    return client, _dashboard(client)


def _dashboard(client: Any) -> str:
    """Link to a scheduler's dashboard; "" where the page would only say that it needs bokeh."""
    link = str(client.dashboard_link or "")
    try:
        drawn = link and client.run_on_scheduler(find_spec, "bokeh")
    except ValueError:  # of a scheduler that is set to run no functions
        drawn = None
    return link if drawn else ""


@contextlib.contextmanager
def _closing_calmly(observer: Observer) -> Iterator[contextlib.ExitStack]:
    """Close cluster and client, and go on where a busy machine does not end them in time.

    All tasks are done by then; what is left of the workers ends with this process.
    """
    done = False
    try:
        with contextlib.ExitStack() as stack:
            yield stack
            done = True
    except TimeoutError:
        if not done:
            raise
        observer.noted("the workers did not end in time; they end with this process")
