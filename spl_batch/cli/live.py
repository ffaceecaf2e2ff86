"""The live view of a run: stages, workers, failures, time left."""

from collections.abc import Iterable, Sequence
from typing import Final

from rich.console import Group, RenderableType
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from spl_batch.cli.lines import screen_lines
from spl_batch.engine.report.number_format import as_ascii, large
from spl_batch.engine.watch.status import FailedTask, RunStatus, StageStatus
from spl_batch.errors import counted, grouped

TOLD_FROM_S: Final = 10.0
"""Below this no rate tells how long a run takes: workers have to start, reports are drawn [s]."""

SHOWN: Final = 5
"""Failures and running tasks that are named [count]."""


def draw(status: RunStatus) -> RenderableType:
    """Everything that is known about a run that is working, or was stopped."""
    return Group(bars(status.rows), *details(status))


def details(status: RunStatus, *, working: bool = True) -> list[RenderableType]:
    """Failed tasks; of a run that was not killed workers, running tasks, time left too."""
    facts = [Text(line, style="dim") for line in _facts(status)] if working else []
    return [*facts, *failed_lines(status.failures)]


def bars(stages: Iterable[StageStatus]) -> Table:
    """One line for each stage that has begun; on a narrow screen the bars are shorter."""
    table = Table.grid(padding=(0, 1))
    table.add_column(justify="right", min_width=10, no_wrap=True)
    table.add_column(max_width=28)
    for _ in range(4):
        table.add_column(no_wrap=True)
    for stage in stages:
        if not stage.began_s:
            continue
        failed = Text(f"{stage.failed} failed", style="red") if stage.failed else Text("")
        rate = stage.points_per_s
        table.add_row(
            stage.stage,
            ProgressBar(total=stage.total or 1, completed=stage.total - stage.left),
            Text(f"{stage.total - stage.left}/{stage.total}", style="green"),
            Text(speed(rate) if rate else "", style="cyan"),
            Text(taken(stage) if stage.total else "", style="yellow"),
            Text(f"{duration(stage.left_s)} left") if round(stage.left_s) else failed,
        )
    return table


def _facts(status: RunStatus) -> list[str]:
    """Workers, running tasks, time left: a line each."""
    lines = []
    if status.ended is None and round(status.left_s):
        lines.append(f"  time left about {duration(status.left_s)}")
    if status.workers:
        used, limit = status.workers["memory_mb"], status.workers["limit_mb"]
        of = f" of {grouped(limit)}" if limit else ""
        peak = f", {grouped(status.peak_mb)} at most so far" if status.peak_mb else ""
        count = ", ".join(counted(status.workers[noun], noun) for noun in ("workers", "threads"))
        lines.append(f"  {count}; most memory {grouped(used)}{of} MiB{peak}")
    elif status.peak_mb:
        lines.append(f"  memory {grouped(status.peak_mb)} MiB at most so far")
    if status.running:
        names = [status.called[task] for task in list(status.running)[:SHOWN]]
        more = len(status.running) - len(names)
        lines.append(f"  running {', '.join(names)}" + (f" and {more} more" if more else ""))
    if status.dashboard and status.ended is None:
        lines.append(f"  dask dashboard {status.dashboard}")
    return lines


def failed_lines(failures: Sequence[FailedTask]) -> list[RenderableType]:
    """Lines of the first tasks or inputs that failed, and how many more there are."""
    told = (screen_lines(f"failed: {one.task}: {one.reason}") for one in failures[:SHOWN])
    lines: list[RenderableType] = [Text(f"  {line}", style="red") for one in told for line in one]
    more = len(failures) - SHOWN
    if more > 0:
        lines.append(Text(f"  and {more} more, all in log.jsonl", style="red"))
    return lines


def speed(points_per_s: float) -> str:
    """A speed as the report has it."""
    return f"{as_ascii(large(points_per_s))} points/s"


def duration(seconds: float) -> str:
    """A time in hours, minutes and seconds."""
    hours, rest = divmod(round(seconds), 3600)
    minutes, seconds = divmod(rest, 60)
    if hours:
        return f"{hours} h {minutes:02d} min"
    return f"{minutes} min {seconds:02d} s" if minutes else f"{seconds} s"


def taken(stage: StageStatus) -> str:
    """How long a stage has taken in this run."""
    return "done before" if stage.of_earlier_runs else duration(stage.elapsed_s)


def expected(seconds: float) -> str:
    """A time that is estimated from rates alone."""
    return f"under {TOLD_FROM_S:.0f} s" if seconds < TOLD_FROM_S else duration(seconds)
