"""View of a run while it works: bars where somebody sits before it, lines where a log is kept."""

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn
from rich.progress import TimeElapsedColumn as Elapsed

from spl_batch.cli.console import PlainConsole, is_screen
from spl_batch.engine.report.number_format import as_ascii, large
from spl_batch.engine.report.number_format import duration as _duration
from spl_batch.engine.watch.events import (
    Compiling,
    Event,
    Note,
    PhaseStarted,
    ReportStarted,
    RunStarted,
    TaskEnded,
    WorkersReady,
    as_record,
)
from spl_batch.engine.watch.status import RunStatus, StageStatus

LINE_S: Final = 30.0
"""How often a log that is not a terminal gets a line of how far a stage is [s]."""

_STYLES: Final = {"warning": "yellow", "error": "red"}


class View:
    """Listens to a run: each note is a line, each stage a bar.

    Parameters
    ----------
    console : PlainConsole
        Where it is shown; without a terminal each phase is a line, and now and then how far it is.
    """

    def __init__(self, console: PlainConsole) -> None:
        self._console, self._status = console, RunStatus()
        self._drawn, self._lock = is_screen(console), threading.RLock()
        self._bars: dict[str, TaskID] = {}
        self._printed_s = time.monotonic()
        self.progress = Progress(
            TextColumn("{task.description:>10}"),
            BarColumn(28),
            MofNCompleteColumn(),
            TextColumn("{task.fields[speed]}", style="cyan"),
            Elapsed(),
            TextColumn("{task.fields[left]}"),
            console=console,
            disable=not self._drawn,
        )

    def simulated(self, share: float) -> None:
        """Show how much of a simulation is done, 0..1."""
        self._show(StageStatus("simulate", total=100, done=round(100 * share)))
        how = (
            f"{100 * share:.0f} %" if share else "the first on a machine compiles for half a minute"
        )
        self._line(f"simulate: {how}", now=share in {0.0, 1.0})

    def loading(self) -> None:
        """Show that files are being looked at, until the first event."""
        self._bars["loading"] = self.progress.add_task("loading", total=None, speed="", left="")

    def on_event(self, event: Event) -> None:
        """Take in an event: what is to be read is printed at once."""
        with self._lock:
            if "loading" in self._bars:
                self.progress.remove_task(self._bars.pop("loading"))
            self._status.feed(as_record(event))
            if isinstance(event, RunStarted):
                self._bars.clear()
            elif isinstance(event, Note):
                word = {"error": "unusable"}.get(event.level, event.level)  # as a plan calls it
                self._console.print_line(f"{word}: {event.text}", _STYLES.get(event.level, "dim"))
            elif isinstance(event, WorkersReady) and event.dashboard:
                self._console.print_line(f"info: dask dashboard: {event.dashboard}", "dim")
            elif isinstance(event, PhaseStarted | TaskEnded):
                self._stage(event)
            elif isinstance(event, Compiling):
                self._show(StageStatus("compile", total=event.of, done=event.done))
                self._line(f"compile: {event.done}/{event.of} kernels")
            elif isinstance(event, ReportStarted):
                self._line("report: being written", now=True)

    def _stage(self, event: PhaseStarted | TaskEnded) -> None:
        """Show how far the stage of an event is."""
        stage = self._status.stages[event.stage]
        self._show(stage)
        if isinstance(event, PhaseStarted):
            self._line(
                f"{event.stage}: {event.kind.replace('_', ' ')}: {event.tasks} tasks, "
                f"{event.skipped} finished before",
                now=True,
            )
            return
        if event.reason and event.code != "F03":  # that is made again, or named at the end
            called = event.called or f"{event.kind} {event.name}"
            self._console.print_line(f"failed: {called}: {event.reason}", "red")
        self._line(f"{event.stage}: {stage.total - stage.left}/{stage.total}{_pace(stage)}")

    def _show(self, stage: StageStatus) -> None:
        """Draw the bar of a stage."""
        known = self._bars.get(stage.stage)
        if known is None:
            known = self.progress.add_task(stage.stage, speed="", left="")
            self._bars[stage.stage] = known
        self.progress.update(
            known,
            total=stage.total,
            completed=stage.total - stage.left,
            speed=speed(stage),
            left=f"{duration(stage.left_s)} left" if round(stage.left_s) and stage.left else "",
        )

    def _line(self, text: str, *, now: bool = False) -> None:
        """Print a line to a log, unless there was one just before."""
        if not self._drawn and (now or time.monotonic() - self._printed_s > LINE_S):
            self._printed_s = time.monotonic()
            self._console.print_line(text)


@contextmanager
def watching(console: Console | None = None) -> Iterator[View]:
    """Show what happens while the body runs, on standard error.

    Yields
    ------
    View
        Its ``on_event`` is the ``listener`` of a verb, its ``simulated`` the ``progress`` of a
        simulation.
    """
    shown = console if isinstance(console, PlainConsole) else PlainConsole(stderr=True)
    view = View(shown)
    with view.progress:
        yield view


def speed(stage: StageStatus) -> str:
    """Speed of a stage; empty where it is not known."""
    return f"{as_ascii(large(stage.points_per_s))} points/s" if stage.points_per_s else ""


def duration(seconds: float) -> str:
    """A time in plain spaces."""
    return as_ascii(_duration(seconds))


def _pace(stage: StageStatus) -> str:
    """Speed and time left, each behind a comma."""
    left = f", {duration(stage.left_s)} left" if round(stage.left_s) else ""
    return f", {speed(stage)}{left}" if speed(stage) else left
