"""What is told of a run while it works: state, log, screen; and who works where."""

import io
import json
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from rich.console import Console
from spl_batch.cli.clock import saying_if_slow
from spl_batch.engine.watch.earlier_runs import earlier_wall_s
from spl_batch.engine.watch.log_follower import Follower
from spl_batch.engine.watch.progress import end_last_line

from spl_batch import api, cli
from spl_batch.cli import document, live, screen, view, watching
from spl_batch.engine.store.output_lock import holder, lock_file, locked
from spl_batch.engine.store.working_store import IDENTITY, Store, write_receipt
from spl_batch.engine.tasks.task import Receipt, Task
from spl_batch.engine.verbs.failures import plain_name
from spl_batch.engine.watch.events import (
    Note,
    PhaseStarted,
    ReportStarted,
    RunEnded,
    RunStarted,
    TaskEnded,
    TaskStarted,
    WorkersReady,
    WorkersSeen,
    as_record,
)
from spl_batch.engine.watch.status import RunStatus, StageStatus
from spl_batch.errors import WorkflowError
from tests import surveys


def ended(name: str, reason: str = "", kind: str = "denoise", points: int = 100) -> TaskEnded:
    return TaskEnded("denoise", kind, name, points, 2.0, reason, 512.0, "spl-batch x")


def a_run() -> list[Any]:
    """Half of a denoise phase: six blocks, one was done before, one fails, one runs."""
    return [
        RunStarted("w.yaml", 2, "0.1+x", {"denoise": 10.0, "ground": 30.0}),
        WorkersReady("", "http://127.0.0.1:1/status"),
        PhaseStarted("denoise", "denoise", 5, 1, 500),
        TaskStarted("denoise", "denoise", "0_1", "tcp://a:1"),
        TaskStarted("denoise", "denoise", "2_1", "tcp://b:1"),
        ended("0_1"),
        WorkersSeen(2, 2, 700.0, 1024.0),
        TaskStarted("denoise", "denoise", "1_0", "tcp://a:1"),
        ended("1_0", "RuntimeError: broken"),
    ]


def fed(events: Sequence[Any]) -> RunStatus:
    status = RunStatus()
    for event in events:
        status.feed(as_record(event))
    return status


def drawn(thing: Any, **options: Any) -> str:
    out = io.StringIO()
    Console(file=out, width=100, **options).print(thing)
    return out.getvalue()


# The state


def test_the_state_of_a_run_in_its_middle() -> None:
    status = fed(a_run())
    stage = status.stages["denoise"]
    assert (stage.total, stage.done, stage.failed, stage.left) == (6, 2, 1, 3)
    assert (stage.points, stage.left_points) == (100, 300)
    assert status.running == {("denoise", "2_1"): "tcp://b:1"}
    assert [f.task for f in status.failures] == ["denoise 1_0"]
    assert status.peak_mb == 512.0
    assert status.left_s >= 30.0, "the ground is still to come"
    text = drawn(live.draw(status), no_color=True)
    for words in (
        "3/6",
        "2 workers, 2 threads; most memory 700 of 1 024 MiB",
        "running denoise 2_1",
        "failed: denoise 1_0: RuntimeError: broken",
        "http://127.0.0.1:1/status",
        "time left",
    ):
        assert words in text, words
    status.feed(as_record(RunEnded(1)))
    assert status.running == {}
    assert "time left" not in drawn(live.draw(status))
    assert " 0 s left" not in drawn(live.draw(status)), "what is unknown is no 0"
    status.feed(as_record(RunStarted("w.yaml", 2, "0.1+x")))
    assert (status.ended, status.stages["denoise"].done) == (None, 2), "nothing is known anew"
    status.feed(as_record(PhaseStarted("index", "index_file", 1, 0, 5)))
    assert (status.stages["denoise"].total, status.failures) == (0, [])
    assert status.stages["index"].left == 1, "a new run starts from nothing"


