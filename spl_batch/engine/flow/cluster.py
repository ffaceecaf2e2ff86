"""Somewhere to run tasks: this process, workers on this machine, or those of a scheduler elsewhere.

dask is the scheduler, not the data structure: tasks are coarse, few are in flight, and messages
carry only names and small facts.
"""

import contextlib
import logging
import re
import signal
import threading
from collections.abc import Iterator, Mapping
from importlib.util import find_spec
from typing import Any, Final

from spl_batch.engine.flow.dask_flow import PATIENCE_S, OnDask, lost, workers_of
from spl_batch.engine.flow.job import InProcess, Observer, misfit
from spl_batch.engine.flow.warm_up import WarmUp
from spl_batch.engine.tasks.context import RunContext
from spl_batch.engine.watch.events import WorkersReady
from spl_batch.errors import StoppedError, WorkflowError

KEPT_BYTES: Final = 1 << 40
"""Freed memory that a worker keeps for what it allocates next [byte]: all of it."""

SETTINGS: Final[Mapping[str, Any]] = {
    # dask samples what each worker executes a hundred times a second, and measures event loops
    # fifty times: 4 % of a core for each process, on a machine whose cores all work.
    "distributed.worker.profile.enabled": False,
    "distributed.admin.tick.interval": "1s",
    "distributed.admin.system-monitor.interval": "1s",
    "distributed.worker.memory.monitor-interval": "200ms",
    # A worker that dies takes the blame for what waits on it, so the rest waits at the scheduler.
    # More of it would serve tasks of milliseconds; with tasks of a second this keeps workers busy
    # as well: `python -m benchmarks.scheduler cluster` prints both.
    "distributed.scheduler.worker-saturation": 1.1,
    # A task that has ended two workers is not given a third.
    "distributed.scheduler.allowed-failures": 1,
    # On a busy machine a worker takes a while to come back; it must not be given up.
    "distributed.deploy.lost-worker-timeout": f"{PATIENCE_S:.0f}s",
    "distributed.comm.timeouts.connect": "10s",
    "distributed.worker.daemon": True,
    # Data is in files. A worker has nothing to spill, and one that pauses would never go on.
    "distributed.worker.memory.target": False,
    "distributed.worker.memory.spill": False,
    "distributed.worker.memory.pause": False,
    "distributed.worker.memory.terminate": 0.95,
    # dask has workers give back each freed page at once. Tables of points come and go by the
    # hundred, arrays of a region by the dozen: page faults took a tenth to a sixth of the
    # processor's time. So all that a worker allocates, Arrow's memory too, lies in one heap, in
    # large pages where the system has them, and is used again.
    "distributed.nanny.pre-spawn-environ.MALLOC_TRIM_THRESHOLD_": KEPT_BYTES,
    "distributed.nanny.pre-spawn-environ.MALLOC_MMAP_MAX_": 0,
    "distributed.nanny.pre-spawn-environ.MALLOC_ARENA_MAX": 1,
    "distributed.nanny.pre-spawn-environ.GLIBC_TUNABLES": "glibc.malloc.hugetlb=1",
    "distributed.nanny.pre-spawn-environ.ARROW_DEFAULT_MEMORY_POOL": "system",
    "distributed.admin.log-format": "%(name)s - %(levelname)s - %(message)s",
    "logging.distributed": "critical",
}


Executor = InProcess | OnDask
"""Something that does jobs."""

_ADDRESS: Final = re.compile(r"((tcp|tls|ws|wss|ucx)://)?[^/\s]+:\d+")
"""What an address of a scheduler looks like."""


def machine_memory() -> int:
    """Memory of this machine, or what its control group or user is allowed of it [byte]."""
    from distributed.system import memory_limit  # noqa: PLC0415 - slow import, only when used

    return int(memory_limit())


def byte_count(text: str) -> int:
    """Bytes of a size such as ``4GiB``; ValueError or OverflowError where it is none."""
    from dask.utils import parse_bytes  # noqa: PLC0415 - slow import, only when used

    return int(parse_bytes(text))


def refuse_no_address(scheduler: str | None) -> None:
    """Refuse what no scheduler listens to, before anything is done: a run may need no workers."""
    if scheduler is not None and not _ADDRESS.fullmatch(scheduler):
        raise WorkflowError(f"--scheduler {scheduler}: write tcp://HOST:PORT or tls://HOST:PORT")


