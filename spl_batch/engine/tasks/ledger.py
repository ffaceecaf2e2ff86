"""Ledger of a run: its inputs, what is finished, and how phases make tasks of that.

Every receiver's plan is a list of :class:`Phase` over a :class:`Ledger` of its own.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar

from spl_batch.engine.findings import Finding
from spl_batch.engine.settings.base import BaseWorkflow
from spl_batch.engine.tasks.receipt_index import Shelf
from spl_batch.engine.tasks.task import Task
from spl_batch.errors import InputError


class AnySource(Protocol):
    """An input file that can be used."""

    @property
    def path(self) -> Path:
        """Where it lies."""

    @property
    def name(self) -> str:
        """What messages call it."""

    @property
    def key(self) -> int:
        """What tasks call it; depends on its name alone."""


class AnyInputs(Protocol):
    """Everything that a workflow names, checked."""

    @property
    def sources(self) -> Sequence[AnySource]:
        """Input files that can be used, by name."""

    @property
    def bad(self) -> Sequence[InputError]:
        """Input files that cannot."""

    @property
    def warnings(self) -> Sequence[Finding]:
        """What a user should know before the work starts."""


I = TypeVar("I", bound=AnyInputs)  # noqa: E741
W = TypeVar("W", bound=BaseWorkflow)


@dataclass
class Ledger(Generic[I, W]):
    """What a run knows so far: inputs, limits, and the receipts of what is finished.

    ``shared``: the memory limit is the workers' share of this machine, unless told otherwise.
    ``remarks``: oddities of the limits.
    """

    inputs: I
    workflow: W
    memory_bytes: int
    workers: int
    done: dict[str, Shelf] = field(default_factory=dict)
    shared: bool = False
    remarks: tuple[Finding, ...] = ()

    def of(self, kind: str) -> Shelf:
        """Finished tasks of a kind, by name."""
        return self.done.setdefault(kind, Shelf(kind))


@dataclass(frozen=True, slots=True)
class Phase:
    """Tasks of one kind, made when everything before them is finished."""

    kind: str
    #: Makes them of the receiver's ledger; it looks at earlier phases only.
    tasks: Callable[[Any], Iterator[Task]]
    #: Whether it does not look at the phase before it either: both are done at once.
    beside: bool = False


def waves(phases: Iterable[Phase]) -> Iterator[list[Phase]]:
    """Phases that are done at once, in order."""
    wave: list[Phase] = []
    for phase in phases:
        if wave and not phase.beside:
            yield wave
            wave = []
        wave.append(phase)
    if wave:
        yield wave
