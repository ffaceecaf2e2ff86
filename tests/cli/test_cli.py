"""The command line: help, exit statuses, and what a person sees."""

import errno
import os
import re
import signal
import subprocess
import sys
import time
from io import UnsupportedOperation
from pathlib import Path
from typing import Any

import click
import pytest

import spl_batch
from spl_batch.cli import _STAGES, cli
from spl_batch.engine.flow import cluster
from spl_batch.engine.tasks.runner import build_version
from spl_batch.engine.tasks.step import stages
from spl_batch.errors import (
    DamagedError,
    InputError,
    PlanError,
    SplBatchError,
    StoppedError,
    StoreError,
)
from tests import surveys

COMMANDS = sorted(cli.commands)


@pytest.fixture
def _workflows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Files that the verbs find here; what they hold is never read."""
    monkeypatch.chdir(tmp_path)
    for name in ("a", "w.yaml"):
        Path(name).touch()


def test_the_commands_of_the_contract_are_there() -> None:
    assert set(COMMANDS) >= {"quickstart", "simulate", "plan", "run", "status", "report"}
    assert tuple(_STAGES.split(", ")) == stages("imaging")


@pytest.mark.parametrize("command", ["", *COMMANDS])
def test_each_command_explains_itself(command: str) -> None:
    ended = surveys.command(*([command] if command else []), "--help")
    assert ended.status == 0
    assert "Usage: spl-batch" in ended.out
    for parameter in cli.commands[command].params if command else ():
        if isinstance(parameter, click.Option):
            assert parameter.help, f"{command}: {parameter.name} has no help"
            assert parameter.opts[0] in ended.out


def test_version_and_module_entry() -> None:
    assert surveys.command("--version").out.split()[-1] == build_version()
    assert build_version().startswith(f"{spl_batch.__version__}+")
    found = subprocess.run(
        [sys.executable, "-m", "spl_batch", "--version"], capture_output=True, check=True, text=True
    )
    assert build_version() in found.stdout


@pytest.mark.usefixtures("_workflows")
@pytest.mark.parametrize(
    ("error", "status"),
    [
        (SplBatchError("wrong"), 2),
        (InputError("a.laz", ["one", "two"]), 2),
        (PlanError("too large"), 2),
        (StoreError("no finished run"), 2),
        (DamagedError("map.npz", "cut off"), 1),
        (StoppedError("disk full"), 3),
        (click.Abort(), 3),
        (UnsupportedOperation("File or stream is not seekable."), 2),
        (OSError(errno.ENOSPC, "No space left on device"), 3),
    ],
)
def test_every_error_has_its_status(
    error: Exception, status: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: Any, **__: Any) -> None:
        raise error

    monkeypatch.setattr("spl_batch.api.run", fail)
    ended = surveys.command("run", "w.yaml")
    assert ended.status == status
    assert str(getattr(error, "strerror", None) or error) in ended.err
    assert "None" not in ended.err


@pytest.mark.usefixtures("_workflows")
@pytest.mark.parametrize("sign", [signal.SIGTERM, signal.SIGINT])
@pytest.mark.parametrize("lost", [False, True])
def test_the_end_of_a_queue_systems_time_is_taken_like_ctrl_c(
    monkeypatch: pytest.MonkeyPatch, sign: signal.Signals, *, lost: bool
) -> None:
    def wait(*_: Any, **__: Any) -> None:
        try:
            os.kill(os.getpid(), sign)
            time.sleep(10)
        except KeyboardInterrupt as interrupt:
            if lost:
                raise RuntimeError("no compiled object yet") from interrupt
            raise

    monkeypatch.setattr("spl_batch.api.run", wait)
    before = signal.signal(sign, signal.SIG_DFL)  # of tests in the background it is ignored
    try:
        ended = surveys.command("run", "w.yaml")
        assert signal.getsignal(sign) == signal.SIG_DFL
    finally:
        signal.signal(sign, before)
    assert ended.status == 3
    assert ended.err.splitlines()[-1] == "interrupted; the same command continues"


@pytest.mark.usefixtures("_workflows")
def test_options_reach_the_run(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: dict[str, Any] = {}

    def remember(workflow: Path, **options: Any) -> None:
        seen.update(options, workflow=workflow)
        raise StoppedError("enough")

    monkeypatch.setattr("spl_batch.api.run", remember)
    line = "run w.yaml --workers 3 --memory 1GiB --scheduler tcp://h:1 --fresh --until ground"
    surveys.command(*line.split(), "--set", "a.b=1", "--set", "c=2")
    assert seen.pop("listener")
    assert seen == {
        "workflow": Path("w.yaml"),
        "workers": 3,
        "memory": "1GiB",
        "scheduler": "tcp://h:1",
        "fresh": True,
        "until": "ground",
        "overrides": ("a.b=1", "c=2"),
    }


def test_a_scheduler_that_is_not_there(
    small_lines: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(cluster.SETTINGS, "distributed.comm.timeouts.connect", "1s")
    workflow = surveys.copy_of(small_lines, tmp_path)
    ended = surveys.command("run", workflow, "--scheduler", "tcp://127.0.0.1:9")
    assert ended.status == 3
    assert "tcp://127.0.0.1:9" in ended.err


@pytest.mark.parametrize("address", ["ssh://there:22", "tcp://there"])
def test_what_is_no_address_is_refused_where_nothing_is_left_to_do(
    small_output: Path, address: str
) -> None:
    workflow = small_output.parent / "workflow.yaml"
    ended = surveys.command("run", workflow, "--scheduler", address)
    assert ended.status == 2
    assert f"--scheduler {address}: write tcp://HOST:PORT" in ended.err


def test_plan_reports_what_a_run_would_do(small_lines: Path, tmp_path: Path) -> None:
    workflow = surveys.copy_of(small_lines, tmp_path)
    ended = surveys.command("plan", workflow)
    assert ended.status == 0
    for word in ("files", "points", "tiles", "tasks", "disk", "memory", "time"):
        assert word in ended.out
    assert re.search(r"disk +[1-9][\d.]* [KM]iB", ended.out)
    assert not (tmp_path / "out").exists(), "a plan writes nothing"
    (tmp_path / "lines/bad_1.laz").write_text("no")
    (tmp_path / "lines/bad_2.laz").write_text("no")
    ended = surveys.command("plan", workflow)
    assert ended.status == 1
    assert "bad_1.laz" in ended.out
    assert "bad_2.laz" in ended.out


def test_simulate_writes_a_survey_that_can_be_planned(tmp_path: Path) -> None:
    scene = tmp_path / "scene.yaml"
    scene.write_text(
        "name: mini\nextent_m: [30, 30]\nflights:\n  - {heading_deg: 0, speed_m_s: 100}\n"
        "acquisition: {prf_hz: 5000, gate_m: 100}\n"
    )
    ended = surveys.command("simulate", scene, tmp_path / "out")
    assert ended.status == 0, ended.text
    assert str(tmp_path / "out/workflow.yaml") in ended.out
    assert surveys.command("plan", tmp_path / "out/workflow.yaml").status == 0
    scene.write_text("extent: 5\n")
    ended = surveys.command("simulate", scene, tmp_path / "no")
    assert ended.status == 2
    assert "extent" in ended.err
