"""Views of a run: drawn where somebody sits before it, plain lines where a log is kept."""

import threading
import time
from collections import Counter
from typing import Final

from rich.console import Console, Group, RenderableType
from rich.text import Text

from spl_batch.cli.lines import screen_lines
from spl_batch.cli.live import bars, details, duration, speed
from spl_batch.engine.watch.events import (
    Compiling,
    Event,
    Note,
    PhaseStarted,
    RunStarted,
    TaskEnded,
    TaskStarted,
    WorkersReady,
    as_record,
)
from spl_batch.engine.watch.status import RunStatus, StageStatus
from spl_batch.errors import grouped

LINE_S = 30.0
"""How often a log that is not a terminal is told how far a stage is [s]."""

STEP_SHARE = 0.1
"""How much more of a simulation is done when a log is told again."""

STEP_S = 2.0
"""How long a log that is told of a simulation is left alone at least [s]."""

QUIET_S = 1.0
"""How long nothing is heard before a view says so [s]."""


BEAT_S = 10.0
"""Silence after which a log is told what is being done [s]."""

BEATS = 6
"""Times that it is told so often; then it is every :data:`LINE_S` [count]."""


PACE_S: Final = 5.0
"""Time from which on the pace of compiling tells how long the rest takes [s]."""


class Compiled:
    """How far kernels are compiled, and at what pace."""

    def __init__(self) -> None:
        self._began_s, self._first, self._done, self._of = time.monotonic(), 0, 0, 0

    def hear(self, done: int, of: int) -> None:
        """Take in how many of how many are ready."""
        if not self._of:
            self._began_s, self._first = time.monotonic(), done
        self._done, self._of = done, of

    def __str__(self) -> str:
        said = f"compiling: {grouped(self._done)} of {grouped(self._of)} kernels ready"
        spent_s, made = time.monotonic() - self._began_s, self._done - self._first
        if spent_s < PACE_S:
            return said
        said = f"{said} after {duration(spent_s)}"
        left_s = spent_s * (self._of - self._done) / made if made else 0.0
        return f"{said}, about {duration(left_s)} left at this pace" if left_s >= 1.0 else said


class View:
    """Keeps the state of a run, for someone to draw.

    Parameters
    ----------
    console : Console
        Where lines go that stay.
    """

    def __init__(self, console: Console) -> None:
        self._console = console
        self._lock = threading.Lock()
        self._status = RunStatus()
        self._simulated = StageStatus("simulate")
        self._over = self._runs = False
        self._stopping = ""
        self._compiled: Compiled | None = None
        self._heard_s = time.time()

    def simulated(self, share: float) -> None:
        """Show how much of a simulation is done, 0..1."""
        now = time.time()
        with self._lock:
            stage = self._simulated
            stage.total, stage.done, stage.latest_s = 100, round(100 * share), now
            self._heard_s = now
            stage.began_s = stage.began_s or now

    def on_event(self, event: Event) -> None:
        """Take in an event; what is to be read is printed at once."""
        with self._lock:
            self._status.feed(as_record(event))
            self._heard_s = time.time()
            self._runs |= isinstance(event, RunStarted)
            if isinstance(event, Compiling):
                self._compiled = self._compiled or Compiled()
                self._compiled.hear(event.done, event.of)
            elif isinstance(event, TaskStarted):
                self._compiled = None
        if isinstance(event, Note):
            style = {"warning": "yellow", "error": "red"}.get(event.level, "dim")
            word = {"error": "unusable"}.get(event.level, event.level)  # as a plan calls it
            self._print(f"{word}: {event.text}", style)
        elif isinstance(event, TaskEnded) and event.reason and not (event.stops or event.mends):
            called = event.called or f"{event.kind} {event.name}"
            self._print(f"failed: {called}: {event.reason}", "red")
        elif isinstance(event, WorkersReady) and event.dashboard:
            self._print(f"info: dask dashboard: {event.dashboard}", "dim")

    def stop(self, text: str) -> None:
        """From now on draw that the run is being stopped; a signal's handler may call it."""
        self._stopping = text

    def over(self) -> None:
        """From now on draw what stays on the screen: the stages."""
        self._over = True

    def draw(self) -> RenderableType:
        """The view as it is now."""
        with self._lock:
            self._status.advance(time.time())
            if self._simulates:
                self._simulated.now_s = time.time()
            stages = bars([self._simulated, *self._status.rows])
            if self._over:
                return stages
            if self._stopping or not self._status.running:
                return Group(stages, self._between())
            return Group(stages, *details(self._status))

    @property
    def _simulates(self) -> bool:
        """Whether a simulation is at work, whose bar has the clock."""
        return bool(self._simulated.began_s) and not (self._runs or self._over)

    def _between(self) -> Text:
        """What is done where no task runs, and for how long: that it is alive."""
        if self._stopping:
            return Text(f"  {self._stopping}")
        if self._compiled is not None:
            return Text(f"  {self._compiled}", style="dim")
        quiet_s = time.time() - self._heard_s
        if quiet_s < QUIET_S or self._simulates:
            return Text("")
        word = "writing the report" if self._status.reporting else "getting ready"
        return Text(f"  {word}, {duration(quiet_s)}", style="dim")

    def _print(self, text: str, style: str) -> None:
        for line in screen_lines(text):
            self._console.print(Text(line, style=style), soft_wrap=True)