def test_what_is_done_beside_a_later_stage_is_still_to_come() -> None:
    expected = {"surfaces": 500.0, "deliver": 60.0, "report": 7.0}
    status = fed(
        [
            RunStarted("w.yaml", 2, "0.1+x", expected),
            PhaseStarted("surfaces", "surface", 0, 4, 0),
            PhaseStarted("deliver", "deliver_file", 3, 0, 300),
            PhaseStarted("report", "reference", 1, 0, 10),
        ]
    )
    assert status.left_s == pytest.approx(67.0)
    status.feed(as_record(TaskEnded("report", "reference", "1", 10, 1.0, "", 9.0)))
    assert status.left_s == pytest.approx(60.0), "surfaces were found finished"


def test_the_rate_is_that_of_all_workers_together() -> None:
    records = [as_record(event) for event in a_run()]
    for k, record in enumerate(records):
        record["time"] = f"2026-01-01T00:00:{2 * k:02d}.000+00:00"
    status = RunStatus()
    for record in records:
        status.feed(record)
    stage = status.stages["denoise"]
    assert stage.elapsed_s == 2 * (len(records) - 3)
    assert stage.points_per_s == 100 / stage.elapsed_s
    assert stage.left_s == 300 / stage.points_per_s


def test_tasks_without_points_are_foretold_by_those_that_ended() -> None:
    stage = StageStatus("report", total=6, done=5, found=1, points=100, points_to_do=100)
    stage.began_s, stage.latest_s = 1000.0, 1360.0
    assert stage.left_s == 90.0, "four took 6 min, one is left"
    stage.done, stage.found, stage.expected_s = 1, 1, 30.0
    assert stage.left_s == 25.0, "nothing has ended: what was expected"


def test_no_time_left_is_told_where_none_is_known() -> None:
    began = [
        RunStarted("w.yaml", 2, "0.1+x"),
        PhaseStarted("index", "index_file", 2, 0, 0),
        TaskStarted("index", "index_file", "1", "tcp://a:1"),
    ]
    assert "time left" not in drawn(live.draw(fed(began)))
    small = [RunStarted("w.yaml", 2, "0.1+x", {"index": 0.2}), *began[1:]]
    assert "time left" not in drawn(live.draw(fed(small))), "it was 'about 0 s'"


def test_nothing_is_left_once_the_report_is_written() -> None:
    events = [
        RunStarted("w.yaml", 2, "0.1+x", {"deliver": 60.0}, phases={"deliver": 2}),
        PhaseStarted("deliver", "deliver file", 1, 0, 0),
        TaskEnded("deliver", "deliver file", "a", 0, 1.0, "", 9.0),
    ]
    assert fed(events).left_s > 50.0  # a phase that a small survey goes without is still awaited
    assert fed([*events, ReportStarted()]).left_s == 0.0


def test_first_tasks_that_compile_do_not_foretell_the_rest() -> None:
    stage = StageStatus("denoise", total=100, left_points=10_000, points_to_do=10_000)
    stage.began_s, stage.latest_s, stage.expected_s = 1000.0, 1000.0, 50.0
    assert stage.left_s == 50.0
    stage.done, stage.points, stage.left_points, stage.latest_s = 1, 100, 9_900, 1060.0
    own_s = 9_900 / (100 / 60)
    assert stage.left_s == pytest.approx(0.05**2 * own_s + (1 - 0.05**2) * 49.5), (
        "one task took a minute"
    )
    stage.done, stage.points, stage.left_points, stage.latest_s = 20, 2_000, 8_000, 1070.0
    assert stage.left_s == 8_000 / (2_000 / 70)


def test_tasks_are_called_as_a_user_calls_them() -> None:
    names = {"7": "lines/a.laz"}
    for kind, name, args, called in (
        ("index_file", "7", {"source": "7"}, "index file lines/a.laz"),
        ("index_part", "7-3", {"source": "7", "part": 3}, "index part lines/a.laz 3"),
        ("deliver_file", "7", {}, "deliver file lines/a.laz"),
        ("trajectory", "all", {}, "trajectory"),
        ("denoise", "1_0", {}, "denoise 1_0"),
    ):
        assert plain_name(Task(kind, name, args), names) == called
    events = [*a_run(), TaskStarted("index", "index_file", "7", "tcp://b:1", "index file a.laz")]
    assert "running denoise 2_1, index file a.laz" in drawn(live.draw(fed(events)))


