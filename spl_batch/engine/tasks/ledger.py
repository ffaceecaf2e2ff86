"""Ledger of a run: its inputs, its limits, and what is finished."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Generic, Protocol, TypeVar

from spl_batch.engine.findings import Finding
from spl_batch.engine.settings.base import BaseWorkflow
from spl_batch.engine.tasks.receipt_index import Shelf
from spl_batch.errors import InputError
from spl_batch.receivers import steps


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

    def of(self, step: str) -> Shelf:
        """Finished tasks of a step, by name."""
        if step not in self.done:
            self.done[step] = Shelf(steps(self.workflow.kind)[step])
        return self.done[step]
