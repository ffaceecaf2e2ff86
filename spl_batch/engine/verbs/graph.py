"""The tasks of a run, handed out in an order in which each comes after what it needs.

A step's tasks are planned once the steps that its plan reads are over. Then each is handed out as
soon as what it needs has been, later steps first: the scheduler gets the futures of what is not
finished, so that one step begins where another has ended. What is finished is not handed out. Small
tasks of a step travel in one batch, as dask takes longer for a task than they do. A window bounds
what the scheduler holds.

A survey has as many tasks of a step as tiles, and each with its arguments takes kilobytes. So they
are made twice: once to see which are finished, once to be done. Only those on their way to a
worker, or about to be, exist.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import Any, Final

from spl_batch.engine.findings import of_receipts
from spl_batch.engine.flow.cluster import Executor
from spl_batch.engine.tasks.context import RunContext
from spl_batch.engine.tasks.ledger import Ledger
from spl_batch.engine.tasks.runner import failure, finished, task_key
from spl_batch.engine.tasks.step import Step
from spl_batch.engine.tasks.task import Job, Need, Outcome, Receipt, Task
from spl_batch.engine.verbs.progress import Progress
from spl_batch.engine.watch.events import PhaseStarted, TaskSettled
from spl_batch.errors import INTERRUPTED

BATCH_POINTS: Final = 100_000
"""Points of the tasks that travel together, at most: what a worker does in some tenths of a second
[count]."""


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
        self.pending: dict[str, Task] = {}  #: Tasks that are handed out and have not ended.
        self.missing: set[str] = set()  #: Tasks that failed or were left out.
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
        finished = {step: self._ledger.of(step) for step, _ in task.needs}
        found = {need: finished[need[0]].digest(need[1]) for need in task.needs
                 if need[1] in finished[need[0]]}  # fmt: skip
        open_ = [need for need in task.needs if need not in found and not self._is_over(need[0])]
        if open_:
            return Job(task, "", tuple(open_), found)
        bound = self.step.bound(task, found)
        if bound is None:
            return None
        return Job(bound, task_key(bound, self._context, map(found.get, bound.needs)))


class Graph:
    """Steps of a run, those that are to be done, from the first to the last."""

    def __init__(self, steps: Sequence[Step], pool: Executor, progress: Progress) -> None:
        self.prepared, self.pool, self.progress = progress.prepared, pool, progress
        self._steps = {step.name: step for step in steps}
        self._waiting, self._open = list(steps), dict[str, Worklist]()
        self._closed: set[str] = set()

    def run(self) -> None:
        """Do what is left to do."""
        while self._open or self._waiting:
            if INTERRUPTED.is_set():
                raise KeyboardInterrupt
            if not self.progress.begins_again:
                self._close_steps()
                self._open_steps()
                while self.pool.has_room and self._hand_out():
                    pass
            if any(one.pending for one in self._open.values()):
                for outcome in self.pool.ended():
                    self._ended(outcome)
            elif self.progress.begins_again:
                return

    def _is_closed(self, name: str) -> bool:
        return name in self._closed or name not in self._steps

    def _is_over(self, name: str) -> bool:
        """Whether nothing more is to come of a step."""
        one = self._open.get(name)
        return self._is_closed(name) if one is None else one.head is None and not one.pending

    def _open_steps(self) -> None:
        """Open each step of which all is over that its plan reads."""
        order = [*self.prepared.steps]
        for step in [*self._waiting]:
            reads = order[: order.index(step.name)] if step.after is None else step.after
            if all(map(self._is_closed, reads)):
                self._waiting.remove(step)
                self._begin(step)
                self._close_steps()

    def _begin(self, step: Step) -> None:
        """See what a step has left to do, and report it."""
        prepared, progress = self.prepared, self.progress
        work = Worklist(step, prepared.ledger, prepared.context, self._is_over)
        for receipt in work.look():
            progress.found(step.stage, receipt)
        if work.left or work.ready:
            event = PhaseStarted(step.stage, step.name, work.left, work.ready, work.points)
            progress.notify(event)
        work.advance()
        self._open[step.name] = work

    def _settled(self, one: Worklist, task: Task, *, found: bool = False) -> None:
        """Report that a task needs no doing: it was finished, or misses what it needs."""
        if not found:
            one.missing.add(task.name)
        stage = one.step.stage
        self.progress.notify(TaskSettled(stage, task.kind, task.name, task.points, found))

    def _hand_out(self) -> bool:
        """Hand out a batch of tasks, of the latest step that can; whether there was one."""
        return any(self._hand_out_of(one) for one in reversed(self._open.values()))

    def _hand_out_of(self, one: Worklist) -> bool:
        """Hand out the next tasks of a step, or find that they are none; whether it could."""
        first, jobs, points = one.head, list[Job](), 0
        most = self.pool.batch_of(one.left)
        while one.head is not None and len(jobs) < most and self._can_begin(one, one.head):
            weight = one.head.weight or BATCH_POINTS
            if jobs and points + weight > BATCH_POINTS:
                break
            found = self._settle(one, one.head)
            if found is not None:
                jobs.append(found)
                points += weight
        if jobs:
            self.pool.submit(jobs)
        return one.head is not first

    def _can_begin(self, one: Worklist, task: Task) -> bool:
        """Whether all that the next task of a step needs is known."""
        if one.awaited is None or self._is_known(one.awaited):
            one.awaited = next((need for need in task.needs if not self._is_known(need)), None)
        return one.awaited is None

    def _settle(self, one: Worklist, task: Task) -> Job | None:
        """The next task of a step as a job to be handed out; None where it is none."""
        one.advance()
        job = one.job(task)
        if job is None:
            self._settled(one, task)
            return None
        one.pending[task.name] = task
        if task.refused:
            self._ended(Outcome(job.need, failure(task, job.key, task.refused, code="F02")))
            return None
        return job

    def _is_known(self, need: Need) -> bool:
        """Whether a task is handed out, has ended, or will never be."""
        step, name = need
        one = self._open.get(step)
        if name in self.prepared.ledger.of(step):
            return True
        if one is None:
            return self._is_closed(step)
        return one.head is None or name in one.pending or name in one.missing

    def _ended(self, outcome: Outcome) -> None:
        """Take in what has come of a task."""
        step, name = outcome.need
        one, receipt = self._open[step], outcome.receipt
        task = one.pending[name]
        if outcome.again is not None and (job := one.job(task)):
            self.pool.submit([job._replace(tried=outcome.again)])
            return
        del one.pending[name]
        if receipt is None:
            self._settled(one, task)
            return
        if receipt.failed:
            one.missing.add(name)
        else:
            self.prepared.ledger.of(step).put(receipt)
        if outcome.found:
            self.progress.found(one.step.stage, receipt)
            self._settled(one, task, found=True)
        else:
            self.progress.ended(task, receipt)

    def _close_steps(self) -> None:
        """End steps that are over, in order: what they have brought to light is reported so."""
        prepared, progress = self.prepared, self.progress
        for name, step in self._steps.items():
            if name in self._closed:
                continue
            if name not in self._open or not self._is_over(name):
                return
            prepared.ledger.of(name).sort()
            if step.delivers:
                progress.deliveries.save()
            del self._open[name]
            self._closed.add(name)
            failed = [receipt for _, receipt in progress.failures]
            progress.warn(prepared.receiver.after(step, prepared, failed))
            progress.warn(of_receipts(prepared.ledger.of(name)))
