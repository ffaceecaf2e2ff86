"""Ledger of a run: its inputs, its limits, and what is finished, in little memory.

A survey has a tile for every 10 000 m2, and a receipt with its mappings takes kilobytes. So digest,
points and the facts that something reads are kept as one short string for each task, and receipts
are made of them on demand.
"""

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Generic, TypeVar

from spl_batch.engine.findings import Finding
from spl_batch.engine.settings.base import BaseWorkflow
from spl_batch.engine.tasks.step import Step
from spl_batch.engine.tasks.task import Receipt
from spl_batch.receivers import steps

I = TypeVar("I")  # noqa: E741
W = TypeVar("W", bound=BaseWorkflow)


class StepReceipts(Mapping[str, Receipt]):
    """Receipts of the finished tasks of one step, by name.

    They lack the key and the cost, and the outputs too unless a user sees them.
    """

    def __init__(self, step: Step) -> None:
        self._step = step
        self._kept: dict[str, bytes] = {}

    def put(self, receipt: Receipt) -> None:
        """Keep a receipt, in place of an earlier one of that name."""
        outputs = dict(receipt.outputs) if self._step.delivers else {}
        content = [receipt.digest, receipt.points, outputs, receipt.facts]
        text = json.dumps(content, separators=(",", ":"), allow_nan=False)
        self._kept[receipt.name] = text.encode()

    def digest(self, name: str) -> str:
        """Hash of what a task produced; much quicker than its receipt."""
        kept = self._kept[name]
        return kept[2 : kept.index(b'"', 2)].decode()

    def sort(self) -> None:
        """Put the receipts in the order of their names."""
        self._kept = dict(sorted(self._kept.items()))

    def __getitem__(self, name: str) -> Receipt:
        digest, points, outputs, facts = json.loads(self._kept[name])
        return Receipt(self._step.name, name, "", digest, "", outputs, facts, points, 0.0, 0.0)

    def __contains__(self, name: object) -> bool:
        return name in self._kept

    def __iter__(self) -> Iterator[str]:
        return iter(self._kept)

    def __len__(self) -> int:
        return len(self._kept)


@dataclass
class Ledger(Generic[I, W]):
    """What a run knows so far: inputs, limits, and the receipts of what is finished."""

    #: All that a workflow names, checked: ``sources``, files that can be used, each with ``path``,
    #: ``name`` for messages and ``key`` for tasks; ``bad``, an InputError for each of the others;
    #: ``warnings``, findings before the work starts.
    inputs: I
    workflow: W
    memory_bytes: int  #: Memory limit of a worker [byte].
    workers: int
    done: dict[str, StepReceipts] = field(default_factory=dict)
    shared: bool = False  #: Whether the limit is the workers' share, as none was given.
    remarks: tuple[Finding, ...] = ()  #: What is odd about the limits.

    def of(self, step: str) -> StepReceipts:
        """Finished tasks of a step, by name."""
        if step not in self.done:
            self.done[step] = StepReceipts(steps(self.workflow.kind)[step])
        return self.done[step]
