"""A task, the receipt that it leaves, and how workers are: what travels between the storeys."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True, slots=True)
class Task:
    """One unit of work: small enough to travel in a message, named so that it can be repeated.

    Parameters
    ----------
    kind : str
        What is done; a key of the runner's table.
    name : str
        Which one; unique within its kind, stable between runs.
    args : mapping
        Plain JSON values, nothing large.
    needs : tuple of (str, str)
        Kind and name of the tasks whose results it reads.
    points : int
        Points that it handles, for progress [count].
    refused : str
        Why it cannot be started, with a remedy; empty where it can.
    how : mapping
        Further arguments that change how the work is done and not what comes out: they are no part
        of a receipt's key.
    """

    kind: str
    name: str
    args: Mapping[str, Any]
    needs: tuple[tuple[str, str], ...] = ()
    points: int = 0
    refused: str = ""
    how: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Receipt:
    """What a task leaves behind, written last: a matching one means that it is done.

    Parameters
    ----------
    kind, name : str
        The task.
    key : str
        Hash of code, parameters and inputs; another key means that the work is stale.
    digest : str
        Hash of what was produced; it enters the keys of those who read it.
    reason : str
        Why the task failed; empty when it did not.
    outputs : mapping of str to str
        Path below the output folder (the store is ``store``) -> checksum of file or directory.
    facts : mapping
        Small results, plain JSON values.
    points : int
        Points handled [count].
    wall_s, peak_rss_mb : float
        Duration [s]; highest resident memory of the worker so far [MiB].
    sizes, written_ns : mapping of str to int
        Output -> size of it and all in it [byte]; delivered file -> time of writing [ns].
    inputs : mapping of str to (int, int)
        Path of an input -> size [byte] and time of writing [ns].
    """

    kind: str
    name: str
    key: str
    digest: str
    reason: str
    outputs: Mapping[str, str]
    facts: Mapping[str, Any]
    points: int
    wall_s: float
    peak_rss_mb: float
    sizes: Mapping[str, int] = field(default_factory=dict)
    written_ns: Mapping[str, int] = field(default_factory=dict)
    inputs: Mapping[str, Sequence[int]] = field(default_factory=dict)

    @property
    def failed(self) -> bool:
        """Whether the task did not do its work."""
        return bool(self.reason)


@dataclass(frozen=True, slots=True)
class WorkersSeen:
    """How the workers are at a moment.

    Parameters
    ----------
    workers, threads : int
        How many there are [count].
    memory_mb, limit_mb : float
        Memory of the worker that has most, and the smallest limit; 0 where unknown [MiB].
    """

    workers: int
    threads: int
    memory_mb: float
    limit_mb: float
