"""Expected cost of any run, tasks that cannot fit, and rates that a store has measured."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from spl_batch.engine.plan.worker_memory import enough_mib, usable_bytes
from spl_batch.engine.report.run_record import recall
from spl_batch.engine.tasks.context import RunContext
from spl_batch.errors import PlanError, StoreError, grouped


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
    """Points per second and worker by stage, and whether any was measured by the last run here.

    Parameters
    ----------
    typical : mapping of str to float
        Points per second and worker where nothing was measured.
    """
    try:
        costs = recall(context.output)["facts"]["costs"] if context is not None else {}
    except (StoreError, KeyError):  # no run has finished here, or one of another version
        costs = {}
    # The kinds of a stage handle the same points, one after the other.
    found = {
        stage: most / cost["wall_s"]
        for stage, cost in costs.items()
        if stage in typical
        and (most := max(cost["points"].values(), default=0))
        and cost["wall_s"] > 1.0
    }
    return {**typical, **found}, bool(found)
