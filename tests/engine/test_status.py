"""State of a run by its events or its log, what a view shows of them, and who works where."""

import io
import json
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from spl_batch.cli import screen, view
from spl_batch.cli.console import PlainConsole
from spl_batch.cli.document import of_status
from spl_batch.engine.store.output_lock import holder, lock_file, locked, was_stopped
from spl_batch.engine.tasks.task import Task
from spl_batch.engine.verbs.progress import end_last_line, plain_name
from spl_batch.engine.watch.events import (
    Note,
    PhaseStarted,
    RunEnded,
    RunStarted,
    TaskEnded,
    TaskSettled,
    TaskStarted,
    WorkersReady,
    WorkersSeen,
    as_record,
)
from spl_batch.engine.watch.status import Follower, RunStatus
from spl_batch.errors import WorkflowError

STARTED = RunStarted("w.yaml", 2, "0.1+x", {"denoise": 10.0, "ground": 30.0})


def ended(name: str, reason: str = "", points: int = 100) -> TaskEnded:
    return TaskEnded(
        "denoise", "denoise", name, points, 2.0, reason, 512.0, code="F04" if reason else ""
    )


def a_run() -> list[Any]:
    """Half of a denoise phase: six blocks, one was done before, one fails, one runs."""
    return [
        STARTED,
        WorkersReady("", "http://127.0.0.1:1/status"),
        PhaseStarted("denoise", "denoise", 5, 1, 500),
        TaskStarted("denoise", "denoise", "0_1", "tcp://a:1"),
        TaskStarted("denoise", "denoise", "2_1", "tcp://b:1"),
        ended("0_1"),
        WorkersSeen(2, 2, 700.0, 1024.0),
        TaskStarted("denoise", "denoise", "1_0", "tcp://a:1"),
        ended("1_0", "RuntimeError: broken"),
    ]


def records(events: Sequence[Any]) -> list[dict[str, Any]]:
    """Events as logged, two seconds one after the other."""
    found = [as_record(event) for event in events]
    for k, record in enumerate(found):
        record["time"] = f"2026-01-01T00:00:{2 * k:02d}.000+00:00"
    return found


def fed(events: Sequence[Any]) -> RunStatus:
    status = RunStatus()
    for record in records(events):
        status.feed(record)
    return status


def logged(folder: Path, events: Sequence[Any]) -> Path:
    with (folder / "log.jsonl").open("a") as log:
        log.writelines(json.dumps(record) + "\n" for record in records(events))
    return folder


def test_the_state_of_a_run_in_its_middle() -> None:
    status = fed(a_run())
    stage = status.stages["denoise"]
    assert (stage.total, stage.done, stage.found, stage.failed, stage.left) == (6, 2, 1, 1, 3)
    assert (stage.points, stage.left_points, stage.elapsed_s) == (100, 300, 12.0)
    assert stage.points_per_s == 100 / 12
    assert stage.left_s == pytest.approx(36.0)
    assert status.left_s == pytest.approx(66.0), "the ground is still to come"
    assert status.running == {("denoise", "2_1"): "denoise 2_1"}
    assert [f.task for f in status.failures] == ["denoise 1_0"]
    assert status.peak_mb == 512.0
    document = of_status(status)
    assert (document["state"], document["stages"]["denoise"]["left"]) == ("stopped", 3)


def test_tasks_that_need_no_doing_are_found_or_none_of_the_stage() -> None:
    settled = [
        TaskSettled("denoise", "denoise", name, 100, found)
        for name, found in (("a", True), ("b", False))
    ]
    stage = fed([*a_run(), *settled]).stages["denoise"]
    assert (stage.total, stage.done, stage.found, stage.left_points) == (5, 3, 2, 100)


def test_a_run_that_has_not_begun_its_work_hides_nothing() -> None:
    status = fed([*a_run(), RunEnded(1), STARTED])
    assert (status.ended, status.stages["denoise"].done) == (None, 2)
    status = fed([*a_run(), RunEnded(1), STARTED, PhaseStarted("index", "index_file", 1, 0, 5)])
    assert (status.stages["denoise"].total, status.failures) == (0, [])
    assert status.stages["index"].left == 1


