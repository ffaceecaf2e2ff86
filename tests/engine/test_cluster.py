"""Workers that were started elsewhere: what they must find, and how work flows to them."""

import contextlib
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import pytest
from distributed import Client, LocalCluster
from distributed.scheduler import KilledWorker

from spl_batch.airborne.settings.workflow import parse_workflow
from spl_batch.airborne.steps import STEPS
from spl_batch.engine.flow import cluster, dask_flow, job
from spl_batch.engine.flow.cluster import OnDask
from spl_batch.engine.store.output_lock import lock_file
from spl_batch.engine.tasks import runner
from spl_batch.engine.tasks.context import RunContext
from spl_batch.engine.tasks.task import Job, Outcome, Receipt, Task
from spl_batch.engine.watch.events import WorkersReady
from spl_batch.errors import StoppedError

WORKFLOW = parse_workflow({"survey": {"flightlines": "a"}, "output": "o"}, "w")
CONTEXT = RunContext(WORKFLOW, Path(), Path(), "", "code", "of this run")

# The flow of jobs, on workers that are threads of this process


class Watcher:
    """Notes which tasks begin, and what is reported of workers."""

    def __init__(self) -> None:
        self.began: list[tuple[str, str]] = []
        self.reported: list[object] = []

    def started(self, task: Task, worker: str) -> None:
        self.began.append((task.name, worker))

    def notify(self, event: object) -> None:
        self.reported.append(event)


@pytest.fixture
def threads(monkeypatch: pytest.MonkeyPatch) -> Iterator[LocalCluster]:
    monkeypatch.setattr(dask_flow, "TICK_S", 0.05)
    monkeypatch.setattr(job, "misfit", lambda _: "")
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


def jobs(count: int) -> list[Job]:
    return [Job(Task("denoise", f"{k}_0", {}), f"key {k}") for k in range(count)]


def apart(todo: list[Job]) -> list[list[Job]]:
    return [[one] for one in todo]


def done(one: Job, _: object) -> Outcome:
    return Outcome(one.need, receipt(one.task, one.key))


def flow_through(
    threads: LocalCluster, todo: list[list[Job]], monkeypatch: pytest.MonkeyPatch, do: Any
) -> tuple[list[Outcome], Watcher]:
    """Let batches flow, and what failed once more; ``do`` is what workers do with a job and with
    what it waited for.
    """
    monkeypatch.setattr(job, "do", lambda one, _context, needed: do(one, needed))
    watcher, found = Watcher(), list[Outcome]()
    with Client(threads) as client:
        on_dask = OnDask(lambda: client, CONTEXT, watcher, local=False)
        try:
            for some in todo:
                on_dask.submit(some)
            known, open_ = {one.need: one for some in todo for one in some}, len(todo)
            while open_:
                open_ -= 1
                for outcome in on_dask.ended():
                    if outcome.again and not known[outcome.need].open:
                        on_dask.submit([known[outcome.need]._replace(tried=outcome.again)])
                        open_ += 1
                    found.append(outcome)
        finally:
            on_dask.close()
    return found, watcher


