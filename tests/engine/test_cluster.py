"""Workers that were started elsewhere: what they must find, and how work flows to them."""

import ast
import dataclasses
import logging
import re
import threading
import time
from collections.abc import Iterator
from typing import Any

import pytest
from distributed import Client, LocalCluster, get_worker

from spl_batch.engine.flow import cluster, dask_flow
from spl_batch.engine.flow import job as work
from spl_batch.engine.flow.executor import Footing, OnDask
from spl_batch.engine.tasks.task import Receipt, Task, WorkersSeen
from spl_batch.errors import StoppedError
from tests import clusters

# Processes


def test_the_slurm_snippet_of_the_documentation_makes_a_job() -> None:
    jobqueue = pytest.importorskip("dask_jobqueue")
    page = (clusters.ROOT / "docs/cluster.md").read_text(encoding="utf-8")
    (code,) = (
        c for c in re.findall(r"```python\n(.*?)```", page, re.DOTALL) if "SLURMCluster" in c
    )
    (call,) = (
        node
        for node in ast.walk(ast.parse(code))
        if isinstance(node, ast.Call) and ast.unparse(node.func) == "SLURMCluster"
    )
    options = {str(k.arg): ast.literal_eval(k.value) for k in call.keywords}
    with jobqueue.SLURMCluster(
        **options, interface="lo", scheduler_options={"dashboard_address": "127.0.0.1:0"}
    ) as cluster:
        script = cluster.job_script()
    for words in ("-p compute", "--cpus-per-task=16", "--mem=96G", "--nworkers 16", "--nthreads 1"):
        assert words in script, words
    assert "--memory-limit 6.00GiB" in script, "what --memory says"
    assert "--lifetime 7h50m" in script


# The flow of jobs, on workers that are threads of this process


class Watcher:
    """Notes what it is told."""

    def __init__(self) -> None:
        self.began: list[tuple[str, str]] = []
        self.looks: list[WorkersSeen] = []
        self.notes: list[str] = []

    def ready(self, scheduler: str, dashboard: str) -> None:
        """Workers are there before the test begins."""

    def started(self, task: Task, worker: str) -> None:
        self.began.append((task.name, worker))

    def seen(self, workers: WorkersSeen) -> None:
        self.looks.append(workers)

    def noted(self, text: str) -> None:
        self.notes.append(text)


@pytest.fixture
def threads(monkeypatch: pytest.MonkeyPatch) -> Iterator[LocalCluster]:
    monkeypatch.setattr(dask_flow, "TICK_S", 0.05)
    monkeypatch.setattr(work, "misfit", lambda _: "")
    with LocalCluster(
        n_workers=1,
        threads_per_worker=1,
        processes=False,
        dashboard_address="127.0.0.1:0",
        silence_logs=50,
    ) as started:
        yield started


def receipt(task: Task, key: str, reason: str = "") -> Receipt:
    return Receipt(task.kind, task.name, key, "", reason, {}, {}, 0, 0.0, 0.0)


def jobs(count: int) -> list[tuple[Task, str]]:
    return [(Task("denoise", f"{k}_0", {}), f"key {k}") for k in range(count)]


def flow_through(
    threads: LocalCluster, todo: Any, monkeypatch: pytest.MonkeyPatch, do: Any
) -> tuple[list[Receipt], Watcher]:
    """Let jobs flow; ``do`` is what workers do with a task, its key and the context."""
    monkeypatch.setattr(work, "run_task", do)
    watcher, found = Watcher(), []
    with Client(threads) as client:
        on_dask = OnDask(client, watcher, Footing("", "", "", ""), local=False)
        on_dask.run(todo, None, found.append)  # type: ignore[arg-type]
    return found, watcher