def test_of_a_killed_run_nothing_is_shown_as_running(tmp_path: Path) -> None:
    records = [as_record(event) for event in a_run()]
    (tmp_path / "log.jsonl").write_text("".join(json.dumps(r) + "\n" for r in records))
    found = Follower(tmp_path).update()
    assert (found.running, found.holder, found.ended) == ({}, None, None)


def test_what_was_finished_as_a_run_was_stopped_is_done(tmp_path: Path) -> None:
    records = [as_record(event) for event in (*a_run(), RunEnded(3, "interrupted"))]
    (tmp_path / "log.jsonl").write_text("".join(json.dumps(r) + "\n" for r in records))
    store, name = Store(tmp_path), "2_1"  # which runs, as far as the log tells
    began = Follower(tmp_path).update()
    path = store.receipt("denoise", name)

    def done_now(reason: str, seconds: float) -> tuple[int, int]:
        receipt = Receipt("denoise", name, "k", "d", reason, {}, {}, 100, 2.0, 512.0)
        write_receipt(store, receipt)
        os.utime(path, (began.kinds["denoise"] + seconds,) * 2)
        stage = Follower(tmp_path).update().stages["denoise"]
        return stage.done, stage.left

    before = (began.stages["denoise"].done, began.stages["denoise"].left)
    assert done_now("", -60.0) == before, "of an earlier run, to be done again"
    assert done_now("why", 5.0) == before
    assert done_now("", 5.0) == (before[0] + 1, before[1] - 1)
    follower = Follower(tmp_path)
    follower.update()
    status = follower.update()
    assert status.stages["denoise"].done == before[0] + 1, "counted once"
    assert status.stages["denoise"].latest_s == began.kinds["denoise"] + 5.0


# The log


def test_the_log_is_followed_as_it_grows_from_the_latest_run_on(tmp_path: Path) -> None:
    with pytest.raises(WorkflowError, match=r"no log\.jsonl"):
        Follower(tmp_path)
    log = tmp_path / "log.jsonl"
    lines = [json.dumps(as_record(event)) + "\n" for event in a_run()]
    log.write_text("".join(lines) + '{"event": "TaskEn')
    end_last_line(log)
    end_last_line(log)
    with log.open("a") as stream:
        stream.write("".join(lines[:3]))
        stream.flush()
        follower = Follower(tmp_path)
        status = follower.update()
        assert (status.stages["denoise"].total, status.stages["denoise"].done) == (6, 1)
        stream.write("".join(lines[3:6]) + lines[6][:20])
        stream.flush()
        assert follower.update().stages["denoise"].done == 2
        assert status.workers == {}
        stream.write(lines[6][20:])
    assert follower.update().workers["workers"] == 2
    assert follower.update().stages["denoise"].done == 2, "no line is counted twice"
    end_last_line(tmp_path / "none.jsonl")


def test_status_says_whether_a_run_works_ended_or_was_killed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = tmp_path / "log.jsonl"
    log.write_text("".join(json.dumps(as_record(event)) + "\n" for event in a_run()))
    (tmp_path / "store" / "receipts").mkdir(parents=True)
    with locked(tmp_path):
        said = surveys.command("status", tmp_path).out
        assert f"working: process {os.getpid()} on {socket.gethostname()}" in said
        waits = []

        def end(_: float) -> None:
            waits.append(1)
            with log.open("a") as stream:
                stream.write(json.dumps(as_record(RunEnded(3, "disk full"))) + "\n")

        monkeypatch.setattr(screen.time, "sleep", end)
        surveys.command("status", tmp_path, "--watch")
        assert waits == [1], "until the run ends"
    assert "ended with exit status 3: disk full" in surveys.command("status", tmp_path).out
    log.write_text("".join(json.dumps(as_record(event)) + "\n" for event in a_run()))
    said = surveys.command("status", tmp_path).out
    assert "stopped before its end; the same command continues" in said
    assert "time left about" not in said
    assert "failed: denoise 1_0" in said


