"""Expected cost of any run, tasks that cannot fit, and rates that a store has measured."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

from spl_batch.engine.plan.worker_memory import enough_mib, usable_bytes
from spl_batch.engine.store.working_store import Store, read_receipt, receipt_names
from spl_batch.engine.tasks.context import RunContext
from spl_batch.errors import PlanError, grouped
from spl_batch.receivers import steps

SAMPLE: Final = 1000
"""Receipts of a kind that measured rates are taken from, at most [count]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Cost:
    """What a run is expected to cost."""

    points: int  #: Points of all usable files [count].
    tasks: int
    disk_bytes: int
    memory_bytes: int  #: Memory of the heaviest task, its worker included [byte].
    #: That task, and the setting that makes it lighter.
    heaviest: str
    remedy: str
    stages_s: Mapping[str, float]  #: Time of each stage on one worker [s].
    workers: int
    measured: bool  #: Whether the rates were measured on this store.

    @property
    def time_s(self) -> float:
        """Wall time with these workers [s]."""
        return sum(self.stages_s.values()) / self.workers


def refuse_too_large(cost: Cost, limit: int, *, shared: bool = False) -> None:
    """Refuse a run whose heaviest task cannot fit into a worker.

    Parameters
    ----------
    cost : Cost
        What the run is expected to cost.
    limit : int
        Memory limit of a worker [byte].
    shared : bool
        Whether it is the workers' share of this machine: fewer have more each.

    Raises
    ------
    PlanError
        It names that task and what makes it lighter.
    """
    if cost.memory_bytes > usable_bytes(limit):
        enough, given = f"raise it to {enough_mib(cost.memory_bytes)}MiB", "--memory "
        if shared and cost.workers > 1:
            enough = f"use fewer workers, raise --memory{enough.removeprefix('raise it')}"
            given = f"the share of each of {grouped(cost.workers)} workers, "
        remedies = " or ".join(filter(None, (enough, cost.remedy)))
        raise PlanError(
            f"{cost.heaviest} needs {grouped(cost.memory_bytes / 2**20)} MiB, more than a task may "
            f"use of {given}{grouped(limit / 2**20)} MiB "
            f"({grouped(usable_bytes(limit) / 2**20)} MiB); {remedies}"
        )


def measured_rates(
    typical: Mapping[str, float], context: RunContext[Any] | None
) -> tuple[Mapping[str, float], bool]:
    """Points per second by stage: measured where the store holds receipts.

    Parameters
    ----------
    typical : mapping of str to float
        Points per second and worker where nothing was measured.

    Returns
    -------
    rates : mapping of str to float
        Points per second and worker.
    measured : bool
        Whether any of them was measured.
    """
    if context is None:
        return typical, False
    rates = dict(typical)
    measured = False
    known = steps(context.workflow.kind)
    for stage in rates:
        works = [_work(context.store, k) for k, v in known.items() if v.stage == stage]
        # The kinds of a stage handle the same points, one after the other.
        points, wall = max(w.points for w in works), sum(w.wall_s for w in works)
        if points > 0 and wall > 1.0:
            rates[stage] = points / wall
            measured = True
    return rates, measured


class _Work(NamedTuple):
    """What the finished tasks of a kind have handled [count] and taken [s], all together."""

    points: float
    wall_s: float


def _work(store: Store, kind: str) -> _Work:
    """Points and time of a kind of task, from a sample where there are many."""
    names = receipt_names(store, kind)
    made = (read_receipt(store, kind, name) for name in names[:SAMPLE])
    sample = [receipt for receipt in made if receipt and not receipt.failed]
    if not sample:
        return _Work(0.0, 0.0)
    share = max(len(names) / SAMPLE, 1.0)
    return _Work(share * sum(r.points for r in sample), share * sum(r.wall_s for r in sample))