class PlainView(View):
    """Prints a line when a phase begins, and now and then how far it is."""

    def __init__(self, console: Console) -> None:
        super().__init__(console)
        self._printed_s = time.monotonic()
        self._told_share = 0.0
        self._beats = 0

    def simulated(self, share: float) -> None:
        """Print a line when a simulation begins, and one for each tenth that took a while."""
        began = not self._simulated.began_s
        super().simulated(share)
        if began:
            self._say("simulate: begun")
        elif share > self._told_share and (share >= 1.0 or self._is_time(share)):
            self._told_share = share
            self._say(f"simulate: {100 * share:.0f} %")

    def _is_time(self, share: float) -> bool:
        """Whether a simulation has come so far since the last line that it deserves another."""
        waited_s = time.monotonic() - self._printed_s
        return share - self._told_share > STEP_SHARE - 1e-9 and waited_s >= STEP_S

    def on_event(self, event: Event) -> None:
        """Take in an event, and print a line where it is time for one."""
        super().on_event(event)
        if isinstance(event, PhaseStarted):
            skipped = f", {event.skipped} finished before" if event.skipped else ""
            tasks = f"{event.tasks} task{'s' * (event.tasks != 1)}"
            self._say(f"{event.stage}: {event.kind.replace('_', ' ')}: {tasks}{skipped}")
        elif isinstance(event, Compiling) and time.monotonic() - self._printed_s > LINE_S:
            self._say(str(self._compiled))
        elif isinstance(event, TaskEnded) and time.monotonic() - self._printed_s > LINE_S:
            stage = self._status.stages[event.stage]
            rate = f", {speed(stage.points_per_s)}" if stage.points_per_s else ""
            left = f", {duration(stage.left_s)} left" if round(stage.left_s) else ""
            self._say(f"{event.stage}: {stage.total - stage.left}/{stage.total}{rate}{left}")

    def beat(self) -> None:
        """Print what is being done if nothing was printed for a while."""
        beats = self._beats
        if time.monotonic() - self._printed_s <= (BEAT_S if beats < BEATS else LINE_S):
            return
        if text := self._at_work():
            self._say(text)
            self._beats = beats + 1

    def _at_work(self) -> str:
        """What is being done now, in words."""
        with self._lock:
            busy = Counter(self._status.begun[task] for task in self._status.running)
            if busy:
                return "; ".join(
                    f"{name}: {stage.total - stage.left}/{stage.total}, {busy[name]} at work for "
                    f"{duration(time.time() - stage.began_s)}{self._maybe_compiling(stage)}"
                    for name, stage in self._status.stages.items()
                    if busy[name]
                )
            if self._simulates:
                what = "at work on the next" if self._simulated.left else "writing the last"
                return f"simulate: {self._simulated.done} %, {what}"
            return self._between().plain.strip()

    def _maybe_compiling(self, stage: StageStatus) -> str:
        """That the first task of a stage may compile, where no workers have done so before."""
        if self._status.workers or stage.left < stage.total:
            return ""
        return ", compiling first where this machine has not yet"

    def _say(self, text: str) -> None:
        self._printed_s, self._beats = time.monotonic(), 0
        self._print(text, "")
