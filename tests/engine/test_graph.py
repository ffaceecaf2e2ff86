"""Tasks are handed out in batches of small ones; what fails in one is done again by itself."""

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from spl_batch.airborne.context import Context
from spl_batch.airborne.plan.inputs.survey_inputs import Inputs
from spl_batch.airborne.plan.survey_ledger import Survey
from spl_batch.airborne.settings.workflow import parse_workflow
from spl_batch.airborne.steps import STEPS
from spl_batch.engine.tasks.task import Job, Outcome, Receipt, Task
from spl_batch.engine.verbs import graph

WORKFLOW = parse_workflow({"survey": {"flightlines": "a"}, "output": "o"}, "w")


class Pool:
    """Does every job, at the first time but for those named in ``fails``."""

    has_room = True

    def __init__(self, *fails: str) -> None:
        self.fails, self.batches = set(fails), list[list[str]]()
        self.waiting: deque[Sequence[Job]] = deque()

    def batch_of(self, count: int) -> int:
        return min(count, 3)

    def submit(self, jobs: Sequence[Job]) -> None:
        self.batches.append([job.task.name for job in jobs])
        self.waiting.append(jobs)

    def ended(self) -> list[Outcome]:
        return [self._done(job) for job in self.waiting.popleft()]

    def _done(self, job: Job) -> Outcome:
        if job.task.name in self.fails:
            self.fails.remove(job.task.name)
            return Outcome(job.need, None, again=("failed",))
        receipt = Receipt(job.task.kind, job.task.name, job.key, "d", "", {}, {}, 0, 0.0, 0.0)
        return Outcome(job.need, receipt)


@pytest.fixture
def progress(tmp_path: Path) -> Any:
    """A run that listens to nothing."""
    nothing = lambda *_: ()  # noqa: E731
    ledger = Survey(Inputs((), (), (), (), None, ()), WORKFLOW, 2**32, 2)  # type: ignore[arg-type]
    prepared = SimpleNamespace(
        ledger=ledger,
        context=Context(WORKFLOW, tmp_path, tmp_path, "", "code"),
        steps=STEPS,
        receiver=SimpleNamespace(before=nothing, after=nothing),
    )
    return SimpleNamespace(
        prepared=prepared, begins_again=False, failures=[], notify=nothing, warn=nothing,
        ended=nothing, found=nothing, deliveries=SimpleNamespace(save=nothing),
    )  # fmt: skip


def handed_out(progress: Any, points: Sequence[int], *fails: str) -> list[list[str]]:
    """Names in each batch of tasks with so many points."""

    def tasks(_: Survey) -> Iterator[Task]:
        for k, count in enumerate(points):
            yield Task("ground", f"{k}", {}, (), count)

    step, pool = replace(STEPS["ground"], tasks=tasks, bind=None), Pool(*fails)
    graph.Graph([step], pool, progress).run()  # type: ignore[arg-type]
    assert len(progress.prepared.ledger.of("ground")) == len(points)
    return pool.batches


def test_small_tasks_travel_together_and_large_ones_alone(progress: Any) -> None:
    most = graph.BATCH_POINTS
    points = (5, 5, 5, 5, most, 5, most - 5, 5, 0, 0)
    assert handed_out(progress, points) == [
        ["0", "1", "2"], ["3"], ["4"], ["5", "6"], ["7"], ["8"], ["9"]
    ]  # fmt: skip


def test_of_a_batch_what_failed_is_handed_out_by_itself(progress: Any) -> None:
    assert handed_out(progress, (5, 5, 5), "1") == [["0", "1", "2"], ["1"]]
