"""Events that a run reports to those who watch it; each is also a line of ``log.jsonl``."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any


@dataclass(frozen=True, slots=True)
class RunStarted:
    """A run begins; what the log has before it belongs to earlier ones."""

    workflow: str
    workers: int
    code: str
    #: Time that each stage is expected to take if nothing of it is finished [s].
    expected_s: Mapping[str, float] = field(default_factory=dict)
    stages: Sequence[str] = ()  #: Names of all stages, in order.
    #: Path and reason of each input file that cannot be used.
    unusable: Sequence[Mapping[str, str]] = ()


@dataclass(frozen=True, slots=True)
class WorkersReady:
    """There is something to run tasks on."""

    #: Address of a scheduler that was started elsewhere; empty for workers of our own.
    scheduler: str = ""
    dashboard: str = ""  #: Link to dask's dashboard; empty where there is none.


@dataclass(frozen=True, slots=True)
class WorkersSeen:
    """How the workers are at a moment."""

    workers: int
    threads: int
    #: Memory of the worker that has most, and the smallest limit; 0 where unknown [MiB].
    memory_mb: float
    limit_mb: float


@dataclass(frozen=True, slots=True)
class PhaseStarted:
    """A phase knows its tasks."""

    #: stage, kind: stage of the command line, and kind of the tasks.
    stage: str
    kind: str
    tasks: int
    skipped: int
    points: int  #: Points that the tasks to do will handle [count].


@dataclass(frozen=True, slots=True)
class TaskStarted:
    """A worker has begun a task."""

    stage: str
    kind: str
    name: str
    worker: str = ""
    called: str = ""  #: What a user calls it.


@dataclass(frozen=True, slots=True)
class TaskEnded:
    """A task is finished, or has failed for good."""

    stage: str
    kind: str
    name: str
    points: int  #: Points that it was to handle [count].
    wall_s: float
    reason: str  #: Why it failed; empty when it did not.
    peak_rss_mb: float = 0.0  #: Highest memory of its worker so far [MiB].
    called: str = ""  #: What a user calls it.
    code: str = ""  #: Code of its failure; what has failed with F03 is tried again in this run.
    traceback: str = ""  #: Where in the code it failed.


@dataclass(frozen=True, slots=True)
class TaskSettled:
    """A task turns out to need no doing."""

    stage: str
    kind: str
    name: str
    points: int  #: Points that it was to handle [count].
    found: bool  #: Whether it was finished before; else it misses what failed, and is left out.


@dataclass(frozen=True, slots=True)
class Compiling:
    """Kernels are compiled beside the run; the log does not have it."""

    #: Kernels that are compiled, and all of them [count].
    done: int
    of: int


@dataclass(frozen=True, slots=True)
class ReportStarted:
    """All tasks are over, and the report is being written."""


@dataclass(frozen=True, slots=True)
class RunEnded:
    """A run ends in order; one that was killed leaves no such event."""

    exit_status: int  #: That of the command line.
    reason: str = ""  #: Why it stopped before its end; empty when it did not.


@dataclass(frozen=True, slots=True)
class Note:
    """Something that a user should read."""

    level: str  #: ``info``, ``warning`` or ``error``.
    text: str


Event = (
    RunStarted
    | WorkersReady
    | WorkersSeen
    | PhaseStarted
    | TaskStarted
    | TaskEnded
    | TaskSettled
    | Compiling
    | ReportStarted
    | RunEnded
    | Note
)
Listener = Callable[[Event], None]


def ignore(_event: Event) -> None:
    """Listen to nothing."""


def as_record(event: Event) -> dict[str, Any]:
    """An event as a line of the log: time, name, and the fields that have a value."""
    fields = {name: getattr(event, name) for name in event.__dataclass_fields__}
    stamp = datetime.now(UTC).isoformat(timespec="milliseconds")
    shown = {k: v for k, v in fields.items() if k == "reason" or v not in ("", {}, None)}
    return {"time": stamp, "event": type(event).__name__, **shown}
