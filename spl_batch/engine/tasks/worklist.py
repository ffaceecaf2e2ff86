"""The tasks of a step one by one: which are finished, which are left, none kept.

A survey has as many tasks of a step as tiles, and each with its arguments takes kilobytes. So they
are made twice: once to see which are finished, once to be done. Only those on their way to a
worker, or about to be, exist.
"""

from collections.abc import Callable, Iterator
from typing import Any

from spl_batch.engine.tasks.context import RunContext
from spl_batch.engine.tasks.ledger import Ledger
from spl_batch.engine.tasks.runner import finished, task_key
from spl_batch.engine.tasks.step import Step
from spl_batch.engine.tasks.task import Job, Need, Receipt, Task


class Worklist:
    """What one step has to do; ``is_over``: whether nothing more is to come of another one."""

    def __init__(
        self,
        step: Step,
        ledger: Ledger[Any, Any],
        context: RunContext[Any],
        is_over: Callable[[str], bool] = lambda _: True,
    ) -> None:
        self.left = self.ready = 0  #: Tasks to do, and those that :meth:`look` found finished.
        self.points = 0  #: Points that the tasks to do will handle [count].
        self.head: Task | None = None  #: The next one to do, once :meth:`advance` was called.
        self.awaited: Need | None = None  #: What keeps it from being handed out.
        self.pending = 0  #: Tasks that are handed out and have not ended [count].
        self._rest: Iterator[Task] | None = None
        self._left_out: set[str] = set()
        self.step, self._ledger, self._context, self._is_over = step, ledger, context, is_over
        self._done = ledger.of(step.name)

    def look(self) -> Iterator[Receipt]:
        """Count the tasks; receipts of those that are finished already."""
        self.left = self.ready = self.points = 0
        for task in self.step.planned(self._ledger):
            job = self.job(task)
            if job is None:
                self._left_out.add(task.name)
                continue
            receipt = finished(job.task, job.key, self._context) if job.key else None
            if receipt is not None:
                self.ready += 1
                self._done.put(receipt)
                yield receipt
            else:
                self.left += 1
                self.points += task.points

    def tasks(self) -> Iterator[Task]:
        """Tasks that no look has found finished, made when they are asked for."""
        made = self.step.planned(self._ledger)
        return (t for t in made if t.name not in self._done and t.name not in self._left_out)

    def advance(self) -> None:
        """Go on to the next task."""
        self._rest = self.tasks() if self._rest is None else self._rest
        self.head, self.awaited = next(self._rest, None), None

    def job(self, task: Task) -> Job | None:
        """A task that can be done, with its key unless some of what it needs is still to come.

        None where something is missing that it cannot be done without.
        """
        shelves = {step: self._ledger.of(step) for step, _ in task.needs}
        found = {need: shelves[need[0]].digest(need[1]) for need in task.needs
                 if need[1] in shelves[need[0]]}  # fmt: skip
        open_ = [need for need in task.needs if need not in found and not self._is_over(need[0])]
        if open_:
            return Job(task, "", tuple(open_), found)
        bound = self.step.bound(task, found)
        if bound is None:
            return None
        return Job(bound, task_key(bound, self._context, map(found.get, bound.needs)))
