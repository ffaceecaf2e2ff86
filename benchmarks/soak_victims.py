"""What a soak hurts: a survey on a disk of its own, its runs, a cluster of processes.

:mod:`benchmarks.soak` decides what happens when, and what must come of it.
"""

import contextlib
import os
import random
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from spl_batch.cli import main as command_line

SIZE_MB: Final = 96
"""Size of the file system in memory that is filled [MB]."""

ALPHAS: Final = (None, "filter.alpha=0.02")
LIMIT_S: Final = 240.0
"""A run that takes longer hangs [s]."""


DONE, FAILED, STOPPED = 0, 1, 3


class HurtError(Exception):
    """Something that must not happen has happened."""


@dataclass
class Survey:
    """A survey's folder, its state, and what runs of it have to give."""

    folder: Path
    dice: random.Random
    alpha: int = 0
    without: bool = False
    expected: dict[tuple[int, bool], dict[str, bytes]] = field(default_factory=dict)
    flipped: set[str] = field(default_factory=set)
    run_s: float = 2.0

    @property
    def output(self) -> Path:
        """Where its results lie."""
        return self.folder / "out"

    @property
    def arguments(self) -> list[str]:
        """The command of the present state."""
        setting = ALPHAS[self.alpha]
        return ["run", str(self.folder / "workflow.yaml"), *(("--set", setting) if setting else ())]

    def swap_setting(self) -> None:
        """Change a setting, or change it back."""
        self.alpha = 1 - self.alpha

    def swap_line(self) -> None:
        """Take a flightline away, or put it back."""
        line = max(self.folder.glob("flightlines/*.laz*"))
        line.rename(line.with_suffix("") if self.without else line.with_name(f"{line.name}.away"))
        self.without = not self.without

    def results(self) -> dict[str, bytes]:
        """Clouds and rasters by name."""
        files = [*self.output.glob("*.tif"), *(self.output / "laz").rglob("*.laz")]
        return {str(p.relative_to(self.output)): p.read_bytes() for p in sorted(files)}

    def files(self, place: str) -> list[Path]:
        """Files that may be damaged: of the store without its lock, or delivered ones."""
        below = self.output / "store" if place == "store" else self.output
        found = [p for p in below.rglob("*") if p.is_file() and p.name != "lock"]
        wanted = (".laz", ".tif", ".json", ".html")
        kept = [p for p in found if place == "store" or p.suffix in wanted]
        return sorted(p for p in kept if place == "store" or "store" not in p.parts)


@dataclass
class Child:
    """A forked process with a session of its own, and what it says."""

    pid: int
    said: Path
    status: int | None = None

    def poll(self) -> int | None:
        """Exit status, or the negative signal; None while it goes on."""
        if self.status is None:
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            if pid:
                self.status = os.waitstatus_to_exitcode(status)
        return self.status

    def wait(self, limit_s: float = LIMIT_S) -> int:
        """Exit status; one that hangs is killed."""
        until = time.monotonic() + limit_s
        while self.poll() is None:
            if time.monotonic() > until:
                self.kill()
                raise HurtError(f"hangs for {limit_s:.0f} s: {self.text()[-500:]}")
            time.sleep(0.02)
        return self.status if self.status is not None else FAILED

    def kill(self) -> None:
        """End it at once, and all of its session."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.pid, signal.SIGKILL)
        while self.poll() is None:
            time.sleep(0.01)

    def text(self) -> str:
        """What it has said."""
        return self.said.read_text(errors="replace")


def fork(function: Callable[[], object], said: Path) -> Child:
    """Call a function in a process of its own."""
    sys.stdout.flush()
    pid = os.fork()
    if pid:
        return Child(pid, said)
    status = 70
    try:
        os.setsid()
        stream = os.open(said, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        for number in (1, 2):
            os.dup2(stream, number)
        for sign in (signal.SIGINT, signal.SIGTERM):
            signal.signal(sign, signal.default_int_handler)
        function()
        status = 0
    except SystemExit as stop:
        status = int(stop.code or 0)
    except BaseException:  # noqa: BLE001 - said, then the process ends
        import traceback  # noqa: PLC0415

        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status)
    raise AssertionError("not reached")


def spl_batch(survey: Survey, *options: str) -> Child:
    """Start a run of the present state."""
    arguments = [*survey.arguments, *options]
    # Beside the survey: what it says must not be lost when that disk is full.
    return fork(lambda: command_line(arguments), survey.folder.parent / "said.txt")


class Cluster:
    """A dask scheduler and two workers, forked; started when asked for, and again when killed."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.scheduler: Child | None = None
        self.workers: list[Child] = []
        self.address = ""

    def ready(self) -> str:
        """Address of the scheduler, with two workers that are there or on their way."""
        if self.scheduler is None or self.scheduler.poll() is not None:
            self.close()
            with socket.socket() as probe:
                probe.bind(("127.0.0.1", 0))
                port = probe.getsockname()[1]
            self.address = f"tcp://127.0.0.1:{port}"
            options = ["--host", "127.0.0.1", "--port", str(port), "--no-dashboard"]
            self.scheduler = self._start("dask_scheduler", options, "scheduler")
        self.workers = [child for child in self.workers if child.poll() is None]
        while len(self.workers) < 2:
            place = self.folder / f"worker{time.monotonic_ns()}"
            place.mkdir()
            options = ["--no-nanny", "--nthreads", "1", "--memory-limit", "2GiB", "--no-dashboard"]
            options += ["--local-directory", str(place), "--host", "127.0.0.1", self.address]
            self.workers.append(self._start("dask_worker", options, place.name))
        return self.address

    def _start(self, command: str, options: list[str], name: str) -> Child:
        def serve() -> None:
            from importlib import import_module  # noqa: PLC0415

            import_module(f"distributed.cli.{command}").main(options, standalone_mode=False)

        return fork(serve, self.folder / f"{name}.txt")

    def close(self) -> None:
        """End all of it."""
        for child in (*self.workers, *([self.scheduler] if self.scheduler else [])):
            child.kill()
        self.workers, self.scheduler = [], None


def flip(path: Path) -> None:
    """Change one bit of a file, at a place that its size and content decide."""
    content = bytearray(path.read_bytes())
    if content:
        content[(len(content) * 7919) % len(content) // 2 + len(content) // 3] ^= 4
        with path.open("r+b") as stream:
            stream.write(content)


def cut(path: Path) -> None:
    """Take the end of a file away."""
    os.truncate(path, path.stat().st_size // 2)


@contextlib.contextmanager
def small_disk(folder: Path) -> Iterator[bool]:
    """Mount a small file system in memory; whether that was allowed."""
    folder.mkdir()
    mount, unmount = shutil.which("mount"), shutil.which("umount")
    command = [str(mount), "-t", "tmpfs", "-o", f"size={SIZE_MB}m", "tmpfs", str(folder)]
    able = mount and unmount
    if not able or subprocess.run(command, check=False, capture_output=True).returncode:  # noqa: S603
        yield False
        return
    try:
        yield True
    finally:
        subprocess.run([str(unmount), "-l", str(folder)], check=False)  # noqa: S603