def test_a_failure_is_tried_once_more(
    threads: LocalCluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    tries: list[str] = []

    def do(one: Job, _: object) -> Outcome:
        tries.append(one.task.name)
        before = tries.count(one.task.name)
        bad = one.task.name == "3_0" or (one.task.name == "5_0" and before == 1)
        made = receipt(one.task, one.key, "RuntimeError: no" if bad else "")
        return Outcome(one.need, made)

    found, watcher = flow_through(threads, apart(jobs(8)), monkeypatch, do)
    ended = [o.need[1] for o in found if o.again is None]
    assert sorted(ended) == sorted(one.task.name for one in jobs(8))
    assert [o.need[1] for o in found if o.receipt and o.receipt.failed] == ["3_0"]
    assert sorted(o.need[1] for o in found if o.again) == ["3_0", "5_0"]
    assert len(tries) == 10
    assert {name for name, _ in watcher.began} == {one.task.name for one in jobs(8)}


def test_the_first_task_of_a_batch_is_reported_whatever_the_clock_shows(
    threads: LocalCluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(job, "time", SimpleNamespace(monotonic=lambda: 0.0))
    _, watcher = flow_through(threads, [jobs(3)], monkeypatch, done)
    assert [name for name, _ in watcher.began] == ["0_0"]


def test_a_job_is_given_what_it_waits_for_as_a_value(
    threads: LocalCluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = jobs(2)
    later = Job(Task("ground", "0_0", {}), "", tuple(one.need for one in first))
    given: list[Any] = []

    def do(one: Job, needed: Any) -> Outcome:
        if one.task.kind == "ground":
            given.extend(needed)
        return Outcome(one.need, receipt(one.task, one.key))

    found, _ = flow_through(threads, apart([*first, later]), monkeypatch, do)
    assert [o.need for o in given] == [one.need for one in first]
    assert found[-1].need == later.need


def test_of_a_batch_only_what_fails_is_done_again_and_what_waits_for_it_as_well(
    threads: LocalCluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A worker does small tasks one after the other; each has its own outcome."""
    monkeypatch.setattr(runner, "run_task", lambda task, key, *_: receipt(
        task, key, "no" if task.name == "1_0" else ""))  # fmt: skip
    monkeypatch.setattr(runner, "finished", lambda *_: None)
    monkeypatch.setattr(runner, "task_key", lambda *_: "key")
    monkeypatch.setattr(runner, "_step", lambda *_: STEPS["ground"])
    first = jobs(3)
    later = [Job(Task("ground", one.task.name, {"noise": {}}), "", (one.need,)) for one in first]
    do = lambda one, needed: runner.do(one, SimpleNamespace(), needed)  # type: ignore[arg-type]  # noqa: E731
    found, watcher = flow_through(threads, [first, later], monkeypatch, do)
    again = {("denoise", "1_0"): ("failed",), ("ground", "1_0"): ()}
    assert {o.need: o.again for o in found if o.again is not None} == again
    assert [o.need for o in found[:6]] == [one.need for one in (*first, *later)]
    assert [o.receipt and o.receipt.reason for o in found[6:]] == ["no"], "by itself"
    began = [name for name, _ in watcher.began]
    assert began == ["0_0", "0_0", "1_0"], "others follow within no time"


def test_the_tasks_of_a_batch_that_cannot_be_done_are_tried_one_by_one(
    threads: LocalCluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    def do(one: Job, _: object) -> Outcome:
        raise LookupError(one.task.name)

    found, _ = flow_through(threads, [jobs(2)], monkeypatch, do)
    assert [(o.need[1], o.again, o.receipt) for o in found] == [
        ("0_0", (), None),
        ("1_0", (), None),
    ]


def test_small_tasks_are_shared_among_the_workers(threads: LocalCluster) -> None:
    with Client(threads) as client:
        on_dask = OnDask(lambda: client, CONTEXT, Watcher(), local=False)
        assert on_dask.batch_of(300) == 1
        on_dask._begin()
        assert [on_dask.batch_of(n) for n in (3, 40, 10_000)] == [1, 10, dask_flow.BATCH_TASKS]
        on_dask.close()


def test_a_task_knows_the_limit_of_its_worker(
    threads: LocalCluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    limits: list[int | None] = []
    monkeypatch.setattr(job, "limit_memory", limits.append)
    flow_through(threads, [jobs(1)], monkeypatch, done)
    assert {*limits} == {w.memory_manager.memory_limit for w in threads.workers.values()}


def test_the_window_follows_the_workers(threads: LocalCluster) -> None:
    with Client(threads) as client:
        on_dask = OnDask(lambda: client, CONTEXT, Watcher(), local=False)
        on_dask._begin()
        assert on_dask.window == dask_flow.HELD_LEAST
        threads.scale(6)
        threads.wait_for_workers(6)
        until = time.monotonic() + 20
        while on_dask.window == dask_flow.HELD_LEAST and time.monotonic() < until:
            time.sleep(0.05)
        assert on_dask.window == 6 * dask_flow.HELD_PER_THREAD
        on_dask.close()


def test_what_concerns_everything_stops_everything(
    threads: LocalCluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> Outcome:
        raise StoppedError("disk full; free some space and run again")

    with pytest.raises(StoppedError, match="disk full"):
        flow_through(threads, apart(jobs(3)), monkeypatch, full)


def test_a_worker_that_joins_with_other_code_stops_the_run(
    threads: LocalCluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(job, "misfit", lambda _: "has spl_batch 0.0, here it is 0.1")
    with pytest.raises(StoppedError, match=r"worker inproc://.* has spl_batch 0.0.*run again"):
        flow_through(threads, apart(jobs(3)), monkeypatch, print)


def test_a_worker_that_does_not_see_the_mark_of_a_run_is_no_use(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(job, "code_version", lambda _: "code")
    waits: list[float] = []
    lock = lock_file(tmp_path)
    lock.parent.mkdir()
    context = replace(CONTEXT, output=tmp_path)
    for content, fault in (("of another", True), ("of this run", False)):
        monkeypatch.setattr(job.time, "sleep", waits.append)
        lock.write_text(content)
        job._unseen.cache_clear()
        assert ("must share that path" in job.misfit(context)) == fault
    assert sum(waits) > 5.0, "a file system may be slow"


def test_a_task_that_cannot_be_done_fails_alone(
    threads: LocalCluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    def do(one: Job, _: object) -> Outcome:
        if one.task.name == "1_0":
            raise LookupError("nothing of the kind here")
        return Outcome(one.need, receipt(one.task, one.key))

    found, _ = flow_through(threads, apart(jobs(3)), monkeypatch, do)
    failed = {o.need[1]: o.receipt.reason for o in found if o.receipt and o.receipt.failed}
    assert failed == {"1_0": "LookupError: nothing of the kind here"}


def test_a_task_that_another_may_have_killed_is_handed_out_once_more(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """What it waited for has ended by then: it is to be made anew, not to miss that."""
    monkeypatch.setattr(dask_flow, "HEARING_S", 0.0)
    monkeypatch.setattr(dask_flow, "write_receipt", lambda *_: None)
    on_dask = OnDask(lambda: None, CONTEXT, Watcher(), local=True)
    last = SimpleNamespace(address="there", nthreads=2, memory_limit=2**30)
    one, tried = Job(Task("ground", "0_0", {}), "", (("denoise", "0_0"),)), list[Any]()
    for _ in range(2):
        trial = dask_flow._Trial({one.need: one}, SimpleNamespace(key="k", status="error"))
        (outcome,) = on_dask._outcomes(trial.future, (None, KilledWorker("k", last, 1)), trial)
        tried.append(outcome.again)
        one = one._replace(tried=outcome.again or ())
    assert tried == [("killed",), None]
    assert outcome.receipt is not None
    assert outcome.receipt.facts["code"] == "F04"
    assert outcome.receipt.reason.startswith("LostWorker: 2 workers died with it")


# Workers that do not end in time spoil no run whose tasks are done


@contextlib.contextmanager
def slow_to_end(*_: object) -> Iterator[str]:
    yield "nowhere"
    raise TimeoutError


@pytest.fixture
def pool(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Gives an executor for an observer, on which ``begin`` looks for workers; none does a job."""
    monkeypatch.setattr(cluster, "local_cluster", slow_to_end)
    monkeypatch.setattr("distributed.Client", lambda _: MagicMock())
    monkeypatch.setattr(cluster, "find_spec", lambda _: None)
    idle = lambda connect, *_, **__: SimpleNamespace(begin=connect, close=lambda: None)  # noqa: E731
    monkeypatch.setattr(cluster, "OnDask", idle)
    return lambda observer: cluster.executor(
        CONTEXT,
        workers=1,
        memory_bytes=2**30,
        scheduler=None,
        observer=observer,
    )


def test_workers_are_started_where_something_is_to_be_done(pool: Any) -> None:
    busy, idle = Watcher(), Watcher()
    with pool(busy) as started:
        started.begin()
    with pool(idle):
        pass
    assert (busy.reported, idle.reported) == ([WorkersReady()], [])


def test_a_task_that_has_no_answer_is_still_heard_of(pool: Any) -> None:
    def run() -> None:
        with pool(Watcher()) as started:
            started.begin()
            raise TimeoutError("of the task")

    with pytest.raises(TimeoutError, match="of the task"):
        run()
