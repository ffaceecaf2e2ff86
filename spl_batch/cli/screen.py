"""What a person is told on the screen: the few numbers that matter, and where the rest is."""

import time
from collections.abc import Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Group, RenderableType
from rich.live import Live
from rich.table import Table
from rich.text import Text

from spl_batch.cli.console import PlainConsole, is_screen
from spl_batch.cli.lines import LINE_MAX, say_error, screen_lines, wrapped
from spl_batch.cli.live import TOLD_FROM_S, details, duration, expected, failed_lines, taken
from spl_batch.engine.report import number_format as texts
from spl_batch.engine.report.number_format import (
    as_ascii,
)
from spl_batch.engine.settings.mistaken_file import url_fault
from spl_batch.errors import brief, counted, grouped, storage

if TYPE_CHECKING:  # each command loads what it needs only
    from spl_batch.api import (
        AloneResult,
        Beginning,
        ComparisonResult,
        Follower,
        Left,
        PlanSummary,
        RunResult,
        RunStatus,
    )

_OUT = PlainConsole()


def print_result(result: "RunResult", took_s: float | None = None) -> None:
    """Print how a run ended.

    ``took_s``: time of the whole command [s]; a report that is written again has none.
    """
    if result.report is None and not result.screen:
        _lines(f"stopped as asked; run again to continue in {result.output}")
        return
    _pairs([*result.screen, *_whole_time(took_s)])
    for label, paths in result.results:
        _path(label, *paths)


def _whole_time(took_s: float | None) -> list[tuple[str, str]]:
    """Time from Enter to prompt; the report tells that of the run."""
    return (
        []
        if took_s is None
        else [("time", f"{as_ascii(texts.duration(took_s))} for the whole command")]
    )


def print_comparison(result: "ComparisonResult") -> None:
    """Print how several methods did, and where the rest is."""
    table = Table(*result.titles, box=None, padding=(0, 1, 0, 0), pad_edge=False)
    table.columns[0].no_wrap = True
    for column, title, cells in zip(
        table.columns, result.titles, zip(*result.rows, strict=True), strict=True
    ):
        column.min_width = max(map(len, (*title.split(), *cells)))  # nothing is cut off
    for row in result.rows:
        table.add_row(*row)
    _OUT.print(table)
    _path("comparison", result.output / "compare.html")


def print_simulation(summary: Any, output: Path) -> None:
    """Print what was simulated."""
    _pairs(summary.rows)
    _path("workflow", output / "workflow.yaml")


def print_beginning(begun: "Beginning") -> None:
    """Print what files tell of a survey, and what they do not."""
    _pairs(begun.found)
    for label, text in begun.unknown:
        _lines(f"not known: {label}: {text}", "yellow")
    for text in begun.left_out:
        _lines(f"left out: {text}", "yellow")
    _path("workflow", begun.workflow)


def print_plan(summary: "PlanSummary") -> None:
    """Print what a run would do."""
    cost = summary.cost
    basis = "as measured here" if cost.measured else "typical rates"
    _pairs(
        [
            ("files", _files(summary)),
            ("points", grouped(summary.points)),
            *summary.rows,
            ("tasks", grouped(cost.tasks)),
            *_finished(summary.left),
            ("disk", storage(cost.disk_bytes)),
            ("memory", _memory(summary)),
            ("time", f"{_expected(cost.time_s)} ({basis}){_time_left(summary.left)}"),
        ]
    )
    for one in summary.findings:
        _lines(f"warning: {one.text}", "yellow")
    for text in summary.faults:
        _lines(f"unusable: {text}", "red")


def _files(summary: "PlanSummary") -> str:
    """How many files a run can use, of how many."""
    if not summary.unusable:
        return grouped(summary.files)
    whole = grouped(summary.files + summary.unusable)
    return f"{grouped(summary.files)} of {whole}, {grouped(summary.unusable)} unusable"


def _expected(time_s: float) -> str:
    """How long the tasks take; of a small survey the rest takes longer."""
    apart = ", apart from starting workers and drawing the report"
    return expected(time_s) + apart * (time_s < TOLD_FROM_S)


def _memory(summary: "PlanSummary") -> str:
    """What the heaviest task of a plan needs, of how much."""
    sizes = (summary.cost.memory_bytes, summary.limit_bytes)
    needed, limit = (grouped(size / 2**20) for size in sizes)
    whose = f"each worker's {limit} MiB"
    if summary.shared:
        whose += " (by default, as --memory is not given)"
    return f"{needed} of {whose} for {summary.cost.heaviest}"


def _finished(left: "Left | None") -> list[tuple[str, str]]:
    """What earlier runs have finished of a plan, if anything."""
    if left is None:
        return []
    if not left.counted:
        return [("finished", f"up to {grouped(left.finished)} tasks; a run tells what is left")]
    if not left.stage:
        return [("finished", f"all {_tasks(left.finished)}; nothing is left to do")]
    behind = "" if left.stage == "report" else ", and what depends on it"
    return [
        ("finished", _tasks(left.finished)),
        ("left", f"{left.stage}: {grouped(left.tasks)} of {grouped(left.of)} tasks{behind}"),
    ]


def _tasks(count: int) -> str:
    return counted(count, "tasks")


def _time_left(left: "Left | None") -> str:
    if left is None:
        return ""
    if not left.time_s:
        return " for all of it"
    most = " at most" if left.time_s >= TOLD_FROM_S else ""
    return f" for all of it; for what is left {expected(left.time_s)}{most}"


