"""Runs on workers that were started elsewhere, one cluster for all of them."""

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio

from spl_batch import api
from spl_batch.constants import NODATA
from tests import clusters, surveys
from tests.clusters import Cluster, fault

TILE_M = 4
BLOCKS = ("--set", f"tiling.tile_m={TILE_M}", "--set", "tiling.block_tiles=1")
"""The small survey in cells of one tile and its margins, eight of them."""


def run_on(there: Cluster, workflow: Path, *options: object) -> surveys.Ended:
    """Run a workflow on workers that were started elsewhere."""
    # One worker in the plan cuts the blocks as a run in this process does.
    limits = ("--workers", 1, "--memory", clusters.MEMORY)
    return surveys.command("run", workflow, "--scheduler", there.address, *limits, *options)


def report(workflow: Path) -> Any:
    return surveys.report(workflow.parent / "out")


def raster(output: Path, name: str) -> tuple[Any, Any, Any]:
    """Cells of a raster, and where their centres are [m]."""
    with rasterio.open(output / f"{name}.tif") as source:
        values = source.read(1).ravel()
        x, y = source.xy(*(i.ravel() for i in np.indices(source.shape)))
    return values, np.array(x), np.array(y)


@pytest.fixture(scope="module")
def dask_processes(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    """A scheduler and two workers, of one thread and of two: for the tests of one file.

    Idle ones work as well, so they do not stay for the session.
    """
    with clusters.cluster(tmp_path_factory.mktemp("dask"), 1, 2) as started:
        yield started


@pytest.fixture
def cluster(dask_processes: Cluster) -> Cluster:
    """That cluster, with nothing that goes wrong on it."""
    dask_processes.plan.set()
    return dask_processes


@pytest.mark.slow
@pytest.mark.parametrize(
    ("patch", "arguments", "message"),
    [
        (
            ("spl_batch.engine.verbs.planning.code_version", lambda _: "0.0+other"),
            (),
            "here it is 0.0+other",
        ),
        (None, ("--memory", "3GiB"), "less than --memory 3072 MiB; lower --memory"),
    ],
    ids=["code", "memory"],
)
def test_workers_that_cannot_do_the_work_are_refused(
    small: Path,
    cluster: Cluster,
    monkeypatch: pytest.MonkeyPatch,
    patch: Any,
    arguments: tuple[str, ...],
    message: str,
) -> None:
    if patch is not None:
        monkeypatch.setattr(patch[0], patch[1])
    options = arguments or ("--memory", clusters.MEMORY)
    ended = surveys.command("run", small, "--scheduler", cluster.address, *options)
    assert ended.status == 2
    (line,) = (x for x in ended.err.splitlines() if x.startswith("spl-batch:"))
    assert line.startswith("spl-batch: --scheduler: worker tcp://127.0.0.1:")
    assert message in line
    assert not (small.parent / "out/store/receipts").exists()


@pytest.mark.slow
def test_a_task_that_always_fails_costs_its_cell_alone(
    small: Path, small_output: Path, cluster: Cluster
) -> None:
    name = "68001_822501"
    cluster.plan.set(fault("denoise", "raise", name))
    ended = run_on(cluster, small, *BLOCKS)
    assert ended.status == 1
    assert f"failed: denoise {name}: RuntimeError: broken on purpose" in ended.err
    tries = [pid for tried, pid in cluster.plan.tries("denoise") if tried == name]
    assert len(tries) == 2, "once more"
    (failure,) = report(small)["failures"]
    assert failure["task"] == f"denoise {name}"
    assert failure["reason"] == "RuntimeError: broken on purpose"
    assert f"tile {name}" in failure["inputs"]
    counts = report(small)["counts"]
    assert counts["points_in"] == counts["points_out"]
    assert 0 < counts["not_assessed"] < counts["points_in"]
    corner_m = [TILE_M * int(v) for v in name.split("_")[:2]]
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
    surveys.assert_mended(small, small_output)


@pytest.mark.slow
def test_a_worker_that_is_killed_and_a_passing_fault_cost_nothing(
    small: Path, small_output: Path, cluster: Cluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(small.parent)
    cluster.plan.set(fault("scatter", "raise", times=1), fault("denoise", "kill", times=1))
    ended = run_on(cluster, Path(small.name), *BLOCKS)
    assert ended.status == 0, ended.text
    assert "failed" not in ended.err
    assert report(small)["failures"] == []
    assert len(cluster.plan.tries("scatter")) == 3
    assert len(cluster.plan.tries("denoise")) > 8
    assert surveys.results(small.parent / "out") == surveys.results(small_output)


@pytest.mark.slow
def test_a_lost_scheduler_ends_the_run_which_continues(
    small: Path, small_output: Path, cluster: Cluster
) -> None:
    """The last test of this file: it kills the scheduler of the others."""
    cluster.plan.set(fault("observe", "wait"))
    killed_s: list[float] = []

    def kill() -> None:
        killed_s.append(time.monotonic())
        cluster.kill(0)

    thread = clusters.when(lambda: cluster.plan.tries("observe"), kill)
    ended = run_on(cluster, small)
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
    surveys.assert_mended(small, small_output)
