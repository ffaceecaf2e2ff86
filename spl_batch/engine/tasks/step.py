"""Steps of a receiver: what kinds of task there are, declared once.

Plan, run, status, report, the keys of receipts, progress, cost and remedies read this table.
"""

from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

from spl_batch.engine.tasks.context import TaskFunction
from spl_batch.engine.tasks.task import Need, Task
from spl_batch.receivers import load, steps


@dataclass(frozen=True, slots=True, kw_only=True)
class Step:
    """A kind of task."""

    name: str  #: What its receipts and the log call it.
    stage: str  #: Stage of the command line that it belongs to.
    #: Its function, or where that lies, as ``module:name``: planning and looking at a run load no
    #: kernels, and workers load no plan.
    run: TaskFunction | str
    #: Makes its tasks of the receiver's ledger, of what earlier steps have finished; likewise.
    tasks: Callable[[Any], Iterator[Task]] | str
    settings: tuple[str, ...] = ()  #: Parts of the workflow that its result depends on.
    #: Steps whose receipts its plan reads: its tasks are made when these are over. All that are
    #: declared before it, unless stated otherwise. What its tasks need beyond that reaches them as
    #: it is finished.
    after: tuple[str, ...] | None = None
    #: Of a task's arguments and what is finished of its needs: the arguments that it is done with,
    #: or None where it is left out. Or where that function lies. Without one a task is left out
    #: that misses anything.
    bind: Callable[[Mapping[str, Any], Collection[Need]], Any] | str | None = None
    unit: str = ""  #: What a user calls that which one of its tasks works on, such as ``tile``.
    delivers: bool = False  #: Whether users see what its tasks write.
    bytes_per_point: int = 0  #: Peak memory by each point that a task holds at once [byte].
    remedy: str = ""  #: What makes its tasks lighter where memory is short.

    @property
    def modules(self) -> list[str]:
        """Names of the modules that hold what workers call."""
        targets = [one for one in (self.run, self.bind) if one is not None]
        return [p.partition(":")[0] if isinstance(p, str) else p.__module__ for p in targets]

    def loaded(self) -> TaskFunction:
        """The function itself."""
        if not isinstance(self.run, str):
            return self.run
        found: TaskFunction = load(self.run)
        return found

    def planned(self, ledger: Any) -> Iterator[Task]:
        """Its tasks."""
        make = load(self.tasks) if isinstance(self.tasks, str) else self.tasks
        yield from make(ledger)

    def bound(self, task: Task, found: Collection[Need]) -> Task | None:
        """A task with what is finished of its needs; None where it is left out."""
        needs = tuple(need for need in task.needs if need in found)
        if self.bind is None:
            return task if len(needs) == len(task.needs) else None
        bind = load(self.bind) if isinstance(self.bind, str) else self.bind
        args = bind(task.args, found)
        return None if args is None else replace(task, args=args, needs=needs)


Steps = Mapping[str, Step]
"""Steps of a receiver by name, in order."""


def table(*declared: Step) -> Steps:
    """Steps by name, in the order in which they are done."""
    return MappingProxyType({step.name: step for step in declared})


def stages(receiver: str) -> tuple[str, ...]:
    """Stages of a receiver's run, in order; the report comes last."""
    return (*dict.fromkeys((*(step.stage for step in steps(receiver).values()), "report")),)


def delivering(receiver: str) -> list[str]:
    """Names of the steps of a receiver whose outputs a user sees."""
    return [step.name for step in steps(receiver).values() if step.delivers]
