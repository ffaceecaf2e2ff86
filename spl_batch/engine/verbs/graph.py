"""The tasks of a run, handed out in an order in which each comes after what it needs.

A step's tasks are planned once the steps that its plan reads are over. Then each is handed out as
soon as what it needs has been, later steps first: the scheduler gets the futures of what is not
finished, so that one step begins where another has ended. What is finished is not handed out. A
window bounds what the scheduler holds.
"""

import threading
from collections.abc import Sequence
from functools import cache
from typing import Any

from spl_batch.engine.findings import of_receipts
from spl_batch.engine.flow.job import Executor
from spl_batch.engine.report.run_record import StageCost
from spl_batch.engine.tasks.step import Step
from spl_batch.engine.tasks.task import Job, Need, Outcome, Receipt, Task
from spl_batch.engine.tasks.worklist import Worklist
from spl_batch.engine.verbs.progress import Progress
from spl_batch.engine.verbs.receiver import Prepared, Receiver
from spl_batch.engine.watch.events import PhaseStarted, TaskSettled
from spl_batch.errors import named


class _Open:
    """A step whose tasks are known."""

    def __init__(self, step: Step, work: Worklist) -> None:
        self.step, self.work = step, work
        self.tasks = work.tasks()
        self.head: Task | None = next(self.tasks, None)
        self.awaited: Need | None = None  #: What keeps its next task from being handed out.
        self.pending = 0  #: Tasks that are handed out and have not ended [count].

    def advance(self) -> None:
        """Go on to the next task."""
        self.head, self.awaited = next(self.tasks, None), None