@contextlib.contextmanager
def executor(
    context: RunContext[Any],
    *,
    workers: int,
    memory_bytes: int,
    scheduler: str | None,
    observer: Observer,
    warm_up: WarmUp | None = None,
) -> Iterator[Executor]:
    """Give somewhere to run tasks; workers are started, or looked for, before the first of them.

    Then it raises WorkflowError if the workers cannot do the work: each has to find the code and
    the mark of ``context``, and a task may need ``memory_bytes``; StoppedError if the scheduler
    cannot be reached. Tasks wait for what a ``warm_up`` gets ready for their step.
    """
    if scheduler is None and workers == 0:
        yield InProcess(context, observer)
        return
    stack = contextlib.ExitStack()

    def connect() -> Any:
        import dask  # noqa: PLC0415 - slow import, only when used
        from distributed import Client  # noqa: PLC0415

        stack.enter_context(dask.config.set(SETTINGS))
        stack.enter_context(silent())
        address = scheduler or stack.enter_context(local_cluster(workers, memory_bytes))
        try:
            client = stack.enter_context(Client(address))
        except (OSError, TimeoutError, TypeError, ValueError) as error:  # TypeError: TLS, no keys
            raise StoppedError(
                f"--scheduler {scheduler}: no answer ({error}); is `dask scheduler` running there?"
            ) from error
        if scheduler is not None:
            check_workers(client, context, memory_bytes)
        dashboard = str(client.dashboard_link or "") if find_spec("bokeh") else ""
        observer.notify(WorkersReady(scheduler or "", dashboard))
        return client

    pool = OnDask(connect, context, observer, local=scheduler is None, warm_up=warm_up)
    try:
        yield pool
    finally:
        pool.close()
        with contextlib.suppress(TimeoutError):  # on a busy machine workers end with this process
            stack.close()


@contextlib.contextmanager
def local_cluster(workers: int, memory_bytes: int) -> Iterator[Any]:
    """Start worker processes on this machine, and end them."""
    from distributed import LocalCluster  # noqa: PLC0415

    with _deaf_children():
        cluster = LocalCluster(
            n_workers=workers,
            threads_per_worker=1,
            processes=True,
            memory_limit=memory_bytes,
            dashboard_address="127.0.0.1:0",
            silence_logs=logging.CRITICAL,
        )
    with cluster:
        yield cluster


@contextlib.contextmanager
def silent() -> Iterator[None]:
    """Keep dask's own complaints off the screen: a line reports what matters of them."""
    names = [name for name in logging.root.manager.loggerDict if name.startswith("distributed")]
    levels = [(logging.getLogger(name), logging.getLogger(name).level) for name in names]
    for logger, _ in levels:
        logger.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        for logger, level in levels:
            logger.setLevel(level)


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


def check_workers(client: Any, context: RunContext[Any], memory_bytes: int) -> None:
    """Refuse workers with other code, another file system or too little memory.

    Those that join later are checked by their first task.
    """
    try:
        found = workers_of(client)
        faults = client.run(misfit, context, on_error="return")
    except (OSError, TimeoutError) as error:
        raise lost(error) from error
    except Exception as error:
        raise WorkflowError(
            f"--scheduler: a worker cannot run this spl_batch ({type(error).__name__}: {error}); "
            "install the same version on all"
        ) from error
    for address, fault in sorted(faults.items()):
        if isinstance(fault, OSError | TimeoutError):
            continue  # it was lost while it was asked: as any worker that is lost
        if isinstance(fault, Exception):
            fault = f"cannot run this spl_batch ({type(fault).__name__}: {fault})"  # noqa: PLW2901
        if fault:
            raise WorkflowError(f"--scheduler: worker {address} {fault}")
    for address, facts in sorted(found.items()):
        share = facts["memory_limit"] / max(facts["nthreads"], 1)
        # As sizes are rounded on their way from one command line to another.
        if 0 < share < 0.99 * memory_bytes:
            raise WorkflowError(
                f"--scheduler: worker {address} has {share / 2**20:.0f} MiB for each of its "
                f"{facts['nthreads']} threads, less than --memory "
                f"{memory_bytes / 2**20:.0f} MiB; lower --memory, or start it with more"
            )
