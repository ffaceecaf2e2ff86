"""Preparation of this machine beside a run: processes get ready what its tasks call.

They go through the steps in order, and a task waits for its own step alone: a processor that has
no task yet prepares later steps.
"""

import contextlib
import re
import subprocess
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from spl_batch.engine.watch.events import Compiling, Listener, Note, ignore

PATIENCE_S: Final = 600.0
"""Time after which tasks start all the same [s]."""

_LINE: Final = re.compile(r"(\d+) (\d+) (\d+) (\d+)\n")


@dataclass(slots=True)
class _Share:
    """A process, and how far it is."""

    child: Any
    done: int = 0  #: Parts that are ready.
    of: int = 0  #: Parts that it gets ready.
    made: int = 0  #: Those that were not ready before.
    step: int = 0  #: Number of the step that it works for; at its end, of steps.
    heard: bool = False  #: Whether all that it wrote was taken in.


@dataclass(slots=True)
class WarmUp:
    """Something that processes of this machine do before tasks need it.

    Each process ends when its standard input does. It writes a line, the four numbers of
    :class:`_Share`, before each part and at its end.
    """

    #: Command of a process, by its number from 0 and how many there are.
    command: Callable[[int, int], Sequence[str]]
    steps: Sequence[str]  #: Those whose tasks need some of it, in order.
    what: str  #: What is being done, in words.
    #: It is there once all is ready: no process is started then. Marks beside it that differ before
    #: a hyphen are of other code, which what is got ready replaces.
    mark: Path
    processes: int  #: How many are started [count].
    waited_s: float | None = None  #: How long tasks had to wait; None where all was ready [s].
    _shares: list[_Share] = field(default_factory=list)
    _listener: Listener = ignore
    _told: bool = False
    _ended: bool = False
    _deadline_s: float = 0.0
    _changed: threading.Condition = field(default_factory=threading.Condition)

    @property
    def made(self) -> int:
        """Parts that were not ready before [count]."""
        return sum(share.made for share in self._shares)

    def begin(self, listener: Listener = ignore) -> None:
        """Start the processes, unless they are at work; one listener hears how far they are."""
        self._listener, self._told = listener, False
        if not all(share.heard for share in self._shares):
            return
        self._shares, self.waited_s, self._ended = [], None, False
        self._deadline_s = time.monotonic() + PATIENCE_S
        if self.mark.exists():
            return
        own, _, _ = self.mark.name.partition("-")
        for other in self.mark.parent.glob(f"*{self.mark.suffix}"):
            if not other.name.startswith(own):
                other.unlink(missing_ok=True)
        try:
            children = [self._child(number) for number in range(self.processes)]
        except OSError as error:
            self._listener(Note("info", f"{self.what}: {error}"))
            return
        self._shares = [_Share(child) for child in children]
        for share in self._shares:
            threading.Thread(target=self._hear, args=(share,), daemon=True).start()

    def _child(self, number: int) -> Any:
        """A process; it ends by itself once nobody holds the other end of its standard input."""
        return subprocess.Popen(  # noqa: S603 - a module of this project
            self.command(number, self.processes),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,  # Ctrl-C is for the run, which ends them
        )

    @contextlib.contextmanager
    def beside(self) -> Iterator[None]:
        """Have the processes at work while a body runs, or what in it begins them again."""
        self.begin()
        try:
            yield
        finally:
            self.end()

    def wait_for(self, step: str) -> None:
        """Wait until what tasks of a step call is ready, or nobody gets it ready any more."""
        number = self.steps.index(step) if step in self.steps else -1
        if all(share.step > number for share in self._shares):
            return
        begin_s = time.monotonic()
        self._wait(lambda share: share.step > number)
        if self.made:
            self.waited_s = (self.waited_s or 0.0) + time.monotonic() - begin_s

    def finish(self) -> None:
        """Wait until all is ready."""
        self._wait(lambda share: share.heard)

    def end(self) -> None:
        """End the processes; what they have got ready stays."""
        self._ended = True
        for share in self._shares:
            share.child.kill()
        self.finish()

    def _wait(self, enough: Callable[[_Share], bool]) -> None:
        with self._changed:
            left_s = max(self._deadline_s - time.monotonic(), 0.0)
            self._changed.wait_for(lambda: all(map(enough, self._shares)), left_s)

    def _hear(self, share: _Share) -> None:
        """Take in what a process writes, to its end."""
        line = ""
        try:
            with share.child as child:
                for line in child.stdout:
                    if found := _LINE.fullmatch(line):
                        self._take(share, *map(int, found.groups()))
            if child.returncode and not self._ended:
                why = (
                    line.strip() if child.returncode > 0 else f"ended by signal {-child.returncode}"
                )
                self._listener(Note("info", f"{self.what}: {why}"))
            elif all(one.child.returncode == 0 for one in self._shares):
                self.mark.touch()
        except OSError as error:  # a full disk: the next run looks again
            self._listener(Note("info", f"{self.what}: {error}"))
        finally:
            with self._changed:
                share.step, share.heard = len(self.steps), True
                self._changed.notify_all()

    def _take(self, share: _Share, done: int, of: int, made: int, step: int) -> None:
        """Take in how far a process is, and report it unless all find everything ready."""
        with self._changed:
            share.done, share.of, share.made, share.step = done, of, made, step
            self._changed.notify_all()
            if made and not self._told:
                self._listener(Note("info", self.what))
                self._told = True
            # Else the whole would grow as they begin.
            if self.made and all(one.of for one in self._shares):
                dones, ofs = zip(*((one.done, one.of) for one in self._shares), strict=True)
                self._listener(Compiling(sum(dones), sum(ofs)))