class Graph:
    """Steps of a run, from the first to the last.

    Parameters
    ----------
    steps : sequence of Step
        Those that are to be done, in order.
    verify : bool
        Whether finished outputs are compared with their checksums.
    reports : bool
        Whether a report follows.
    """

    def __init__(
        self,
        prepared: Prepared[Any, Any],
        steps: Sequence[Step],
        pool: Executor,
        progress: Progress,
        *,
        verify: bool,
        reports: bool,
    ) -> None:
        self.prepared, self.pool, self.progress = prepared, pool, progress
        self._verify, self._reports = verify, reports
        self._steps = {step.name: step for step in steps}
        self._waiting, self._open = list(steps), dict[str, _Open]()
        self._missing: set[Need] = set()  # tasks of open steps that failed or were left out
        self._closed: set[str] = set()
        self._pending: dict[Need, Task] = {}
        self._ends_early = False  # a file of the store is to be made again first

    def run(self) -> None:
        """Do what is left to do."""
        while True:
            self._close_steps()
            self._open_steps()
            if not self._ends_early:
                while len(self._pending) < self.pool.window and self._hand_out():
                    pass
            if self._pending:
                self._ended(self.pool.ended())
            elif self._ends_early or not (self._open or self._waiting):
                return

    def _is_over(self, name: str) -> bool:
        """Whether nothing more is to come of a step."""
        one = self._open.get(name)
        return self._is_closed(name) if one is None else one.head is None and not one.pending

    def _open_steps(self) -> None:
        """Open each step of which all is over that its plan reads."""
        while not self._ends_early:
            for step in self._waiting:
                before = [*self.prepared.steps]
                before = before[: before.index(step.name)]
                if all(map(self._is_closed, before if step.after is None else step.after)):
                    self._waiting.remove(step)
                    self._begin(step)
                    break
            else:
                return
            self._close_steps()

    def _is_closed(self, name: str) -> bool:
        return name in self._closed or name not in self._steps

    def _begin(self, step: Step) -> None:
        """See what a step has left to do, and report it."""
        prepared, progress = self.prepared, self.progress
        prepared.receiver.before(step, prepared)
        work = Worklist(
            step,
            prepared.ledger,
            prepared.context,
            verify=self._verify,
            is_over=self._is_over,
        )
        for _, receipt in work.look():
            if receipt is not None:
                self._found(step, receipt)
        if work.altered:
            progress.note(f"gone or not as written, made again: {named(work.altered)}")
        if work.left or work.ready:
            event = PhaseStarted(step.stage, step.name, work.left, work.ready, work.points)
            progress.tell(event)
        self._open[step.name] = _Open(step, work)

    def _found(self, step: Step, receipt: Receipt) -> None:
        """Take note of a task that was finished before."""
        self.progress.deliveries.wrote(receipt)
        self.progress.costs.setdefault(step.stage, StageCost()).skip(receipt)

    def _settled(self, step: Step, task: Task, *, found: bool = False) -> None:
        """Report that a task needs no doing: it was finished, or misses what it needs."""
        if not found:
            self._missing.add((step.name, task.name))
        self.progress.tell(TaskSettled(step.stage, step.name, task.name, task.points, found))

    def _hand_out(self) -> bool:
        """Hand out one task, of the latest step that can; whether there was one."""
        return any(self._settle(one) for one in reversed(self._open.values()))

    def _settle(self, one: _Open) -> bool:
        """Hand out the next task of a step, or find that it is none; whether it could."""
        if one.head is None or (one.awaited is not None and not self._is_known(one.awaited)):
            return False
        one.awaited = next((need for need in one.head.needs if not self._is_known(need)), None)
        if one.awaited is not None:
            return False
        task = one.head
        one.advance()
        job = one.work.job(task)
        if job is None:
            self._settled(one.step, task)
            return True
        one.pending += 1
        self._pending[job.need] = task
        refused = one.work.refusal(job)
        if refused is not None:
            self._ended(Outcome(job.need, refused))
        else:
            self._submit(job)
        return True

    def _submit(self, job: Job) -> None:
        if self._reports and self.progress.invocation.workers:
            _load_meanwhile(self.prepared.receiver)
        self.pool.submit(job, self.prepared.context)

    def _is_known(self, need: Need) -> bool:
        """Whether a task is handed out, has ended, or will never be."""
        step, name = need
        if need in self._pending or name in self.prepared.ledger.of(step):
            return True
        one = self._open.get(step)
        if one is None:
            return self._is_closed(step)
        return one.head is None or need in self._missing

    def _ended(self, outcome: Outcome) -> None:
        """Take in what has come of a task."""
        task = self._pending[outcome.need]
        one, receipt = self._open[outcome.need[0]], outcome.receipt
        if outcome.again:
            job = one.work.job(task)
            if job is not None:
                self._submit(job)
                return
        del self._pending[outcome.need]
        one.pending -= 1
        if receipt is None:
            self._settled(one.step, task)
            return
        ledger = self.prepared.ledger
        if not receipt.failed:
            ledger.of(receipt.kind).put(receipt)
        if outcome.found:
            self._found(one.step, receipt)
            self._settled(one.step, task, found=True)
            return
        self.progress.deliveries.wrote(receipt)
        self.progress.ended(task, receipt)
        if receipt.failed:
            self._missing.add(outcome.need)
            if self.progress.can_mend(receipt):
                self._ends_early = True

    def _close_steps(self) -> None:
        """End steps that are over, in order: what they have brought to light is reported so."""
        prepared, progress = self.prepared, self.progress
        for name, step in self._steps.items():
            if name in self._closed:
                continue
            if self._ends_early or name not in self._open or not self._is_over(name):
                return
            prepared.ledger.of(name).sort()
            if step.delivers:
                progress.deliveries.save()
            del self._open[name]
            self._closed.add(name)
            self._missing = {need for need in self._missing if need[0] != name}
            progress.warn(prepared.receiver.after(step, prepared, progress.failed))
            progress.warn(prepared.receiver.aside(step, prepared))
            progress.warn(of_receipts(prepared.ledger.of(name)))


@cache
def _load_meanwhile(receiver: Receiver[Any, Any]) -> None:
    """Once, load what is needed in the end, as long as workers do the work."""
    threading.Thread(target=receiver.load_report, name="load report", daemon=True).start()