def test_status_says_what_is_left_where_the_store_is_gone(tmp_path: Path) -> None:
    """Outputs that were delivered stay; what a run finds finished is in the store alone."""
    log = tmp_path / "log.jsonl"
    events = [*a_run(), RunEnded(0)]
    log.write_text("".join(json.dumps(as_record(event)) + "\n" for event in events))
    (tmp_path / "dtm.tif").touch()
    (tmp_path / "laz").mkdir()
    receipts = tmp_path / "store" / "receipts"
    receipts.mkdir(parents=True)
    assert api.status(tmp_path).delivered is None
    assert "gone" not in surveys.command("status", tmp_path).out
    shutil.rmtree(receipts.parent)
    assert api.status(tmp_path).delivered == ("dtm.tif", "laz")
    said = surveys.command("status", tmp_path).out
    assert "was done" in said.splitlines()[0]
    assert "ended with exit status 0" in said
    assert "its store is gone: the next run starts over; what is left here: dtm.tif, laz" in said
    with locked(tmp_path):
        assert api.status(tmp_path).delivered is None, "a run works there"
    assert api.status(tmp_path).delivered == ("dtm.tif", "laz"), "a lock vouches for nothing"
    (tmp_path / "store" / IDENTITY).touch()
    assert api.status(tmp_path).delivered is None, "the store lies elsewhere"
    (tmp_path / "store" / IDENTITY).unlink()
    log.write_text("".join(json.dumps(as_record(event)) + "\n" for event in a_run()))
    said = surveys.command("status", tmp_path).out
    assert "stopped before its end; the same command does it again" in said
    log.write_text("".join(json.dumps(as_record(event)) + "\n" for event in a_run()[:2]))
    assert api.status(tmp_path).delivered is None, "nothing was finished"


def test_a_run_that_never_began_its_work_hides_nothing(tmp_path: Path) -> None:
    log = tmp_path / "log.jsonl"
    failed = [RunStarted("w.yaml", 2, "code"), RunEnded(3, "no answer")]
    log.write_text("".join(json.dumps(as_record(event)) + "\n" for event in [*a_run(), *failed]))
    shown = api.status(tmp_path)
    assert shown.ended is not None
    assert shown.ended["reason"] == "no answer"
    assert shown.stages["denoise"].done > 0
    assert shown.running == {}, "nobody works there"
    with log.open("a") as stream:
        for event in (
            RunStarted("w.yaml", 2, "code"),
            PhaseStarted("index", "index_file", 4, 0, 9),
        ):
            stream.write(json.dumps(as_record(event)) + "\n")
    assert api.status(tmp_path).stages["denoise"].done == 0, "a run that works speaks for itself"


def test_inputs_that_cannot_be_used_are_failures_of_the_latest_run(tmp_path: Path) -> None:
    bad = [{"path": "cut.laz", "reason": "ends within a point"}]
    log = tmp_path / "log.jsonl"

    def told(*events: Any) -> tuple[str, list[Any]]:
        log.write_text("".join(json.dumps(as_record(event)) + "\n" for event in events))
        document = json.loads(surveys.command("status", tmp_path, "--json").out)
        return surveys.command("status", tmp_path).out, document["failures"]

    worked = [*a_run()[1:], RunEnded(1)]
    page, failures = told(RunStarted("w.yaml", 2, "code", unusable=bad), *worked)
    assert "failed: cut.laz: ends within a point" in page
    assert [one["task"] for one in failures] == ["cut.laz", "denoise 1_0"]
    idle = [PhaseStarted("index", "index_file", 0, 4, 0), RunEnded(1)]
    started = RunStarted("w.yaml", 2, "code", unusable=bad)
    assert told(*a_run(), started, *idle)[1][0]["task"] == "cut.laz"
    working = PhaseStarted("index", "index_file", 4, 0, 9)
    assert [f["task"] for f in told(*a_run(), started, working)[1]] == ["cut.laz"]
    assert "cut.laz" not in told(started, *worked, RunStarted("w.yaml", 2, "code"), *idle)[0]


