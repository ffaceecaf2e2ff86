"""The tasks of a step one by one: which are finished, which are left, none kept.

A survey has as many tasks of a kind as tiles, and each with its arguments takes kilobytes. So they
are made twice: once to see which are finished, once to be done. Only those on their way to a
worker, or about to be, exist.
"""

from collections.abc import Iterator
from itertools import islice
from typing import Any, Final

from spl_batch.engine.tasks.context import RunContext
from spl_batch.engine.tasks.ledger import Ledger
from spl_batch.engine.tasks.runner import failure, finished, task_key
from spl_batch.engine.tasks.step import Step
from spl_batch.engine.tasks.task import Receipt, Task

SORTED: Final = 64
"""Tasks of which the largest is handed out first [count]: in a small survey the last ones decide
when a step ends, and so are small."""


class Worklist:
    """What one step has to do.

    Parameters
    ----------
    step : Step
        The step; those before it are done.
    ledger : Ledger
        What is finished so far; what this step finishes is added to it.
    verify : bool
        Whether finished outputs are compared with their checksums.

    Attributes
    ----------
    left, ready : int
        Tasks to do, and those that :meth:`look` found finished [count].
    points : int
        Points that the tasks to do will handle [count].
    refused : list of Receipt
        Failures of tasks that cannot be started.
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
    ) -> None:
        self.left = self.ready = self.points = 0
        self.refused: list[Receipt] = []
        self.altered: list[str] = []
        self._step, self._ledger, self._context = step, ledger, context
        self._verify = verify
        self._done = ledger.of(step.name)
        self._out: dict[str, Task] = {}

    def look(self) -> Iterator[tuple[Task, Receipt | None]]:
        """Count the tasks; each, with its receipt where it is finished already."""
        self.left = self.ready = self.points = 0
        self.refused.clear()
        self.altered.clear()
        for task in self._step.planned(self._ledger):
            key = self.key(task)
            receipt = finished(task, key, self._context, verify=self._verify, altered=self.altered)
            if receipt is not None:
                self.ready += 1
                self._done.put(receipt)
            else:
                self.left += 1
                self.points += task.points
                if task.refused:
                    self.refused.append(failure(task, key, task.refused))
                    self._out[task.name] = task
            yield task, receipt

    def jobs(self) -> Iterator[tuple[Task, str]]:
        """Tasks to do, and their keys, made when they are asked for; of some the largest first."""
        made = self._step.planned(self._ledger)
        left = (task for task in made if not task.refused and task.name not in self._done)
        while some := list(islice(left, SORTED)):
            for task in sorted(some, key=lambda task: -task.points):
                self._out[task.name] = task
                yield task, self.key(task)

    def ended(self, receipt: Receipt) -> Task:
        """Put what a task has left on the shelf; the task, which is now forgotten."""
        if not receipt.failed:
            self._done.put(receipt)
        return self._out.pop(receipt.name)

    def key(self, task: Task) -> str:
        """Hash of everything that a task's result depends on."""
        digests = (self._ledger.of(kind).digest(name) for kind, name in task.needs)
        return task_key(task, self._context, digests)
