"""Watching a run: drawn where somebody sits before it, plain lines where a log is kept."""

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.text import Text

from spl_batch.api.events import (
    Event,
    Note,
    PhaseStarted,
    TaskEnded,
    WorkersReady,
    as_record,
)
from spl_batch.api.status import RunStatus, StageStatus
from spl_batch.cli.live import bars, details, duration, short

_ERR = Console(stderr=True)

REFRESH_PER_S = 4.0
"""How often the view is drawn; events between are only counted [1/s]."""

LINE_S = 30.0
"""How often a log that is not a terminal is told how far a stage is [s]."""

QUIET_S = 1.0
"""How long nothing is heard before a view says so [s]."""


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
        self._over = False
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
        if isinstance(event, Note):
            style = {"warning": "yellow", "error": "red"}.get(event.level, "dim")
            self._print(f"{event.level}: {event.text}", style)
        elif isinstance(event, TaskEnded) and event.reason and not event.stops:
            called = event.called or f"{event.kind} {event.name}"
            self._print(f"failed: {called}: {event.reason}", "red")
        elif isinstance(event, WorkersReady) and event.dashboard:
            self._print(f"info: dask dashboard: {event.dashboard}", "dim")

    def over(self) -> None:
        """From now on draw what stays on the screen: the stages."""
        self._over = True

    def draw(self) -> RenderableType:
        """The view as it is now."""
        with self._lock:
            stages = bars([self._simulated, *self._status.stages.values()])
            if self._over:
                return stages
            if not self._status.running:
                return Group(stages, self._between())
            return Group(stages, *details(self._status))

    def _between(self) -> Text:
        """What is done where no task runs, and for how long: that it is alive."""
        quiet_s = time.time() - self._heard_s
        if quiet_s < QUIET_S:
            return Text("")
        word = "writing the report" if self._status.reporting else "getting ready"
        return Text(f"  {word}, {duration(quiet_s)}", style="dim")

    def _print(self, text: str, style: str) -> None:
        self._console.print(Text(text, style=style), soft_wrap=True)


class PlainView(View):
    """Prints a line when a phase begins, and now and then how far it is."""

    def __init__(self, console: Console) -> None:
        super().__init__(console)
        self._printed_s = time.monotonic()

    def on_event(self, event: Event) -> None:
        """Take in an event, and print a line where it is time for one."""
        super().on_event(event)
        if isinstance(event, PhaseStarted):
            skipped = f", {event.skipped} finished before" if event.skipped else ""
            tasks = f"{event.tasks} task{'s' * (event.tasks != 1)}"
            self._say(f"{event.stage}: {event.kind.replace('_', ' ')}: {tasks}{skipped}")
        elif isinstance(event, TaskEnded) and time.monotonic() - self._printed_s > LINE_S:
            stage = self._status.stages[event.stage]
            rate = f", {short(stage.points_per_s)} pts/s" if stage.points_per_s else ""
            left = f", {duration(stage.left_s)} left" if stage.left else ""
            self._say(f"{event.stage}: {stage.total - stage.left}/{stage.total}{rate}{left}")

    def _say(self, text: str) -> None:
        self._printed_s = time.monotonic()
        self._print(text, "")


@contextmanager
def watching() -> Iterator[View]:
    """Show on standard error what happens while the block runs."""
    if not _ERR.is_terminal:
        yield PlainView(_ERR)
        return
    view = View(_ERR)
    with Live(
        console=_ERR,
        get_renderable=view.draw,
        refresh_per_second=REFRESH_PER_S,
        vertical_overflow="crop",
    ):
        try:
            yield view
        finally:
            view.over()