def test_a_run_with_nothing_to_do_leaves_the_times_of_those_that_worked(tmp_path: Path) -> None:
    """As after ``compare``, which asks for the stages that its filters share."""
    events = [*a_run(), ReportStarted(), RunEnded(0), RunStarted("w.yaml", 2, "code")]
    events += [PhaseStarted("index", "index_file", 0, 4, 0), RunEnded(0)]
    records = [as_record(event) for event in events]
    for k, record in enumerate(records):
        record["time"] = f"2026-01-01T00:00:{2 * k:02d}.000+00:00"
    log = tmp_path / "log.jsonl"
    log.write_text("".join(json.dumps(r) + "\n" for r in records))
    shown = api.status(tmp_path)
    assert (shown.stages["denoise"].elapsed_s, shown.stages["denoise"].total) == (12.0, 6)
    assert (shown.page.done, shown.page.elapsed_s) == (1, 2.0), "not to the end of the idle run"
    assert shown.stages["report"].total == 0, "no task of the report's, which counts none either"
    assert shown.ended is not None
    assert shown.ended["exit_status"] == 0
    assert shown.stages["index"].total == 0


def test_a_stage_that_was_finished_before_says_so(tmp_path: Path) -> None:
    events = [*a_run(), RunStarted("w.yaml", 2, "code")]
    events += [PhaseStarted("index", "index_file", 0, 4, 0)]
    events += [
        PhaseStarted("shots", "gather", 2, 0, 10),
        TaskEnded("shots", "gather", "1", 5, 2.0, ""),
    ]
    log = tmp_path / "log.jsonl"
    log.write_text("".join(json.dumps(as_record(event)) + "\n" for event in events))
    shown = api.status(tmp_path)
    assert (shown.stages["index"].done, shown.stages["denoise"].points) == (4, 0)
    rows = {line.split()[0]: line for line in drawn(screen._whole(shown)).splitlines() if line}
    assert "4/4" in rows["index"]
    assert "done before" in rows["index"]
    assert "done before" not in rows["shots"]


# The screen


class Screen(io.StringIO):
    """A text that says it is a terminal."""

    def isatty(self) -> bool:
        return True


