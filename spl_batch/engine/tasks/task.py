"""A task and the receipt that it leaves: what travels between the storeys."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

Need = tuple[str, str]
"""Step and name of a task whose result another one reads."""


@dataclass(frozen=True, slots=True)
class Task:
    """One unit of work: small enough to travel in a message, named so that it can be repeated."""

    kind: str  #: What is done; a key of the runner's table.
    name: str  #: Which one; unique within its kind, stable between runs.
    args: Mapping[str, Any]  #: Plain JSON values, nothing large.
    needs: tuple[Need, ...] = ()  #: Tasks whose results it reads.
    points: int = 0  #: Points that it handles, for progress [count].
    refused: str = ""  #: Why it cannot be started, with a remedy; empty where it can.

    @property
    def weight(self) -> int:
        """Points that it reads, by which small ones are done together; 0 where unknown [count]."""
        return self.points or int(self.args.get("points", 0))


@dataclass(frozen=True, slots=True)
class Receipt:
    """Receipt of a task, written last: a matching one means that the task is done."""

    kind: str
    name: str
    key: str  #: Hash of code, parameters and inputs; another key means that the work is stale.
    digest: str  #: Hash of what was produced; it enters the keys of those who read it.
    reason: str  #: Why the task failed; empty when it did not.
    #: Path below the output folder (the store is ``store``) -> checksum of file or directory.
    outputs: Mapping[str, str]
    facts: Mapping[str, Any]  #: Small results, plain JSON values.
    points: int
    #: Duration [s]; highest resident memory of the worker so far [MiB].
    wall_s: float
    peak_rss_mb: float
    #: Output -> size of it and all in it [byte]; delivered file -> time of writing [ns].
    sizes: Mapping[str, int] = field(default_factory=dict)
    written_ns: Mapping[str, int] = field(default_factory=dict)
    #: mapping of str to (int, int): path of an input -> size [byte] and time of writing [ns].
    inputs: Mapping[str, Sequence[int]] = field(default_factory=dict)

    @property
    def failed(self) -> bool:
        """Whether the task did not do its work."""
        return bool(self.reason)


class Job(NamedTuple):
    """A task on its way."""

    task: Task
    key: str  #: Its key; empty where what it needs is not all finished.
    open: tuple[Need, ...] = ()  #: What of that is not.
    found: Mapping[Need, str] = {}  #: What of that is, with its digest.
    tried: tuple[str, ...] = ()  #: What earlier tries in this run have come to.

    @property
    def need(self) -> Need:
        """What those that need it call it."""
        return self.task.kind, self.task.name


class Outcome(NamedTuple):
    """What has come of a job."""

    need: Need
    receipt: Receipt | None  #: None where it was left out, for want of what it needs.
    found: bool = False  #: Whether it was finished already.
    #: What its tries have come to, where it is to be handed out again, by itself.
    again: tuple[str, ...] | None = None
