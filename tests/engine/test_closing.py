"""Workers that do not end in time spoil no run whose tasks are done."""

import contextlib
from collections.abc import Iterator
from typing import Any, Self

import pytest

from spl_batch.engine.flow import cluster
from spl_batch.engine.flow.job import Handshake
from spl_batch.engine.tasks.task import Job, Task
from spl_batch.engine.watch.events import WorkersReady


class Heard:
    """An observer that remembers when workers are ready."""

    def __init__(self) -> None:
        self.events: list[object] = []

    def started(self, task: Any, worker: str) -> None:
        """Nothing begins here."""

    def tell(self, event: object) -> None:
        self.events.append(event)


@contextlib.contextmanager
def slow_to_end(*_: object) -> Iterator[str]:
    yield "nowhere"
    raise TimeoutError


class Client:
    """A client of nothing."""

    id = "none"
    dashboard_link = ""

    def __init__(self, address: str) -> None:
        assert address == "nowhere"

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """There is nothing to let go of."""


class Idle:
    """Takes jobs and does none."""

    def __init__(self, connect: Any, *_: object, **__: object) -> None:
        self.connect = connect

    def submit(self, *_: object) -> None:
        self.connect()

    def close(self) -> None:
        """There is nothing to let go of."""


@pytest.fixture
def heard(monkeypatch: pytest.MonkeyPatch) -> Heard:
    monkeypatch.setattr(cluster, "local_cluster", slow_to_end)
    monkeypatch.setattr("distributed.Client", Client)
    monkeypatch.setattr(cluster, "OnDask", Idle)
    return Heard()


def enter(heard: Heard) -> Any:
    return cluster.executor(
        workers=1,
        memory_bytes=2**30,
        scheduler=None,
        observer=heard,
        handshake=Handshake("imaging", "code", "mark", "content"),
    )


def begin(pool: Any) -> None:
    """Submit a job; nobody does it."""
    pool.submit(Job(Task("ground", "0_0", {}), "key"), None)


READY = WorkersReady()


def test_what_is_done_stays_done(heard: Heard) -> None:
    with enter(heard) as pool:
        begin(pool)
    assert heard.events == [READY]


def test_where_nothing_is_to_be_done_no_worker_is_started(heard: Heard) -> None:
    with enter(heard):
        pass
    assert heard.events == []


def test_a_task_that_has_no_answer_is_still_heard_of(heard: Heard) -> None:
    def run() -> None:
        with enter(heard) as pool:
            begin(pool)
            raise TimeoutError("of the task")

    with pytest.raises(TimeoutError, match="of the task"):
        run()
