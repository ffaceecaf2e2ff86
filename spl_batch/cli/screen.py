"""Results on the screen: the few numbers that matter, and where the rest is."""

import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from rich.console import Group, RenderableType
from rich.live import Live
from rich.table import Table
from rich.text import Text

from spl_batch.cli.console import PlainConsole, is_screen, print_error
from spl_batch.cli.view import duration, speed
from spl_batch.errors import counted, grouped, storage

if TYPE_CHECKING:  # each command loads what it needs only
    from spl_batch.api import (
        Beginning,
        ComparisonResult,
        Follower,
        PlanSummary,
        RunResult,
        RunStatus,
    )

SHOWN: Final = 5
"""Failures and running tasks that are named [count]."""

ROUGH_S: Final = 10.0
"""Below this no rate estimates how long a run takes: workers start, reports are drawn [s]."""

_OUT: Final = PlainConsole()


def print_result(result: "RunResult") -> None:
    """Print how a run ended."""
    if result.report is None and not result.screen:
        _OUT.print_line(f"stopped as asked; run again to continue in {result.output}")
        return
    _pairs(result.screen)
    for label, paths in result.results:
        _path(label, *paths)


def print_comparison(result: "ComparisonResult") -> None:
    """Print how several methods did, and where the rest is."""
    table = Table(*result.titles, box=None, padding=(0, 1, 0, 0), pad_edge=False)
    cells = zip(*result.rows, strict=True)
    for column, title, below in zip(table.columns, result.titles, cells, strict=True):
        column.min_width = max(map(len, (*title.split(), *below)))  # nothing is cut off
    for row in result.rows:
        table.add_row(*row)
    _OUT.print(table)
    _path("comparison", result.output / "compare.html")


def print_simulation(summary: Any, output: Path) -> None:
    """Print what was simulated."""
    _pairs(summary.rows)
    _path("workflow", output / "workflow.yaml")


def print_beginning(begun: "Beginning") -> None:
    """Print what files hold of a survey, and what they do not."""
    _pairs(begun.found)
    for label, text in begun.unknown:
        _OUT.print_line(f"unknown: {label}: {text}", "yellow")
    for text in begun.left_out:
        _OUT.print_line(f"left out: {text}", "yellow")
    _path("workflow", begun.workflow)


def print_plan(summary: "PlanSummary") -> None:
    """Print what a run would do."""
    cost, unusable = summary.cost, summary.unusable
    files = grouped(summary.files)
    if unusable:
        files += f" of {grouped(summary.files + unusable)}, {grouped(unusable)} unusable"
    shared = " (by default, as --memory is not given)" if summary.shared else ""
    needed, limit = (grouped(n / 2**20) for n in (cost.memory_bytes, summary.limit_bytes))
    took = f"under {ROUGH_S:.0f} s, apart from starting workers and drawing the report"
    time_s = took if cost.time_s < ROUGH_S else duration(cost.time_s)
    finished = f", {grouped(summary.finished)} finished before" if summary.finished else ""
    _pairs(
        [
            ("files", files),
            ("points", grouped(summary.points)),
            *summary.rows,
            ("tasks", f"{grouped(cost.tasks)}{finished}"),
            ("disk", storage(cost.disk_bytes)),
            ("memory", f"{needed} of each worker's {limit} MiB{shared} for {cost.heaviest}"),
            ("time", f"{time_s} ({'as measured here' if cost.measured else 'typical rates'})"),
        ]
    )
    for one in summary.findings:
        _OUT.print_line(f"warning: {one.text}", "yellow")
    for text in summary.faults:
        _OUT.print_line(f"unusable: {text}", "red")


def print_status(status: "RunStatus") -> None:
    """Print the state of the latest run."""
    _OUT.print(_whole(status))


def watch_status(follower: "Follower", every_s: float = 1.0) -> "RunStatus":
    """Show the state of a run until it ends; a pipe or a log gets the last one."""
    status = follower.update()
    live = Live(console=_OUT, auto_refresh=False, transient=True)
    while status.holder is not None and status.ended is None:
        if is_screen(_OUT):
            live.start()
            live.update(_whole(status), refresh=True)
        time.sleep(every_s)
        status = follower.update()
    live.stop()
    print_status(status)
    return status


def await_run(output: Path, every_s: float = 1.0) -> None:
    """Wait until a run has begun in a folder that is not there yet."""
    if not output.exists():
        print_error(f"info: no run has begun in {output} yet: waiting for one; Ctrl-C ends")
    while not output.exists() or {path.name for path in output.glob("*")} == {"store"}:
        time.sleep(every_s)


def _whole(status: "RunStatus") -> RenderableType:
    """State by stage as a table; workers, running tasks and failures below it."""
    table = Table("stage", "done", "failed", "left", "speed", "elapsed", "time left", box=None)
    for stage in status.stages.values():
        table.add_row(
            stage.stage,
            f"{stage.done}/{stage.total}" if stage.total else "",
            str(stage.failed or ""),
            str(stage.left or ""),
            speed(stage),
            duration(stage.elapsed_s) if stage.elapsed_s else "",
            duration(stage.left_s) if round(stage.left_s) else "",
        )
    lines = [Text(f"  {text}") for text in _facts(status)]
    failed = [*status.unusable, *status.failures]
    lines += [Text(f"  failed: {x.task}: {x.reason}", style="red") for x in failed[:SHOWN]]
    if len(failed) > SHOWN:
        lines.append(Text(f"  and {len(failed) - SHOWN} more, all in log.jsonl", style="red"))
    return Group(table, *lines)


def _facts(status: "RunStatus") -> list[str]:
    """Whether the run works, has ended or was killed; workers and running tasks."""
    if status.ended is not None:
        reason = status.ended.get("reason") or ""
        return [f"ended with exit status {status.ended['exit_status']}{reason and ': '}{reason}"]
    if status.holder is None:
        return ["stopped before its end; the same command continues"]
    who, seen = status.holder, status.workers
    found = [f"working: process {who['pid']} on {who['host']}, since {who['started']}"]
    if round(status.left_s):
        found.append(f"time left about {duration(status.left_s)}")
    if seen:
        of = f" of {grouped(seen['limit_mb'])}" if seen["limit_mb"] else ""
        count = ", ".join(counted(seen[noun], noun) for noun in ("workers", "threads"))
        found.append(f"{count}; most memory {grouped(seen['memory_mb'])}{of} MiB")
    if status.running:
        names, more = list(status.running.values())[:SHOWN], len(status.running) - SHOWN
        found.append(f"running {', '.join(names)}" + (f" and {more} more" if more > 0 else ""))
    return [*found, *([f"dask dashboard {status.dashboard}"] if status.dashboard else [])]


def _pairs(pairs: Sequence[tuple[str, str]]) -> None:
    """Label and value, side by side; in a pipe or a log each pair is one line, however long."""
    width = max((len(label) for label, _ in pairs), default=0)
    table = Table(box=None, show_header=False, padding=(0, 2, 0, 0))
    for label, value in pairs:
        style = "red" if label in {"attention", "failed"} else ""
        if is_screen(_OUT):
            table.add_row(Text(label, style=style or "dim"), Text(value, style=style))
        else:
            _OUT.print_line(f"{label:{width}}  {value}")
    if table.row_count:
        _OUT.print(table)


def _path(label: str, *paths: Path) -> None:
    """Files that are there, in one line."""
    found = "  ".join(str(path) for path in paths if path.exists())
    if found:
        _OUT.print(Text.assemble((label, "dim"), f"  {found}"), soft_wrap=True)