def test_a_failure_is_tried_once_more_on_another_worker(
    threads: LocalCluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    threads.scale(2)
    threads.wait_for_workers(2)
    tries: list[tuple[str, str]] = []

    def do(task: Task, key: str, _: object) -> Receipt:
        tries.append((task.name, get_worker().address))
        before = [name for name, _ in tries].count(task.name)
        bad = task.name == "3_0" or (task.name == "5_0" and before == 1)
        return receipt(task, key, "RuntimeError: no" if bad else "")

    found, watcher = flow_through(threads, jobs(8), monkeypatch, do)
    assert sorted(r.name for r in found) == sorted(task.name for task, _ in jobs(8))
    assert [r.name for r in found if r.failed] == ["3_0"]
    for name in ("3_0", "5_0"):
        workers = [worker for tried, worker in tries if tried == name]
        assert len(workers) == len(set(workers)) == 2
    assert len(tries) == 10
    assert {name for name, _ in watcher.began} == {task.name for task, _ in jobs(8)}


def test_what_a_task_needs_is_not_sent(
    threads: LocalCluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    sent: list[Task] = []

    def do(task: Task, key: str, _: object) -> Receipt:
        sent.append(task)
        return receipt(task, key)

    given = Task("mosaic", "dtm", {"name": "dtm"}, (("surface", "0_0"),) * 1000, 7)
    flow_through(threads, [(given, "key")], monkeypatch, do)
    assert sent == [dataclasses.replace(given, needs=())]


def test_a_task_knows_the_limit_of_its_worker(
    threads: LocalCluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    told: list[int | None] = []
    monkeypatch.setattr(work, "limit_memory", told.append)
    flow_through(threads, jobs(1), monkeypatch, lambda task, key, _: receipt(task, key))
    limits = {worker.memory_manager.memory_limit for worker in threads.workers.values()}
    assert {*told} == limits


def test_few_jobs_are_in_flight_and_workers_that_join_are_used(
    threads: LocalCluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    taken = 0
    most = 0
    done = 0
    seen: set[str] = set()
    lock = threading.Lock()

    def todo() -> Iterator[tuple[Task, str]]:
        nonlocal taken, most
        for job in jobs(60):
            taken += 1
            most = max(most, taken - done)
            yield job

    def do(task: Task, key: str, _: object) -> Receipt:
        nonlocal done
        time.sleep(0.03)
        with lock:
            seen.add(get_worker().address)
            if len(seen) == 1 and task.name == "5_0":
                threads.sync(threads.scale, 2, asynchronous=True)
            done += 1
        return receipt(task, key)

    found, watcher = flow_through(threads, todo(), monkeypatch, do)
    assert len(found) == 60
    assert len(seen) == 2
    assert watcher.looks[-1].threads == 2
    # What is done may not have been heard of yet.
    assert most <= 2 * dask_flow.IN_FLIGHT_PER_THREAD + 4


def test_a_large_task_waits_for_a_worker_and_not_behind_another_task(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The second largest of what is left goes to whoever is free first."""
    large, small = dask_flow.LARGE_POINTS, dask_flow.LARGE_POINTS - 1
    points = [large, large, large, *[small] * 9]
    todo = ((Task("denoise", str(k), {}, (), n), str(k)) for k, n in enumerate(points))
    given = dask_flow._Flow(OnDask(None, None, None, local=True), None, todo)  # type: ignore[arg-type]
    given.threads = {"a": 1, "b": 1}

    def submit(_: object, trial: dask_flow._Try) -> None:
        given.running[trial.job[1]] = trial

    monkeypatch.setattr(dask_flow._Flow, "_submit", submit)
    given._feed()
    assert list(given.running) == ["0", "1"]
    del given.running["1"]
    given._feed()
    assert list(given.running) == ["0", "2", "3", "4", "5", "6"], "small ones go ahead"
    given.running.clear()
    given._feed()
    given._feed()
    assert list(given.running) == ["7", "8", "9", "10", "11"], "none is lost or done twice"


def test_a_second_try_does_not_wait_for_workers_that_are_gone(
    threads: LocalCluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    threads.scale(2)
    threads.wait_for_workers(2)
    tries: list[str] = []

    def do(task: Task, key: str, _: object) -> Receipt:
        tries.append(get_worker().address)
        if len(tries) == 1:
            other = next(name for name, w in threads.workers.items() if w.address != tries[0])
            threads.sync(threads.workers[other].close)
            return receipt(task, key, "RuntimeError: no")
        return receipt(task, key)

    # The look at the workers that finds one gone comes after the second try is sent.
    monkeypatch.setattr(dask_flow, "TICK_S", 0.3)
    found, watcher = flow_through(threads, jobs(1), monkeypatch, do)
    assert [r.reason for r in found] == [""]
    assert len(tries) == 2
    assert any("is lost" in note for note in watcher.notes)


def test_workers_are_found_whatever_the_client_holds(threads: LocalCluster) -> None:
    with Client(threads) as client:
        client._scheduler_identity = {"workers": {}}  # as every two seconds
        assert list(dask_flow.workers_of(client)) == [w.address for w in threads.workers.values()]


def test_what_concerns_everything_stops_everything(
    threads: LocalCluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> Receipt:
        raise StoppedError("disk full; free some space and run again")

    with pytest.raises(StoppedError, match="disk full"):
        flow_through(threads, jobs(3), monkeypatch, full)


def test_a_worker_that_joins_with_other_code_stops_the_run(
    threads: LocalCluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(work, "misfit", lambda _: "has spl_batch 0.0, here it is 0.1")
    with pytest.raises(StoppedError, match=r"worker inproc://.* has spl_batch 0.0.*run again"):
        flow_through(threads, jobs(3), monkeypatch, receipt)


def test_a_task_that_cannot_be_sent_fails_alone(
    threads: LocalCluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    def do(task: Task, key: str, _: object) -> Receipt:
        if task.name == "1_0":
            raise LookupError("nothing of the kind here")
        return receipt(task, key)

    found, _ = flow_through(threads, jobs(3), monkeypatch, do)
    assert {r.name: r.reason for r in found if r.failed} == {
        "1_0": "LookupError: nothing of the kind here"
    }


def test_dask_says_nothing_while_a_run_works() -> None:
    told: list[logging.LogRecord] = []
    handler = logging.Handler()
    handler.emit = told.append  # type: ignore[method-assign]
    logger = logging.getLogger("distributed.client")
    before = logger.level
    logger.setLevel(logging.WARNING)
    logger.addHandler(handler)
    try:
        with cluster.silent():
            logger.error("a traceback")
        assert told == []
        logger.error("of somebody else's")
        assert len(told) == 1
    finally:
        logger.removeHandler(handler)
        logger.setLevel(before)