def test_a_terminal_sees_stages_and_a_log_plain_lines(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TERM", "xterm-256color")
    out = Screen()
    terminal = Console(file=out, color_system="256", width=100, height=40)
    monkeypatch.setattr(watching, "_ERR", terminal)
    with watching.watching() as shown:
        shown.simulated(0.5)
        for event in a_run():
            shown.on_event(event)
        assert "running denoise 2_1" in drawn(shown.draw())
        shown.on_event(Note("warning", "look out"))
    assert "warning: look out" in out.getvalue()
    assert "running" not in drawn(shown.draw()), "the stages stay, what works goes"
    plain = Console(file=io.StringIO(), width=100)
    monkeypatch.setattr(watching, "_ERR", plain)
    with watching.watching() as shown:
        monkeypatch.setattr(view, "LINE_S", -1.0)
        for event in a_run():
            shown.on_event(event)
    assert isinstance(plain.file, io.StringIO)
    lines = plain.file.getvalue().splitlines()
    assert "denoise: denoise: 5 tasks, 1 finished before" in lines
    assert "failed: denoise 1_0: RuntimeError: broken" in lines
    assert any(line.startswith("denoise: 2/6") for line in lines)
    assert "\x1b" not in plain.file.getvalue()


def test_colours_that_are_forced_make_no_screen_of_a_pipe(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("TERM", "xterm-256color")
    monkeypatch.setenv("FORCE_COLOR", "1")  # as a notebook does for the commands of its cells
    for module, name in ((watching, "_ERR"), (screen, "_OUT")):
        monkeypatch.setattr(module, name, Console(file=io.StringIO(), width=100))
    with watching.watching() as shown:
        for event in a_run():
            shown.on_event(event)
        shown.on_event(Note("warning", "look out"))
    here = {"pid": 1, "host": "here", "started": "now"}
    states = [replace(fed(a_run()), holder=here), fed([*a_run(), RunEnded(0)])]
    follower = SimpleNamespace(update=lambda: states.pop(0))
    screen.watch_status(cast("api.Follower", follower), every_s=0.0)
    for console in (watching._ERR, screen._OUT):
        text = cast("io.StringIO", console.file).getvalue()
        assert text.strip()
        codes = set(re.findall(r"\x1b\[[0-9;?]*([A-Za-z])", text))
        assert codes <= {"m"}, "colours, and nothing that moves a cursor or clears a line"


def test_a_view_says_what_goes_on_where_no_task_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = 1000.0
    monkeypatch.setattr(view.time, "time", lambda: clock)
    shown = view.View(Console(file=io.StringIO()))
    assert "getting ready" not in drawn(shown.draw()), "not at once"
    clock += 7
    assert "getting ready, 7 s" in drawn(shown.draw())
    for event in a_run():
        shown.on_event(event)
    clock += 7
    assert "getting ready" not in drawn(shown.draw()), "a task runs"
    shown.on_event(ended("2_1"))
    shown.on_event(ReportStarted())
    clock += 3
    assert "writing the report, 3 s" in drawn(shown.draw())
    shown.on_event(RunEnded(0))
    (row,) = [line for line in drawn(shown.draw()).splitlines() if "1/1" in line]
    assert row.split()[0] == "page", "the report is written"


def test_the_clock_of_a_task_at_work_goes_on_and_its_rate_stays(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    clock = time.time() + 60.0
    monkeypatch.setattr(view.time, "time", lambda: clock)
    shown = view.View(Console(file=io.StringIO()))
    for event in a_run():
        shown.on_event(event)
    stage = shown._status.stages["denoise"]
    stage.began_s -= 10.0
    rate, left_s, index = stage.points_per_s, stage.left_s, shown._status.stages["index"]
    before = drawn(shown.draw())
    first_s, left_first_s = stage.elapsed_s, stage.left_s
    clock += 7.0
    assert drawn(shown.draw()) != before, "nothing was heard in between"
    assert stage.elapsed_s == pytest.approx(first_s + 7.0)
    assert stage.points_per_s == rate
    assert left_first_s <= left_s
    assert stage.left_s == pytest.approx(max(left_first_s - 7.0, 0.0))
    assert index.elapsed_s == 0.0, "no task of it works"


def test_a_screen_is_drawn_anew_while_nothing_is_heard(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TERM", "xterm-256color")
    out = Screen()
    monkeypatch.setattr(watching, "_ERR", Console(file=out, width=60, height=40))
    with watching.watching() as shown:
        for event in a_run():
            shown.on_event(event)
        seen = len(out.getvalue())
        until_s = time.monotonic() + 10.0
        while len(out.getvalue()) == seen and time.monotonic() < until_s:
            time.sleep(0.05)
    assert len(out.getvalue()) > seen


def test_a_command_that_is_stopped_or_slow_writes_nothing_amid_the_stages(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("TERM", "xterm-256color")
    out = Screen()
    monkeypatch.setattr(watching, "_ERR", Console(file=out, width=60, height=40))

    def interrupted() -> None:
        with watching.watching() as shown:
            for event in a_run():
                shown.on_event(event)
            with saying_if_slow("loading", after_s=0.0):
                time.sleep(0.2)
            with pytest.raises(KeyboardInterrupt):
                signal.raise_signal(signal.SIGINT)
            assert "stopping" in drawn(shown.draw())
        assert "stopping" not in drawn(shown.draw())

    with cli._ended_in_order(threading.Event(), "stopping"):
        interrupted()
    assert capfd.readouterr().err == "", "it would appear amid the lines of the view"
    assert "info: loading" in out.getvalue()


def test_stages_keep_their_names_on_a_narrow_screen() -> None:
    stages = [
        StageStatus(name, 4_000_000, 1_000_000, points=10**9, left_points=3 * 10**9,
                    points_to_do=4 * 10**9, began_s=1000.0, latest_s=9000.0)
        for name in ("surfaces", "denoise", "simulate")
    ]  # fmt: skip
    for width in (60, 120):
        out = io.StringIO()
        Console(file=out, width=width).print(live.bars(stages))
        lines = out.getvalue().splitlines()
        assert [line.split()[0] for line in lines] == [stage.stage for stage in stages]


def test_what_was_done_before_has_no_time_left() -> None:
    started = RunStarted("w.yaml", 2, "0.1+x", {"deliver": 2.0}, phases={"deliver": 2})
    status = fed([started, PhaseStarted("deliver", "deliver_file", 0, 3, 0)])
    status.feed(as_record(PhaseStarted("report", "reference", 1, 0, 0)))
    stage = status.stages["deliver"]
    assert stage.of_earlier_runs
    assert stage.left_s == 0.0


def test_a_run_tells_what_it_begins_and_how_it_ends(small: Path) -> None:
    surveys.run(small, until="denoise")
    records = [json.loads(x) for x in (small.parent / "out/log.jsonl").read_text().splitlines()]
    by_name: dict[str, list[Any]] = {}
    for record in records:
        by_name.setdefault(record["event"], []).append(record)
    began = [(r["kind"], r["name"]) for r in by_name["TaskStarted"]]
    assert began == [(r["kind"], r["name"]) for r in by_name["TaskEnded"]]
    assert by_name["RunEnded"] == [records[-1]]
    assert records[-1]["exit_status"] == 0
    assert set(by_name["RunStarted"][0]["expected_s"]) >= {"index", "denoise", "deliver"}
    ended = surveys.command("run", small, "--workers", 0, "--set", "filter.method=nothing")
    assert ended.status == 2
    assert api.status(small.parent / "out").stages["denoise"].left == 0


# The lock


def test_the_lock_says_who_has_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("spl_batch.engine.store.output_lock.PATIENCE_S", 0.1)
    assert holder(tmp_path) is None
    with locked(tmp_path) as content:
        assert lock_file(tmp_path).read_text() == content
        found = holder(tmp_path)
        assert found is not None
        assert found["pid"] == os.getpid()
        with (
            pytest.raises(WorkflowError, match=rf"process {os.getpid()}, since 20.*wait for it"),
            locked(tmp_path),
        ):
            pass
    assert holder(tmp_path) is None
    with locked(tmp_path) as other:
        assert other != content, "no two runs have the same mark"


def test_the_lock_of_a_killed_process_is_free(tmp_path: Path) -> None:
    code = (
        "import os, pathlib, signal, sys\n"
        "from spl_batch.engine.store.output_lock import locked\n"
        "with locked(pathlib.Path(sys.argv[1])):\n"
        "    os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    subprocess.run([sys.executable, "-c", code, str(tmp_path)], check=False)  # noqa: S603
    assert "pid" in lock_file(tmp_path).read_text()
    assert holder(tmp_path) is None
    with locked(tmp_path):
        pass


# Night after night


def test_another_flightline_redoes_what_it_touches_alone(tmp_path: Path) -> None:
    far = (surveys.ORIGIN_M[0] + 1000.0, surveys.ORIGIN_M[1])
    for psid, origin in ((1, surveys.ORIGIN_M), (2, far)):
        line = surveys.flightline(
            shots=60, psid=psid, seed=psid, start_s=surveys.START_S + 3 * psid, origin_m=origin
        )
        surveys.write_cloud(tmp_path / f"lines/{psid}.laz", line)
    trajectory = tmp_path / "trajectory.csv"
    surveys.write_trajectory(trajectory, stop_s=surveys.START_S + 100)
    settings = ("ground.cell_m=100", "tiling.block_tiles=1")
    workflow = surveys.write_workflow(tmp_path)
    surveys.run(workflow, *settings)
    near = (surveys.ORIGIN_M[0] + 1.0, surveys.ORIGIN_M[1] + 1.0)
    line = surveys.flightline(
        shots=60, psid=3, seed=3, start_s=surveys.START_S + 200, origin_m=near
    )
    surveys.write_cloud(tmp_path / "lines/3.laz", line)
    surveys.write_trajectory(trajectory, stop_s=surveys.START_S + 210)
    events: list[Any] = []
    result = surveys.run(workflow, *settings, listener=events.append)
    assert result.exit_status == 0
    done: dict[str, set[str]] = {}
    for event in events:
        if isinstance(event, TaskEnded):
            done.setdefault(event.kind, set()).add(event.name)
    skipped = {e.kind: e.skipped for e in events if isinstance(e, PhaseStarted)}
    for kind in ("index_file", "gather", "fit_line", "scatter"):
        assert len(done[kind]) == 1, kind
        assert skipped[kind] == 2, kind
    for kind in ("build_tile", "denoise", "ground", "surface"):
        columns = {int(name.split("_")[0]) for name in done[kind]}
        assert columns <= {2719, 2720}, f"{kind}: the place a kilometre away stays"
        assert skipped[kind] > 0, kind
    assert len(done["deliver_file"]) == 2
    clean = surveys.run(surveys.copy_of(workflow, tmp_path / "clean"), *settings, until="deliver")
    assert surveys.results(result.output) == surveys.results(clean.output)


def test_a_damaged_log_is_told_and_leads_to_no_traceback(
    small_output: Path, tmp_path: Path
) -> None:
    shutil.copytree(small_output, tmp_path, dirs_exist_ok=True)
    content = (tmp_path / "log.jsonl").read_bytes()
    dice, told = np.random.default_rng(3), 0
    for place, bit in dice.integers((len(content), 8), size=(200, 2)):
        damaged = bytearray(content)
        damaged[place] ^= 1 << int(bit)
        (tmp_path / "log.jsonl").write_bytes(damaged)
        told += bool(api.status(tmp_path).lost_lines)
        earlier_wall_s(tmp_path)
    assert told > 20
    for stage in (b"surfaces", b"deliver"):
        lost = content.replace(
            b'"PhaseStarted", "stage": "' + stage, b'"PhaseStarted"; "stage": "' + stage
        )
        (tmp_path / "log.jsonl").write_bytes(lost)
        assert surveys.command("status", tmp_path).status == 0
        assert api.status(tmp_path).left_s is not None
    (tmp_path / "log.jsonl").write_bytes(content.replace(b'"kind"', b'"kidn"'))
    assert "of log.jsonl left out: cut off, or damaged" in surveys.command("status", tmp_path).out


WRONG = (
    "\x1b[31m<b>", "0001-01-01", 1e308, float("nan"), -1, 10**30, None, True, [], [[1]], {"a": [1]},
    {"total": [[1]], "done": [[0]]}, [{"path": 1}],
)  # fmt: skip
"""What a line of a log may hold where a run wrote something else."""


def test_lines_with_wrong_values_lead_to_no_traceback(tmp_path: Path) -> None:
    events = [*a_run(), WorkersSeen(2, 4, 700.0, 900.0), ReportStarted(), RunEnded(1, "")]
    events.append(RunStarted("w", 2, "1", {"index": 3.0}, ("index",), {"index": 1}, unusable=[{}]))
    records = [as_record(event) for event in events]
    tried = 0
    for number, record in enumerate(records):
        if record["event"] in {one["event"] for one in records[:number]}:
            continue
        for field in record:
            spoilt = [{**record, field: value} for value in WRONG]
            for one in (*spoilt, {k: v for k, v in record.items() if k != field}):
                lines = [*records[:number], one, *records[number + 1 :]]
                log = "".join(json.dumps(line) + "\n" for line in lines)
                (tmp_path / "log.jsonl").write_text(log)
                found = api.status(tmp_path)
                assert max(map(len, repr(found).splitlines())) < 1000
                if not found.lost_lines:
                    drawn(live.draw(found))
                    document.of_status(found)
                earlier_wall_s(tmp_path)
                tried += 1
    assert tried > 600
