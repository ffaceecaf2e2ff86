"""The time that is printed is that from Enter to prompt, and nothing is silent for long."""

import io
import re
import shlex
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from rich.console import Console
from spl_batch.cli.clock import CommandClock, process_age_s, saying_if_slow

from spl_batch import api
from spl_batch.cli import screen, view, watching
from spl_batch.cli.console import is_screen
from spl_batch.engine.verbs import simulation
from spl_batch.engine.watch.events import (
    Compiling,
    PhaseStarted,
    RunStarted,
    TaskStarted,
)
from tests import surveys


def test_the_age_of_a_process_counts_from_its_start() -> None:
    code = "import time as t; t.sleep(0.5); from spl_batch.cli import clock as c; "
    code += "print(c.process_age_s())"
    began = time.monotonic()
    ended = subprocess.run(  # noqa: S603
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert 0.5 < float(ended.stdout) <= time.monotonic() - began + 0.05
    assert process_age_s() > 0
    assert CommandClock(100.0).took_s >= 100.0


def test_a_run_prints_the_time_of_the_whole_command(small: Path) -> None:
    surveys.run(small)
    began = time.monotonic()
    ended = subprocess.run(  # noqa: S603
        [sys.executable, "-m", "spl_batch", "run", str(small), "--workers", "0"],
        capture_output=True,
        text=True,
        check=True,
    )
    whole_s = time.monotonic() - began
    match = re.search(r"^time +([0-9.]+) s for the whole command", ended.stdout, re.MULTILINE)
    assert match, ended.stdout
    assert 0.8 * whole_s < float(match[1]) <= whole_s + 0.1
    looked = re.search(r"looked at in ([0-9.]+) s", ended.stdout)
    assert looked
    assert float(match[1]) > float(looked[1]) + 0.2, "imports count"
    assert "run time" in ended.stdout


def python(code: str) -> subprocess.CompletedProcess[str]:
    """Run the command line in a process of its own, after some code."""
    command = "import sys; from spl_batch.cli import main; sys.argv = ['spl-batch', '--version']; "
    return subprocess.run(  # noqa: S603
        [sys.executable, "-c", f"{command}{code}; main()"],
        capture_output=True,
        text=True,
        check=False,
    )


def test_a_command_that_leaves_at_once_loses_nothing() -> None:
    ended = python("import atexit; atexit.register(print, 'closed')")
    assert (ended.returncode, ended.stderr) == (0, "")
    assert ended.stdout.startswith("spl-batch, version")
    assert ended.stdout.endswith("closed\n")
    slow = "import threading, time; work = lambda: (time.sleep(1.5), print('finished'))"
    ended = python(f"{slow}; threading.Thread(target=work).start()")
    assert ended.stdout.endswith("finished\n"), "a thread that is at work is waited for"


@pytest.mark.parametrize("closed", [">&-", "2>&-", ">&- 2>&-"])
def test_a_command_ends_well_where_a_stream_is_closed(closed: str) -> None:
    command = f"{shlex.quote(sys.executable)} -m spl_batch --version {closed}"
    ended = subprocess.run(  # noqa: S602 - our own words
        command, shell=True, capture_output=True, text=True, check=False
    )
    assert (ended.returncode, ended.stderr) == (0, "")


def lines_of(console: Console) -> list[str]:
    return console.file.getvalue().splitlines()  # type: ignore[attr-defined]


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """What the plain view takes for the time [s]."""
    now = [1000.0]
    monkeypatch.setattr(view.time, "monotonic", lambda: now[0])
    return now


@pytest.fixture
def console() -> Console:
    return Console(file=io.StringIO(), width=80)


def test_a_simulation_that_is_piped_says_how_far_it_is(
    console: Console, clock: list[float]
) -> None:
    plain = view.PlainView(console)
    for k in range(101):
        plain.simulated(k / 100)
        clock[0] += 0.5
    lines = lines_of(console)
    assert lines[0] == "simulate: begun"
    assert lines[1:] == [f"simulate: {k} %" for k in range(10, 101, 10)]


def test_a_quick_simulation_takes_two_lines(console: Console, clock: list[float]) -> None:
    plain = view.PlainView(console)
    for k in range(101):
        plain.simulated(k / 100)
        clock[0] += 0.001
    assert lines_of(console) == ["simulate: begun", "simulate: 100 %"]


def test_a_simulation_has_one_clock(
    console: Console, clock: list[float], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(view.time, "time", lambda: clock[0])
    drawn = view.View(console)
    drawn.simulated(0.5)
    clock[0] += 7.0
    console.print(drawn.draw())
    said = "\n".join(lines_of(console))
    assert "simulate" in said
    assert "getting ready" not in said
    drawn.on_event(RunStarted("w.yaml", 1, "code", stages=("index", "surfaces"), anew=True))
    clock[0] += 7.0
    console.print(drawn.draw())
    assert lines_of(console)[-1].strip().startswith("getting ready, "), "that of the run"


def test_compiling_that_is_piped_says_how_far_it_is_now_and_then(
    console: Console, clock: list[float]
) -> None:
    plain = view.PlainView(console)
    for k in range(70):
        plain.on_event(Compiling(k, 70))
        clock[0] += 1.0
    assert lines_of(console) == [
        "compiling: 31 of 70 kernels ready after 31 s, about 39 s left at this pace",
        "compiling: 62 of 70 kernels ready after 1 min 02 s, about 8 s left at this pace",
    ]


def test_in_a_notebook_verbs_show_what_they_do_unless_somebody_listens(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    given: dict[str, Any] = {}

    def verb(workflow: str, *, listener: Any = None, progress: Any = None) -> str:
        given.update(listener=listener, progress=progress)
        if progress is not None:
            progress(0.5)
        return workflow

    monkeypatch.setattr(simulation, "simulate", verb)
    monkeypatch.delitem(sys.modules, "ipykernel", raising=False)
    assert api.simulate is verb, "elsewhere they are silent"
    monkeypatch.setitem(sys.modules, "ipykernel", SimpleNamespace())
    assert api.simulate("w") == "w"  # type: ignore[call-arg]
    assert given == {"listener": None, "progress": None}, "a kernel's library is no notebook yet"
    monkeypatch.setattr(watching, "_ERR", SimpleNamespace(is_jupyter=True))
    assert api.simulate("w") == "w"  # type: ignore[call-arg]
    assert capsys.readouterr().out == "simulate: begun\n"
    mine = print
    watching.shown(verb, ("listener",))("w", listener=mine)
    assert given == {"listener": mine, "progress": None}
    assert capsys.readouterr().out == ""


def test_a_run_that_has_not_begun_is_waited_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "out"
    steps = iter([output, output / "store", output / "log.jsonl"])

    def sleep(_: float) -> None:
        next(steps).mkdir()

    monkeypatch.setattr(screen.time, "sleep", sleep)
    screen.await_run(output)
    assert (output / "log.jsonl").exists()
    assert capsys.readouterr().err.startswith(f"info: no run has begun in {output} yet: waiting")
    screen.await_run(output)
    screen.await_run(Path(__file__))
    screen.await_run(Path("s3://bucket/out"))
    assert capsys.readouterr().err == "", "what will be no output of a run is told by the command"


def test_a_silence_that_is_piped_is_broken_ever_more_rarely(
    console: Console, clock: list[float]
) -> None:
    plain = view.PlainView(console)
    plain.on_event(RunStarted("w.yaml", 1, "code", stages=("index", "surfaces"), anew=True))
    plain.on_event(PhaseStarted("surfaces", "surface", 4, 0, 0))
    plain.on_event(TaskStarted("surfaces", "surface", "0/0", "w1"))
    said = []
    for second in range(100):
        before = len(lines_of(console))
        plain.beat()
        if len(lines_of(console)) > before:
            said.append(second)
        clock[0] += 1.0
    assert said == [11, 22, 33, 44, 55, 66, 97], "each 10 s for a minute, then each 30 s"
    assert lines_of(console)[-1].startswith("surfaces: 0/4, 1 at work for ")
    assert lines_of(console)[-1].endswith(", compiling first where this machine has not yet")


def test_compiling_is_drawn_on_a_terminal(console: Console) -> None:
    drawn = view.View(console)
    drawn.on_event(Compiling(12, 70))
    console.print(drawn.draw())
    assert lines_of(console)[-1].strip() == "compiling: 12 of 70 kernels ready", "no pace yet"


def test_what_takes_long_is_said_and_what_does_not_is_not(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with saying_if_slow("reading", after_s=5.0):
        pass
    assert capsys.readouterr().err == ""
    with saying_if_slow("reading", after_s=0.01):
        time.sleep(0.2)
    assert capsys.readouterr().err == "info: reading\n"


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_cells_of_a_notebook_get_plain_lines(monkeypatch: pytest.MonkeyPatch) -> None:
    console = Console(file=Terminal(), force_interactive=True)
    monkeypatch.delenv("JPY_PARENT_PID", raising=False)
    assert is_screen(console)
    monkeypatch.setenv("JPY_PARENT_PID", "1")
    assert not is_screen(console), "their terminal shows codes that move a cursor as text"