def print_status(status: "RunStatus") -> None:
    """Print the state of the latest run."""
    _OUT.print(_whole(status))


def await_run(output: Path, every_s: float = 1.0) -> None:
    """Wait until a run has begun in a folder that is not there yet, or holds nothing else."""
    if _may_begin(output):
        say_error(f"info: no run has begun in {output} yet: waiting for one; Ctrl-C ends")
    while _may_begin(output):
        time.sleep(every_s)


def _may_begin(output: Path) -> bool:
    """Whether a run may be about to begin: nothing is there but the lock that it takes first."""
    if url_fault(output):
        return False
    try:
        return {path.name for path in output.iterdir()} <= {"store"}
    except FileNotFoundError:
        return True
    except OSError:  # a file, say, of which the command tells
        return False


def watch_status(follower: "Follower", every_s: float = 1.0) -> "RunStatus":
    """Show the state of a run until it ends; a pipe or a log gets the last one."""
    status = follower.update()
    live = Live(console=_OUT, auto_refresh=False, transient=True)
    with live if is_screen(_OUT) else nullcontext():
        while status.holder is not None and status.ended is None:
            if live.is_started:
                live.update(_whole(status), refresh=True)
            time.sleep(every_s)
            status = follower.update()
    print_status(status)
    return status


def _whole(status: "RunStatus") -> RenderableType:
    """State by stage as a table, and all else that the live view shows."""
    done = "done" if status.delivered is None else "was done"
    table = Table("stage", done, "failed", "left", "points/s", "elapsed", "time left", box=None)
    table.columns[0].no_wrap = True
    for stage in status.rows:
        table.add_row(
            stage.stage,
            f"{stage.done}/{stage.total}" if stage.total else "",
            str(stage.failed or ""),
            str(stage.left or ""),
            as_ascii(texts.large(stage.points_per_s)) if stage.points_per_s else "",
            taken(stage) if stage.elapsed_s > 0 or stage.of_earlier_runs else "",
            duration(stage.left_s) if round(stage.left_s) else "",
        )
    killed = status.ended is None and status.holder is None
    lines = (_what_it_does(status), *_store_gone(status), *_lost_lines(status))
    said = [Text(text) for text in lines]
    inputs = failed_lines(status.unusable)
    return Group(table, *said, *inputs, *details(status, working=not killed))


def _store_gone(status: "RunStatus") -> list[str]:
    """That nothing is left of what was finished but what was delivered."""
    if status.delivered is None:
        return []
    there = ", ".join(status.delivered) or "nothing"
    return [f"  its store is gone: the next run starts over; what is left here: {there}"]


def _lost_lines(status: "RunStatus") -> list[str]:
    """That the log does not tell all."""
    if not status.lost_lines:
        return []
    return [f"  {counted(status.lost_lines, 'lines')} of log.jsonl left out: cut off, or damaged"]


def _what_it_does(status: "RunStatus") -> str:
    """Whether the run works, has ended, or was killed."""
    if status.ended is not None:
        reason = status.ended.get("reason")
        return f"  ended with exit status {status.ended['exit_status']}" + (
            f": {brief(reason, LINE_MAX - 40)}" if reason else ""
        )
    if status.holder:
        who = status.holder
        return f"  working: process {who['pid']} on {who['host']}, since {who['started']}"
    if status.holder is None:
        goes_on = "continues" if status.delivered is None else "does it again"
        return f"  stopped before its end; the same command {goes_on}"
    return "  working"


def print_alone(result: "AloneResult") -> None:
    """Print what has come of a single task."""
    receipt = result.receipt
    task = f"{receipt.kind} {receipt.name}"
    if receipt.failed:
        _lines(f"failed: {task}: {receipt.reason}", "red")
    else:
        cost = f"{receipt.wall_s:.1f} s, {grouped(receipt.peak_rss_mb)} MiB"
        _lines(f"done: {task} in {cost}; the next run finds it finished")
    if result.traceback is not None:
        _path("traceback", result.traceback)


def _pairs(pairs: Sequence[tuple[str, str]]) -> None:
    """Label and value, side by side; in a pipe or a log each pair is one line, however long."""
    if not is_screen(_OUT):
        width = max((len(label) for label, _ in pairs), default=0)
        for label, value in pairs:
            _lines(f"{label:{width}}  {value}")
        return
    table = Table(box=None, show_header=False, padding=(0, 2, 0, 0))
    for label, value in pairs:
        loud = {"attention": "bold red", "failed": "red"}.get(label, "")
        table.add_row(Text(label, style=loud or "dim"), Text(value, style=loud))
    _OUT.print(table)


def _lines(text: str, style: str = "") -> None:
    """A message, in more than one line where it is long."""
    for line in screen_lines(text):
        _OUT.print(Text(line, style=style), soft_wrap=True)


def _path(label: str, *paths: Path) -> None:
    """Files that are there, in one line where they fit."""
    found = [str(path) for path in paths if path.exists()]
    rows = ["  ".join(found)]
    if len(label) + len(rows[0]) + 2 > LINE_MAX:
        rows = [line for path in found for line in wrapped(path, LINE_MAX - len(label) - 2)]
    for row in rows if found else ():
        _OUT.print(Text.assemble((label, "dim"), f"  {row}"), soft_wrap=True)
