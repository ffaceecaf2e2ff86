"""What goes wrong is isolated, named and mended; the rest is finished."""

import json
import os
import shlex
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import dask
import numpy as np
import psutil
import pytest
import rasterio

from spl_batch import api
from spl_batch.airborne.filter import denoise
from spl_batch.constants import NODATA
from tests import clusters, faulty_worker, surveys
from tests.clusters import Cluster, Plan, cluster, fault

BLOCKS = ("--set", "tiling.block_tiles=1")
"""The small survey in blocks of one tile, four of them."""


def run_on(there: Cluster, workflow: Path, *options: object) -> surveys.Ended:
    """Run a workflow on workers that were started elsewhere."""
    # One worker in the plan cuts the blocks as a run in this process does.
    limits = ("--workers", 1, "--memory", clusters.MEMORY)
    return surveys.command("run", workflow, "--scheduler", there.address, *limits, *options)


def report(workflow: Path) -> Any:
    return json.loads((workflow.parent / "out/report.json").read_text())


def assert_mended(workflow: Path, expected: Path) -> None:
    """A run with nothing in its way ends as if nothing had ever been."""
    ended = surveys.run(workflow, until="deliver")
    assert ended.exit_status == 0
    assert surveys.results(ended.output) == surveys.results(expected)


def raster(output: Path, name: str) -> tuple[Any, Any, Any]:
    """Cells of a raster, and where their centres are [m]."""
    with rasterio.open(output / f"{name}.tif") as source:
        values = source.read(1).ravel()
        x, y = source.xy(*(i.ravel() for i in np.indices(source.shape)))
    return values, np.array(x), np.array(y)


@pytest.mark.slow
def test_a_task_that_always_fails_costs_its_place_alone(
    small: Path, small_output: Path, cluster: Cluster
) -> None:
    name = "2720_32900_1_1"
    cluster.plan.set(fault("denoise", "raise", name))
    ended = run_on(cluster, small, *BLOCKS)
    assert ended.status == 1
    assert f"failed: denoise {name}: RuntimeError: broken on purpose" in ended.err
    tries = [pid for tried, pid in cluster.plan.tries("denoise") if tried == name]
    assert len(set(tries)) == len(tries) == 2, "once more, on another worker"
    (failure,) = report(small)["failures"]
    assert failure["task"] == f"denoise {name}"
    assert failure["reason"] == "RuntimeError: broken on purpose"
    assert "tile 2720_32900" in failure["inputs"]
    counts = report(small)["counts"]
    assert counts["points_in"] == counts["points_out"]
    assert 0 < counts["not_assessed"] < counts["points_in"]
    corner_m = [100 * int(v) for v in name.split("_")[:2]]
    inside = {}
    for product in ("density", "dtm", "dsm"):
        values, x, y = raster(small.parent / "out", product)
        whole, _, _ = raster(small_output, product)
        block = (x > corner_m[0]) & (y > corner_m[1])
        inside[product] = (values[block], whole[block])
        assert np.any(values[~block] > 0), "its neighbours are there"
    values, whole = inside["density"]
    assert np.all(values <= 0)
    assert np.any(whole > 0)
    for values, whole in (inside["dtm"], inside["dsm"]):
        # Voids are filled from their edges, no further.
        missing = np.count_nonzero((values == NODATA) & (whole != NODATA))
        assert missing > 0.3 * np.count_nonzero(whole != NODATA)
    assert_mended(small, small_output)


def test_the_command_of_a_failure_reproduces_it_alone(
    small: Path, small_output: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: object) -> None:
        raise RuntimeError("broken on purpose")

    surveys.run(small, "filter.alpha=0.001", until="shuffle")
    with monkeypatch.context() as patch:
        patch.setattr(denoise, "judge", broken)
        result = surveys.run(small, "filter.alpha=0.001", memory="2GiB")
        assert result.report is not None
        failure = result.report.failures[0]
        assert failure.command is not None
        program, *arguments = shlex.split(failure.command)
        assert program == "spl-batch"
        assert arguments[-2:] == ["--only", failure.task]
        ended = surveys.command(*arguments)
        assert ended.status == 1
        assert f"failed: {failure.task}: RuntimeError: broken on purpose" in ended.out
        path = Path(ended.out.split()[-1])
        assert path.read_text().rstrip().endswith("RuntimeError: broken on purpose")
        assert "in broken" in path.read_text()
    ended = surveys.command(*arguments)
    assert ended.status == 0
    assert f"done: {failure.task}" in ended.out
    log = (result.output / "log.jsonl").read_text()
    assert "Traceback" in log
    assert " --memory 2GiB " in failure.command
    assert failure.command in [json.loads(line).get("command") for line in log.splitlines()]
    assert_mended(small, small_output)


