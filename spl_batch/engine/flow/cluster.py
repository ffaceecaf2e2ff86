"""Workers on this machine, and whether workers that were started elsewhere can do the work."""

import contextlib
import logging
import signal
import threading
from collections.abc import Iterator, Mapping
from typing import Any, Final

from spl_batch.engine.flow.dask_flow import PATIENCE_S, lost, workers_of
from spl_batch.engine.flow.job import Footing, misfit
from spl_batch.errors import WorkflowError

KEPT_BYTES: Final = 1 << 40
"""Freed memory that a worker keeps for what it allocates next [byte]: all of it."""

WATCHING: Final[Mapping[str, Any]] = {
    # dask samples what each worker executes a hundred times a second, and measures event loops
    # fifty times: 4 % of a core for each process, on a machine whose cores all work.
    "distributed.worker.profile.enabled": False,
    "distributed.admin.tick.interval": "1s",
    "distributed.admin.system-monitor.interval": "1s",
    "distributed.worker.memory.monitor-interval": "200ms",
}
"""What dask watches of itself, and how often."""

SETTINGS: Final[Mapping[str, Any]] = {
    **WATCHING,
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
    # processor's time. So all that a worker allocates, Arrow's memory too, lies in one place, in
    # large pages where the system has them, and is used again.
    "distributed.nanny.pre-spawn-environ.MALLOC_TRIM_THRESHOLD_": KEPT_BYTES,
    "distributed.nanny.pre-spawn-environ.MALLOC_MMAP_MAX_": 0,
    "distributed.nanny.pre-spawn-environ.MALLOC_ARENA_MAX": 1,
    "distributed.nanny.pre-spawn-environ.GLIBC_TUNABLES": "glibc.malloc.hugetlb=1",
    "distributed.nanny.pre-spawn-environ.ARROW_DEFAULT_MEMORY_POOL": "system",
    "distributed.admin.log-format": "%(name)s - %(levelname)s - %(message)s",
    "logging.distributed": "critical",
}


def machine_memory() -> int:
    """Memory of this machine, or what its control group or user is allowed of it [byte]."""
    from distributed.system import memory_limit  # noqa: PLC0415 - slow import, only when used

    return int(memory_limit())


@contextlib.contextmanager
def local_cluster(workers: int, memory_bytes: int) -> Iterator[Any]:
    """Start worker processes on this machine, and end them."""
    from distributed import LocalCluster  # noqa: PLC0415

    with contextlib.ExitStack() as stack:
        with _deaf_children():
            cluster = stack.enter_context(
                LocalCluster(
                    n_workers=workers,
                    threads_per_worker=1,
                    processes=True,
                    memory_limit=memory_bytes,
                    dashboard_address="127.0.0.1:0",
                    silence_logs=logging.CRITICAL,
                )
            )
        yield cluster


@contextlib.contextmanager
def silent() -> Iterator[None]:
    """Keep dask's own complaints off the screen: a line tells what matters of them.

    It reads its settings for logging when it is imported, and has a logger for each part.
    """
    names = [name for name in logging.root.manager.loggerDict if name.startswith("distributed")]
    levels = {name: logging.getLogger(name).level for name in names}
    for name in names:
        logging.getLogger(name).setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        for name, level in levels.items():
            logging.getLogger(name).setLevel(level)


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


def check_workers(client: Any, footing: Footing, memory_bytes: int) -> None:
    """Refuse workers with other code, another file system or too little memory.

    Those that join later are checked by their first task.
    """
    try:
        found = workers_of(client)
        faults = client.run(misfit, footing, on_error="return")
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
