"""What goes wrong is isolated, named and mended; the rest is finished."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import dask
import psutil
import pytest

from spl_batch import api
from spl_batch.airborne.receiver import Imaging
from spl_batch.engine.watch.events import Event, TaskEnded
from tests import clusters, faulty_worker, surveys
from tests.clusters import Plan, fault


@pytest.fixture
def own_workers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Plan:
    """Faults for the workers that a run starts itself."""
    folder = tmp_path / "plan"
    folder.mkdir()
    plan = Plan(folder)
    monkeypatch.setenv(faulty_worker.VARIABLE, str(plan.path))
    return plan


@pytest.mark.slow
def test_a_task_that_eats_memory_fails_and_the_rest_is_finished(
    small: Path, small_output: Path, own_workers: Plan, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Imaging, "warm_up", lambda *_: None)  # they are compiled
    surveys.run(small, until="denoise")
    name = max(p.stem for p in (small_output / "store/receipts/ground").glob("*.json"))
    own_workers.set(fault("ground", "eat", name))
    failed: list[TaskEnded] = []

    def listen(event: Event) -> None:
        if isinstance(event, TaskEnded) and event.reason:
            failed.append(event)

    with dask.config.set({"distributed.worker.preload": [faulty_worker.__file__]}):
        result = api.run(small, workers=1, memory=clusters.MEMORY, until="ground", listener=listen)
    assert result.exit_status == 1
    (failure,) = failed
    assert (failure.kind, failure.name, failure.code) == ("ground", name, "F02")
    assert failure.reason.startswith("OutOfMemory: its worker needed more than 1024 MiB")
    assert len([tried for tried, _ in own_workers.tries("ground") if tried == name]) == 2
    done = {tried for tried, _ in own_workers.tries("ground")}
    assert len(done) == len(list((small_output / "store/receipts/ground").glob("*.json")))


@pytest.mark.slow
def test_ctrl_c_ends_a_run_in_order(small: Path) -> None:
    output = small.parent / "out"
    process = subprocess.Popen(  # noqa: S603
        [
            *(sys.executable, "-m", "spl_batch", "run", str(small)),
            *("--workers", "1", "--until", "deliver"),
        ],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        start_new_session=True,
        # Tests that run in the background of a shell have it ignore Ctrl-C.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # noqa: PLW1509
    )
    children: list[psutil.Process] = []

    def send() -> None:
        children.extend(psutil.Process(process.pid).children(recursive=True))
        os.killpg(process.pid, signal.SIGINT)  # as a terminal does

    thread = clusters.when(lambda: list((output / "store/receipts").rglob("*.json")), send)
    printed, _ = process.communicate(timeout=120)
    thread.join()
    assert process.returncode == 3, printed
    assert b"interrupted; the same command" in printed
    assert b"Traceback" not in printed
    _, left = psutil.wait_procs(children, timeout=10)
    assert not left
    assert surveys.run(small, until="index").exit_status == 0
