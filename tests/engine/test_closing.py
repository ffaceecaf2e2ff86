"""Workers that do not end in time spoil no run whose tasks are done."""

import contextlib
from collections.abc import Iterator
from typing import Any, Self

import pytest

from spl_batch.engine.flow import cluster
from spl_batch.engine.flow.job import Footing
from spl_batch.engine.tasks.task import Job, Task


class Heard:
    """An observer that remembers what it is told of workers."""

    def __init__(self) -> None:
        self.notes: list[str] = []

    def ready(self, scheduler: str, dashboard: str) -> None:
        self.notes.append(f"ready: {scheduler or 'here'} {dashboard or 'without a dashboard'}")

    def started(self, task: Any, worker: str) -> None:
        """Nothing begins here."""

    def seen(self, workers: Any) -> None:
        """Nobody is there to be seen."""

    def noted(self, text: str) -> None:
        self.notes.append(text)


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

    def submit(self, *_: object) -> None:
        """Nothing is done."""

    def close(self) -> None:
        """There is nothing to let go of."""


@pytest.fixture
def heard(monkeypatch: pytest.MonkeyPatch) -> Heard:
    monkeypatch.setattr(cluster, "local_cluster", slow_to_end)
    monkeypatch.setattr("distributed.Client", Client)
    monkeypatch.setattr(cluster, "OnDask", lambda *_, **__: Idle())
    return Heard()


def enter(heard: Heard) -> Any:
    return cluster.executor(
        workers=1,
        memory_bytes=2**30,
        scheduler=None,
        observer=heard,
        footing=Footing("imaging", "code", "mark", "content"),
    )


def begin(pool: Any) -> None:
    """Submit a job; nobody does it."""
    pool.submit(Job(Task("ground", "0_0", {}), "key"), None)


READY = "ready: here without a dashboard"


def test_what_is_done_stays_done(heard: Heard) -> None:
    with enter(heard) as pool:
        begin(pool)
    assert heard.notes == [READY]


def test_where_nothing_is_to_be_done_no_worker_is_started(heard: Heard) -> None:
    with enter(heard):
        pass
    assert heard.notes == []


def fail(pool: Any) -> None:
    begin(pool)
    raise TimeoutError("of the task")


def test_a_task_that_has_no_answer_is_still_heard_of(heard: Heard) -> None:
    with pytest.raises(TimeoutError, match="of the task"), enter(heard) as pool:
        fail(pool)
    assert heard.notes == [READY]
