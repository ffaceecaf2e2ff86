"""What a person sees: progress bars, and the few numbers that matter."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    Task,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.table import Table
from rich.text import Text

from spl_batch.api import ComparisonResult, PlanSummary, RunResult, StageStatus
from spl_batch.api.events import Event, Note, PhaseStarted, TaskEnded
from spl_batch.report.format import centimetres, number, percent, significant
from spl_batch.report.model import Report
from spl_batch.report.summary import screen_summary

_OUT = Console()
_ERR = Console(stderr=True)


class _Rate(ProgressColumn):
    """Points per second of a stage."""

    def render(self, task: Task) -> Text:
        """Show the rate, once there is one."""
        points, elapsed = task.fields.get("points", 0), task.elapsed or 0.0
        if not points or elapsed < 0.5:
            return Text("")
        return Text(f"{_short(points / elapsed)} pts/s", style="cyan")


class View:
    """Draws what happens; one bar for each stage."""

    def __init__(self, progress: Progress) -> None:
        self._progress = progress
        self._bars: dict[str, Any] = {}

    def simulated(self, share: float) -> None:
        """Show how much of a simulation is done, 0..1."""
        if "simulate" not in self._bars:
            self._bars["simulate"] = self._progress.add_task("simulate", total=100)
        self._progress.update(self._bars["simulate"], completed=round(100 * share))

    def on_event(self, event: Event) -> None:
        """Show an event."""
        if isinstance(event, Note):
            style = {"warning": "yellow", "error": "red"}.get(event.level, "dim")
            line = Text(f"{event.level}: {event.text}", style=style)
            self._progress.console.print(line, soft_wrap=True)
        elif isinstance(event, PhaseStarted):
            self._start(event)
        elif isinstance(event, TaskEnded):
            self._advance(event)

    def _start(self, event: PhaseStarted) -> None:
        bar = self._bars.get(event.stage)
        if bar is None:
            bar = self._bars[event.stage] = self._progress.add_task(event.stage, total=0)
        known = self._progress.tasks[self._progress.task_ids.index(bar)]
        everything = event.tasks + event.skipped
        self._progress.update(bar, total=(known.total or 0) + everything, advance=event.skipped)

    def _advance(self, event: TaskEnded) -> None:
        bar = self._bars[event.stage]
        known = self._progress.tasks[self._progress.task_ids.index(bar)]
        points = known.fields.get("points", 0) + event.points
        self._progress.update(bar, advance=1, points=points)
        if event.reason:
            text = f"failed: {event.kind} {event.name}: {event.reason}"
            self._progress.console.print(Text(text, style="red"), soft_wrap=True)


@contextmanager
def watching() -> Iterator[View]:
    """Draw progress bars on standard error while the block runs."""
    with Progress(
        TextColumn("{task.description:>10}"),
        BarColumn(bar_width=28),
        MofNCompleteColumn(),
        _Rate(),
        TimeElapsedColumn(),
        TimeRemainingColumn(compact=True),
        console=_ERR,
    ) as progress:
        yield View(progress)


def print_result(result: RunResult) -> None:
    """Print how a run ended."""
    if result.report is None:
        _OUT.print(f"stopped as asked; run again to continue in {result.output}")
        return
    print_report(result.report, result.output)


def print_report(report: Report, output: Path) -> None:
    """Print the numbers that a user cares about, and where the rest is."""
    _pairs(screen_summary(report))
    _path("report", output / "report.html")
    _path("rasters", output / "dtm.tif", output / "dsm.tif")
    _path("clouds", output / "laz")


def print_comparison(result: ComparisonResult) -> None:
    """Print how several filters did, and where the rest is."""
    titles = ("filter", "kept", "removed", "far noise", "DTM RMSE", "DSM RMSE", "s per million")
    table = Table(*titles, box=None)
    table.columns[0].no_wrap = True
    table.columns[0].min_width = max(len(method.name) for method in result.report.methods)
    for method in result.report.methods:
        table.add_row(
            method.name,
            number(method.signal),
            percent(method.removed_share),
            percent(method.far_share, 3),
            centimetres(method.dtm_rmse_m),
            centimetres(method.dsm_rmse_m),
            significant(method.denoise_s_per_million),
        )
    _OUT.print(table)
    _path("comparison", result.output / "compare.html")


def print_simulation(summary: Any, output: Path) -> None:
    """Print what was simulated."""
    _pairs([("returns", f"{summary.points:,}"), ("flightlines", str(len(summary.lines)))])
    _path("workflow", output / "workflow.yaml")


def print_plan(summary: PlanSummary) -> None:
    """Print what a run would do."""
    cost = summary.cost
    basis = "as measured here" if cost.measured else "typical rates"
    halo = (
        f"{cost.halo_m:g} m around a block; around a ground cell {summary.ground_buffer_m:g} m "
        f"for the ground, {summary.surface_reach_m:g} m for its rasters"
    )
    _pairs(
        [
            ("files", f"{summary.files:,}"),
            ("points", f"{summary.points:,}"),
            ("area", f"{summary.area_km2:,.3f} km2 of tiles"),
            ("stretches", f"{cost.stretches:,} of flightlines"),
            ("tiles", f"{cost.tiles:,}"),
            ("blocks", f"{cost.blocks:,} of up to {cost.block_tiles} x {cost.block_tiles} tiles"),
            ("ground cells", f"{cost.cells:,}"),
            ("halo", halo),
            ("tasks", f"{cost.tasks:,}"),
            ("disk", f"{cost.disk_bytes / 2**30:,.2f} GiB"),
            ("memory", f"{cost.memory_bytes / 2**20:,.0f} MiB a worker, for {cost.heaviest}"),
            ("time", f"{_duration(cost.time_s)} ({basis})"),
        ]
    )
    for text in summary.warnings:
        _OUT.print(Text(f"warning: {text}", style="yellow"), soft_wrap=True)
    for text in summary.faults:
        _OUT.print(Text(f"unusable: {text}", style="red"), soft_wrap=True)


def print_status(stages: Sequence[StageStatus]) -> None:
    """Print the state of each stage."""
    table = Table("stage", "done", "failed", "left", "points/s", "time left", box=None)
    for stage in stages:
        rate = stage.points / stage.wall_s if stage.wall_s > 0 else 0.0
        left = _duration(stage.left_points / rate) if rate and stage.left_points > 0 else ""
        table.add_row(
            stage.stage,
            f"{stage.done}/{stage.total}",
            str(stage.failed or ""),
            str(stage.left or ""),
            _short(rate) if rate else "",
            left,
        )
    _OUT.print(table)


def _pairs(pairs: Sequence[tuple[str, str]]) -> None:
    table = Table(box=None, show_header=False, padding=(0, 2, 0, 0))
    for label, value in pairs:
        table.add_row(Text(label, style="dim"), Text(value))
    _OUT.print(table)


def _path(label: str, *paths: Path) -> None:
    found = [str(path) for path in paths if path.exists()]
    if found:
        _OUT.print(f"[dim]{label}[/dim]  " + "  ".join(found), soft_wrap=True, highlight=False)


def _short(value: float) -> str:
    for limit, suffix in ((1e9, "G"), (1e6, "M"), (1e3, "k")):
        if value >= limit:
            return f"{value / limit:.1f}{suffix}"
    return f"{value:.0f}"


def _duration(seconds: float) -> str:
    hours, rest = divmod(round(seconds), 3600)
    minutes, seconds = divmod(rest, 60)
    if hours:
        return f"{hours} h {minutes:02d} min"
    return f"{minutes} min {seconds:02d} s" if minutes else f"{seconds} s"
