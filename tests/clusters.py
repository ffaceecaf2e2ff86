"""dask clusters for tests, of processes that the ordinary commands start; and faults in them."""

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tests import faulty_worker

ROOT = Path(__file__).parents[1]
DASK = Path(sys.executable).with_name("dask")
MEMORY = "1GiB"
"""Limit of a worker's thread."""


class Plan:
    """What is to go wrong on workers, and what they were given to do."""

    def __init__(self, folder: Path) -> None:
        folder.mkdir(exist_ok=True)
        self.folder = folder
        self.path = folder / "plan.json"
        self.set()

    def set(self, *faults: Mapping[str, Any]) -> None:
        """Replace what is to go wrong; nothing without arguments."""
        for path in self.folder.glob("fault_*"):
            path.unlink()
        (self.folder / "tries.jsonl").write_text("")
        self.path.write_text(json.dumps(faults))

    def tries(self, kind: str) -> list[tuple[str, int]]:
        """Name and process of each try of a kind of task, in order."""
        lines = (self.folder / "tries.jsonl").read_text().splitlines()
        found = [json.loads(line) for line in lines]
        return [(t["name"], t["pid"]) for t in found if t["kind"] == kind]


def fault(kind: str, what: str, name: str | None = None, times: int | None = None) -> Any:
    """A fault; ``times`` counts all workers together, None is always."""
    return {"kind": kind, "name": name, "what": what, "times": times}


@dataclass
class Cluster:
    """A scheduler and its workers, each a process group with a start directory of its own."""

    folder: Path
    plan: Plan
    processes: list[subprocess.Popen[bytes]] = field(default_factory=list)

    @property
    def address(self) -> str:
        """Of the scheduler."""
        content = json.loads((self.folder / "scheduler.json").read_text())
        return str(content["address"])

    def start_scheduler(self) -> None:
        """Start a scheduler and wait for its address."""
        self._start("scheduler", "scheduler", "--host", "127.0.0.1", "--port", "0")
        until = time.monotonic() + 240
        while not (self.folder / "scheduler.json").exists():
            assert time.monotonic() < until, "the scheduler does not start"
            time.sleep(0.05)

    def start_worker(self, name: str, *, threads: int = 1, memory: str = MEMORY) -> None:
        """Start a worker with its nanny."""
        self._start(
            name,
            *("worker", "--nworkers", "1", "--nthreads", str(threads), "--memory-limit", memory),
            *("--name", name, "--preload", str(Path(faulty_worker.__file__))),
            *("--local-directory", str(self.folder / name)),
        )

    def wait_for(self, name: str) -> None:
        """Wait until the scheduler knows a worker."""
        until = time.monotonic() + 240
        while "Registered to" not in (self.folder / name / "said.txt").read_text():
            assert time.monotonic() < until, f"{name} does not start"
            time.sleep(0.05)

    def _start(self, name: str, command: str, *options: str) -> None:
        folder = self.folder / name
        folder.mkdir()
        environment = {
            **{k: v for k, v in os.environ.items() if not k.startswith(("LC_", "LANG"))},
            "PYTHONPATH": str(ROOT),
            faulty_worker.VARIABLE: str(self.plan.path),
            # A bare C locale: text files must not be read by the locale.
            "LC_ALL": "C",
            "PYTHONUTF8": "0",
            "PYTHONCOERCECLOCALE": "0",
            "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES": "1",
        }
        line = [str(DASK), command, "--scheduler-file", str(self.folder / "scheduler.json")]
        with (folder / "said.txt").open("wb") as output:
            process = subprocess.Popen(  # noqa: S603
                [*line, "--no-dashboard", *options],
                cwd=folder,
                env=environment,
                stdout=output,
                stderr=output,
                start_new_session=True,
            )
        self.processes.append(process)

    def kill(self, number: int) -> None:
        """End a process and its children at once."""
        process = self.processes[number]
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()


@contextmanager
def cluster(folder: Path, *threads: int) -> Iterator[Cluster]:
    """A scheduler, and a worker for each number of threads."""
    started = Cluster(folder, Plan(folder))
    try:
        started.start_scheduler()
        for number, count in enumerate(threads):
            started.start_worker(f"worker {number}", threads=count, memory=f"{count}GiB")
        for number in range(len(threads)):
            started.wait_for(f"worker {number}")
        yield started
    finally:
        for number in range(len(started.processes)):
            started.kill(number)


def wait_until(condition: Callable[[], object]) -> None:
    """Wait for something to be so, two minutes at most."""
    until = time.monotonic() + 120
    while not condition() and time.monotonic() < until:
        time.sleep(0.02)


def when(condition: Callable[[], object], then: Callable[[], object]) -> threading.Thread:
    """Do something in another thread as soon as a condition holds."""

    def wait() -> None:
        wait_until(condition)
        then()

    thread = threading.Thread(target=wait)
    thread.start()
    return thread
