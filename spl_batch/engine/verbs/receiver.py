"""What the verbs need of a receiver: inputs, cost, findings, a report.

Everything else, tasks on workers, receipts, resume, isolation of failures, progress, is the
same for all of them. A receiver is named by the ``kind`` of a workflow
(:mod:`spl_batch.receivers`).
"""

from abc import ABC, abstractmethod
from collections.abc import Container, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Generic, NamedTuple, NoReturn, TypeVar

from spl_batch.engine.findings import Finding
from spl_batch.engine.flow.warm_up import WarmUp
from spl_batch.engine.plan.budget import Cost
from spl_batch.engine.tasks.context import RunContext
from spl_batch.engine.tasks.input_changes import stamp_if_there
from spl_batch.engine.tasks.ledger import Ledger
from spl_batch.engine.tasks.step import Step, Steps
from spl_batch.engine.tasks.task import Receipt
from spl_batch.errors import WorkflowError
from spl_batch.receivers import steps


def none_usable(
    failed: Iterable[Receipt], kinds: Container[str], more: Iterable[str] = ()
) -> NoReturn:
    """What stops a run of which no file could be read.

    Raises
    ------
    WorkflowError
        Always, with the reasons of the failed tasks of some kinds, and ``more``.
    """
    reasons = [*(receipt.reason for receipt in failed if receipt.kind in kinds), *more]
    raise WorkflowError("no input is usable: " + ("; ".join(reasons) or "they hold nothing"))


L = TypeVar("L", bound=Ledger[Any, Any])
C = TypeVar("C", bound=RunContext[Any])


@dataclass(frozen=True, slots=True)
class Prepared(Generic[L, C]):
    """A run that could start."""

    receiver: "Receiver[L, C]"
    ledger: L
    context: C

    @property
    def steps(self) -> Steps:
        """What its tasks do."""
        found: Steps = steps(self.context.workflow.kind)
        return found


class FirstLook(NamedTuple):
    """What a plan finds in the inputs."""

    faults: tuple[str, ...] = ()  #: What is wrong with some of them, which a run leaves out.
    #: Inputs whose points cannot be read though their headers can, and what these promise [count];
    #: ``faults`` has the reasons.
    unreadable: int = 0
    unreadable_points: int = 0
    late: tuple[str, ...] = ()  #: What is wrong with files that a run reads only at its end.


class Receiver(ABC, Generic[L, C]):
    """What the verbs need of a receiver."""

    ledger: ClassVar[type[Ledger[Any, Any]]]  #: What a run knows.
    context: ClassVar[type[RunContext[Any]]] = RunContext  #: What its tasks are given.
    #: Patterns of the files that its runs deliver, below the output.
    delivered: ClassVar[tuple[str, ...]] = ()

    def warm_up(self, workflow: Any, until: str | None, workers: int) -> WarmUp | None:
        """What compiles the kernels that tasks call up to a stage; None where there are none."""
        del workflow, until, workers
        return None

    @abstractmethod
    def gather(self, workflow: Any, base: Path, output: Path) -> Any:
        """Find and check every file of a workflow, from headers alone.

        What it gives may have their ``crs``. ``output``: folder of the results: no input may lie
        there.

        Raises
        ------
        WorkflowError
            If nothing can be started; one line with every fault.
        """

    @abstractmethod
    def cost(self, prepared: Prepared[L, C]) -> Cost:
        """What a run is expected to cost."""

    @abstractmethod
    def plan_rows(self, prepared: Prepared[L, C], cost: Any) -> list[tuple[str, str]]:
        """Label and value of what a plan shows beside disk, memory and time."""

    def first_look(self, prepared: Prepared[L, C]) -> FirstLook:
        """Faults and findings of the inputs that reading a little of them shows.

        Raises
        ------
        WorkflowError
            If that little shows that a run would come to nothing: neither verb starts.
        """
        del prepared
        return FirstLook()

    def after(
        self, step: Step, prepared: Prepared[L, C], failed: Sequence[Receipt]
    ) -> Iterable[Finding]:
        """Findings that a step has brought to light, notes for the operator among them.

        Raises
        ------
        WorkflowError
            If nothing is left to go on with.
        """
        del step, prepared, failed
        return ()

    def reference(self, ledger: L) -> list[str]:
        """Files that the results are compared with."""
        del ledger
        return []

    def decisive(self, prepared: Prepared[L, C]) -> list[Any]:
        """What decides the results beside workflow and inputs, as plain JSON values."""
        return [[name, *stamp_if_there(Path(name))] for name in self.reference(prepared.ledger)]

    def not_read(self, ledger: L) -> int:
        """Points that files promise which could not be read to their end [count]."""
        del ledger
        return 0

    @abstractmethod
    def screen(self, report: Any) -> list[tuple[str, str]]:
        """Label and value of each number that the console shows after a run."""

    @abstractmethod
    def results(self, output: Path) -> list[tuple[str, list[Path]]]:
        """Label and paths of what a user looks at first; those that are missing are left out."""
