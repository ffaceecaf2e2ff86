"""What is made ready beside a run: tasks wait for their own step, and a fault is reported."""

import sys
import time
from pathlib import Path

import pytest

from spl_batch.engine.flow import warm_up
from spl_batch.engine.flow.warm_up import WarmUp
from spl_batch.engine.watch.events import Compiling, Event, Note

PROCESS = """
import sys, time, pathlib

for line in sys.argv[2:]:
    while line == "wait" and not pathlib.Path(sys.argv[1]).exists():
        time.sleep(0.01)
    if line != "wait":
        print(line, flush=True)
sys.exit(sys.argv[2:] == ["wrong"])
"""
"""Writes lines, and may wait for a file between them."""


@pytest.fixture(autouse=True)
def _impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(warm_up, "PATIENCE_S", 20.0)


def two(folder: Path, first: list[str], second: list[str]) -> WarmUp:
    commands = [
        [sys.executable, "-c", PROCESS, str(folder / "go"), *one] for one in (first, second)
    ]
    return WarmUp(
        lambda number, _: commands[number],
        ["index", "denoise"],
        "compiling",
        folder / "a-1.ready",
        2,
    )


def test_tasks_wait_for_their_own_step_alone(tmp_path: Path) -> None:
    events: list[Event] = []
    one = two(tmp_path, ["0 2 0 1", "2 2 2 2"], ["0 2 0 0", "0 2 0 1", "wait", "2 2 1 2"])
    one.begin(events.append)
    one.wait_for("report")  # for which nothing is made ready
    one.wait_for("index")
    (tmp_path / "go").touch()
    one.wait_for("denoise")
    one.finish()
    assert one.made == 3
    assert one.waited_s
    assert (events[0], events[-1]) == (Note("info", "compiling"), Compiling(4, 4))
    assert {event.of for event in events[1:] if isinstance(event, Compiling)} == {4}, "no growth"
    assert one.mark.exists()
    one.begin(events.append)
    one.wait_for("denoise")
    assert (one.made, one.waited_s) == (0, None), "nobody waits for what is ready"


def test_what_finds_all_ready_reports_nothing(tmp_path: Path) -> None:
    events: list[Event] = []
    one = two(tmp_path, ["0 2 0 1", "2 2 0 2"], ["2 2 0 2"])
    one.begin(events.append)
    one.wait_for("denoise")
    one.finish()
    assert (events, one.waited_s, one.mark.exists()) == ([], None, True)


def test_a_fault_is_reported_and_the_tasks_begin(tmp_path: Path) -> None:
    events: list[Event] = []
    one = two(tmp_path, ["wrong"], ["0 2 0 1", "2 2 1 2"])
    one.begin(events.append)
    one.wait_for("denoise")
    one.finish()
    assert Note("info", "compiling: wrong") in events
    assert not one.mark.exists()


def test_processes_that_are_ended_begin_again(tmp_path: Path) -> None:
    events: list[Event] = []
    one = two(tmp_path, ["0 2 0 0", "wait"], ["0 2 0 0", "wait"])
    one.begin(events.append)
    one.begin(events.append)
    begin_s = time.monotonic()
    one.end()
    assert time.monotonic() - begin_s < 0.5 * warm_up.PATIENCE_S, "they were killed"
    assert (events, one.mark.exists()) == ([], False)
    (tmp_path / "go").touch()
    one.begin(events.append)
    one.finish()
    assert one.mark.exists()


def test_a_process_that_hangs_is_waited_for_once_and_one_that_dies_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(warm_up, "PATIENCE_S", 1.0)
    events: list[Event] = []
    one = two(tmp_path, ["0 2 0 0", "wait"], ["0 2 0 0", "wait"])
    begin_s = time.monotonic()
    one.begin(events.append)
    for _ in range(5):
        one.wait_for("index")
    assert time.monotonic() - begin_s < 3.0
    one._shares[0].child.kill()
    monkeypatch.setattr(one, "_deadline_s", time.monotonic() + 20.0)
    one._wait(lambda share: share.heard or share is one._shares[1])
    assert events == [Note("info", "compiling: ended by signal 9")]
    one.end()


def test_what_cannot_be_started_is_left_to_the_tasks(tmp_path: Path) -> None:
    events: list[Event] = []
    one = WarmUp(lambda *_: [str(tmp_path / "none")], ["index"], "compiling", tmp_path / "a-b.x", 2)
    one.begin(events.append)
    one.wait_for("index")
    one.end()
    assert [type(event) for event in events] == [Note]


def test_marks_of_other_code_go(tmp_path: Path) -> None:
    for name in ("old-1.x", "a-1.x", "a-1.y"):
        (tmp_path / name).touch()
    WarmUp(lambda *_: ["/none"], ["index"], "compiling", tmp_path / "a-2.x", 1).begin()
    assert {path.name for path in tmp_path.iterdir()} == {"a-1.x", "a-1.y"}