def test_phases_that_begin_again_count_once() -> None:
    status = fed([*a_run(), PhaseStarted("denoise", "denoise", 2, 4, 200)])
    stage = status.stages["denoise"]
    assert (stage.total, stage.done, status.failures, stage.expected_s) == (6, 4, [], 10.0)


def test_inputs_that_cannot_be_used_are_those_of_the_latest_run() -> None:
    unusable = RunStarted("w", 2, "x", unusable=[{"path": "a.laz", "reason": "junk"}])
    assert [one.task for one in fed([unusable]).unusable] == ["a.laz"]
    assert fed([unusable, STARTED]).unusable == []


def test_the_log_is_followed_as_it_grows_from_the_latest_run_on(tmp_path: Path) -> None:
    logged(tmp_path, [*a_run(), RunEnded(1)])
    follower = Follower(logged(tmp_path, a_run()[:4]))
    assert follower.update().stages["denoise"].done == 1
    with (tmp_path / "log.jsonl").open("a") as log:
        log.write('{"event": "TaskEnded", "sta\n[]\n7\n')
    status = Follower(logged(tmp_path, a_run()[4:])).update()
    assert status.stages["denoise"].done == 2
    assert follower.update().stages["denoise"] == status.stages["denoise"]
    assert status.running == {}, "nothing works there"
    with locked(tmp_path):
        assert follower.update().holder is not None
        logged(tmp_path, a_run()[:5])
        assert len(follower.update().running) == 2


def test_a_half_line_of_a_killed_run_is_ended(tmp_path: Path) -> None:
    log = tmp_path / "log.jsonl"
    end_last_line(log)
    for content, after in (("", ""), ("{}\n", "{}\n"), ('{"a', '{"a\n')):
        log.write_text(content)
        end_last_line(log)
        assert log.read_text() == after


def test_tasks_are_called_as_a_user_calls_them() -> None:
    names = {"17": "lines/a.laz"}
    assert plain_name(Task("index_file", "17", {"source": 17}), names) == "index file lines/a.laz"
    assert plain_name(Task("mosaic", "dtm", {}), names) == "mosaic dtm"
    assert plain_name(Task("trajectory", "all", {}), names) == "trajectory"


@pytest.mark.parametrize("terminal", [True, False])
def test_a_view_draws_bars_or_prints_lines(
    monkeypatch: pytest.MonkeyPatch, *, terminal: bool
) -> None:
    out = io.StringIO()
    monkeypatch.setattr(out, "isatty", lambda: terminal)
    monkeypatch.delenv("JPY_PARENT_PID", raising=False)
    console = PlainConsole(file=out, width=100, force_terminal=terminal, force_interactive=terminal)
    with view.watching(console) as seen:
        seen.loading()
        for event in [*a_run(), Note("warning", "\x1b[31mred")]:
            seen.on_event(event)
    text = out.getvalue()
    assert ("3/6" in text, "5 tasks" in text) == (terminal, not terminal)
    assert "failed: denoise 1_0: RuntimeError: broken" in text
    assert "warning: \\x1b[31mred" in text


def test_a_screen_has_stages_failures_and_who_works() -> None:
    status = fed(a_run())
    status.holder = {"pid": 7, "host": "h", "started": "now"}
    out = io.StringIO()
    Console(file=out, width=100).print(screen._whole(status))
    for words in ("2/6", "process 7", "2 workers", "running denoise 2_1", "failed: denoise 1_0"):
        assert words in out.getvalue(), words


# The lock


def test_the_lock_names_who_has_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("spl_batch.engine.store.output_lock.PATIENCE_S", 0.1)
    assert holder(tmp_path) is None
    with locked(tmp_path) as content:
        assert lock_file(tmp_path).read_text() == content
        found = holder(tmp_path)
        assert found is not None
        assert found["pid"] == os.getpid()
        with (
            pytest.raises(WorkflowError, match=rf"{os.getpid()}"),
            locked(tmp_path),
        ):
            pass
    assert holder(tmp_path) is None
    assert not was_stopped(tmp_path)
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
    assert was_stopped(tmp_path)
    assert holder(tmp_path) is None
    with locked(tmp_path):
        pass
