"""Tasks on dask: the only storey that imports it.

dask is the scheduler, not the data structure: tasks are coarse, few are in flight at a
time, and nothing but names and small facts travels in a message.
"""

import contextlib
from collections.abc import Iterator
from importlib.util import find_spec
from typing import Any

from spl_batch.errors import StoppedError
from spl_batch.graph.ahead import Ahead
from spl_batch.graph.cluster import SETTINGS, check_workers, local_cluster, silent
from spl_batch.graph.flow import OUT_OF_MEMORY, OnDask
from spl_batch.graph.work import Executor, Footing, InProcess, Job, Observer

__all__ = [
    "OUT_OF_MEMORY",
    "Ahead",
    "Executor",
    "Footing",
    "InProcess",
    "Job",
    "Observer",
    "OnDask",
    "executor",
]


@contextlib.contextmanager
def executor(
    *,
    workers: int,
    memory_bytes: int,
    scheduler: str | None,
    observer: Observer,
    footing: Footing,
    ahead: Ahead | None = None,
) -> Iterator[tuple[Executor, str]]:
    """Give somewhere to run tasks.

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
    footing : Footing
        What every worker has to find.
    ahead : Ahead, optional
        What local workers do before their first task.

    Yields
    ------
    executor : Executor
        Where to run tasks.
    dashboard : str
        Link to dask's dashboard; empty where there is none.

    Raises
    ------
    WorkflowError
        If the workers that are there cannot do the work.
    StoppedError
        If the scheduler cannot be reached.
    """
    if scheduler is None and workers == 0:
        yield InProcess(observer), ""
        return
    import dask  # noqa: PLC0415 - slow import, only when used
    from distributed import Client  # noqa: PLC0415

    with _closing_calmly(observer) as stack:
        stack.enter_context(dask.config.set(SETTINGS))
        stack.enter_context(silent())
        address: Any = scheduler
        if scheduler is None:
            address = stack.enter_context(local_cluster(workers, memory_bytes))
        try:
            client = stack.enter_context(Client(address))
        except (OSError, TimeoutError, ValueError) as error:
            raise StoppedError(
                f"--scheduler {scheduler}: no answer ({error}); is `dask scheduler` running there?"
            ) from error
        if scheduler is not None:
            check_workers(client, footing, memory_bytes)
        shown = scheduler is not None or find_spec("bokeh") is not None
        dashboard = str(client.dashboard_link or "") if shown else ""
        yield OnDask(client, observer, footing, scheduler is None, ahead), dashboard


@contextlib.contextmanager
def _closing_calmly(observer: Observer) -> Iterator[contextlib.ExitStack]:
    """Close cluster and client, and go on where a busy machine does not let them end in time.

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
