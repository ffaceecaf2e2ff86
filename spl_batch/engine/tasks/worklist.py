"""The tasks of a step one by one: which are finished, which are left, none kept.

A survey has as many tasks of a step as tiles, and each with its arguments takes kilobytes. So they
are made twice: once to see which are finished, once to be done. Only those on their way to a
worker, or about to be, exist.
"""

from collections.abc import Callable, Iterator, Mapping
from typing import Any

from spl_batch.engine.tasks.context import RunContext
from spl_batch.engine.tasks.ledger import Ledger
from spl_batch.engine.tasks.runner import failure, finished, task_key
from spl_batch.engine.tasks.step import Step
from spl_batch.engine.tasks.task import Job, Need, Receipt, Task


class Worklist:
    """What one step has to do.

    Parameters
    ----------
    step : Step
        The step; those that its plan reads are over.
    ledger : Ledger
        What is finished so far; what this step finishes is added to it.
    verify : bool
        Whether finished outputs are compared with their checksums.
    is_over : callable
        Whether nothing more is to come of a step, by its name; so of all of them by default.

    Attributes
    ----------
    left, ready : int
        Tasks to do, and those that :meth:`look` found finished [count].
    points : int
        Points that the tasks to do will handle [count].
    altered : list of str
        An output of each task that is done again as it is not as it was written.
    """

    def __init__(
        self,
        step: Step,
        ledger: Ledger[Any, Any],
        context: RunContext[Any],
        *,
        verify: bool = False,
        is_over: Callable[[str], bool] = lambda _: True,
    ) -> None:
        self.left = self.ready = self.points = 0
        self.altered: list[str] = []
        self._left_out: set[str] = set()
        self.step, self._ledger, self._context = step, ledger, context
        self._verify, self._is_over = verify, is_over
        self._done = ledger.of(step.name)

    def look(self) -> Iterator[tuple[Task, Receipt | None]]:
        """Count the tasks; each, with its receipt where it is finished already."""
        self.left = self.ready = self.points = 0
        self.altered.clear()
        for task in self.step.planned(self._ledger):
            job = self.job(task)
            if job is None:
                self._left_out.add(task.name)
                continue
            receipt = self._finished(job) if job.key else None
            if receipt is not None:
                self.ready += 1
                self._done.put(receipt)
            else:
                self.left += 1
                self.points += task.points
            yield task, receipt

    def tasks(self) -> Iterator[Task]:
        """Tasks that no look has found finished, made when they are asked for."""
        made = self.step.planned(self._ledger)
        return (t for t in made if t.name not in self._done and t.name not in self._left_out)

    def job(self, task: Task) -> Job | None:
        """A task that can be done, with its key unless some of what it needs is still to come.

        None where something is missing that it cannot be done without.
        """
        found = _Found(self._ledger, task.needs)
        open_ = [need for need in task.needs if need not in found and not self._is_over(need[0])]
        if open_:
            return Job(task, "", tuple(open_), tuple(found.lean()))
        if task.refused:
            return Job(task, "refused")
        bound = self.step.bound(task, found)
        return None if bound is None else Job(bound, self.key(bound))

    def refusal(self, job: Job) -> Receipt | None:
        """Failure of a task that cannot be started; None for one that can."""
        return (
            failure(job.task, job.key, job.task.refused, code="F02") if job.task.refused else None
        )

    def key(self, task: Task) -> str:
        """Hash of everything that a task's result depends on."""
        digests = (self._ledger.of(step).digest(name) for step, name in task.needs)
        return task_key(task, self._context, digests)

    def _finished(self, job: Job) -> Receipt | None:
        altered = self.altered
        return finished(job.task, job.key, self._context, verify=self._verify, altered=altered)


class _Found(Mapping[Need, Receipt]):
    """What is finished of what a task needs."""

    def __init__(self, ledger: Ledger[Any, Any], needs: tuple[Need, ...]) -> None:
        self._ledger = ledger
        self._needs = needs

    def __contains__(self, need: object) -> bool:
        return isinstance(need, tuple) and need[1] in self._ledger.of(need[0])

    def __getitem__(self, need: Need) -> Receipt:
        return self._ledger.of(need[0])[need[1]]

    def __iter__(self) -> Iterator[Need]:
        return (need for need in self._needs if need in self)

    def __len__(self) -> int:
        return sum(1 for _ in self)

    def lean(self) -> Iterator[Receipt]:
        """Receipts as keys need them, without facts and outputs."""
        for step, name in self:
            digest = self._ledger.of(step).digest(name)
            yield Receipt(step, name, "", digest, "", {}, {}, 0, 0.0, 0.0)