@pytest.mark.parametrize(
    ("wanted", "said"),
    [
        ("denoise", "write kind and name"),
        ("noise 3_4", "kinds are"),
        ("gather x", "what it needs is not finished"),
        ("index_file x", "no such task; there are"),
    ],
)
def test_a_task_that_is_not_there_is_refused(small: Path, wanted: str, said: str) -> None:
    ended = surveys.command("run", small, "--only", wanted)
    assert ended.status == 2
    assert said in ended.err


@pytest.mark.slow
def test_a_worker_that_is_killed_and_a_passing_fault_cost_nothing(
    small: Path, small_output: Path, cluster: Cluster
) -> None:
    cluster.plan.set(fault("scatter", "raise", times=1), fault("denoise", "kill", times=1))
    ended = run_on(cluster, small, *BLOCKS)
    assert ended.status == 0, ended.text
    assert "failed" not in ended.err
    assert report(small)["failures"] == []
    assert len(cluster.plan.tries("scatter")) == 3
    assert len({pid for _, pid in cluster.plan.tries("scatter")}) == 2
    assert len(cluster.plan.tries("denoise")) > 4
    assert surveys.results(small.parent / "out") == surveys.results(small_output)


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
    small: Path, small_output: Path, own_workers: Plan
) -> None:
    surveys.run(small, until="denoise")
    name = max(p.stem for p in (small_output / "store/receipts/ground").glob("*.json"))
    own_workers.set(fault("ground", "eat", name))
    with dask.config.set({"distributed.worker.preload": [faulty_worker.__file__]}):
        result = api.run(small, workers=1, memory=clusters.MEMORY)
    assert result.exit_status == 1
    assert result.report is not None
    failure = result.report.failures[0]
    assert failure.task == f"ground {name}"
    assert failure.reason.startswith("OutOfMemory: its worker needed more than 1024 MiB")
    assert failure.remedy is not None
    assert failure.remedy.startswith("raise --memory or lower ground.cell_m")
    assert len([tried for tried, _ in own_workers.tries("ground") if tried == name]) == 2
    done = {tried for tried, _ in own_workers.tries("ground")}
    assert len(done) == len(list((small_output / "store/receipts/ground").glob("*.json")))
    assert_mended(small, small_output)


def test_a_file_that_cannot_be_read_to_its_end_is_left_out_and_mended(
    small: Path, small_output: Path
) -> None:
    path = small.parent / "lines/line_2.laz"
    content = path.read_bytes()
    path.write_bytes(content[: len(content) * 2 // 3])
    result = surveys.run(small)
    assert result.exit_status == 1
    assert result.report is not None
    (failure,) = result.report.failures
    assert "line_2.laz" in failure.place
    assert failure.inputs
    assert "line_2.laz" in failure.inputs[0]
    assert (result.output / "laz/lines/line_1.laz").exists()
    assert (result.output / "dtm.tif").exists()
    path.write_bytes(content)
    assert_mended(small, small_output)


def when(condition: Callable[[], object], then: Callable[[], object]) -> threading.Thread:
    """Do something in another thread as soon as a condition holds."""

    def wait() -> None:
        until = time.monotonic() + 120
        while not condition() and time.monotonic() < until:
            time.sleep(0.02)
        then()

    thread = threading.Thread(target=wait)
    thread.start()
    return thread


@pytest.mark.slow
def test_a_lost_scheduler_ends_the_run_which_continues(
    small: Path, small_output: Path, tmp_path: Path
) -> None:
    killed_s: list[float] = []
    with cluster(tmp_path / "dask", 1) as there:
        there.plan.set(fault("gather", "wait"))

        def kill() -> None:
            killed_s.append(time.monotonic())
            there.kill(0)

        thread = when(lambda: there.plan.tries("gather"), kill)
        ended = run_on(there, small)
        took_s = time.monotonic() - killed_s[0]
        thread.join()
    assert ended.status == 3
    assert took_s < 30
    (line,) = (x for x in ended.err.splitlines() if x.startswith("spl-batch:"))
    assert "the scheduler is lost" in line
    assert "run again" in line
    result = api.status(small.parent / "out")
    assert result.ended is not None
    assert result.ended["exit_status"] == 3
    assert_mended(small, small_output)


@pytest.mark.slow
def test_ctrl_c_ends_a_run_in_order(small: Path, small_output: Path) -> None:
    output = small.parent / "out"
    process = subprocess.Popen(  # noqa: S603
        [sys.executable, "-m", "spl_batch", "run", str(small), "--workers", "1"],
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

    thread = when(lambda: list((output / "store/receipts").rglob("*.json")), send)
    said, _ = process.communicate(timeout=120)
    thread.join()
    assert process.returncode == 3, said
    assert said.index(b"stopping; what is finished") < said.index(b"interrupted; the same command")
    assert b"Traceback" not in said
    _, left = psutil.wait_procs(children, timeout=10)
    assert not left
    assert_mended(small, small_output)
