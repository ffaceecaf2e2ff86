"""What dask does for itself while tasks run.

Run ``python -m benchmarks.engine.idle_cluster [SECONDS]``.

Two local workers sleep in a task each. Prints the share of a core that a worker's process and the
one that hands out the tasks take meanwhile, with dask's own settings for what it watches, and with
ours (:data:`spl_batch.engine.flow.cluster.SETTINGS`). What they take, two workers on two cores
lack.
"""

import argparse
import time

import dask
from distributed import Client

from spl_batch.engine.flow.cluster import SETTINGS, WATCHING, local_cluster

START_S = 3.0
"""Time that workers are given to start [s]."""


def sleep(seconds: float) -> float:
    """Sleep as a task; processor time of the process meanwhile [s]."""
    before = time.process_time()
    time.sleep(seconds)
    return time.process_time() - before


def shares(settings: dict[str, object], seconds: float) -> tuple[float, float]:
    """Share of a core that a worker and the scheduler's process take."""
    with dask.config.set(settings), local_cluster(2, 2 << 30) as cluster, Client(cluster) as client:
        time.sleep(START_S)
        before = time.process_time()
        tasks = [client.submit(sleep, seconds, pure=False) for _ in range(2)]
        workers = client.gather(tasks)
        return sum(workers) / 2 / seconds, (time.process_time() - before) / seconds


def main(seconds: float) -> None:
    """Print the table."""
    theirs = {key: value for key, value in SETTINGS.items() if key not in WATCHING}
    print(f"{'':8s}{'worker %':>10s}{'scheduler %':>13s}")
    for name, settings in (("dask's", theirs), ("ours", dict(SETTINGS))):
        worker, scheduler = shares(settings, seconds)
        print(f"{name:8s}{100 * worker:10.1f}{100 * scheduler:13.1f}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("seconds", nargs="?", type=float, default=10.0)
    main(parser.parse_args().seconds)
