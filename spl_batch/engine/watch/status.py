"""State of a run by stage: what is done, running, failed and left.

It is made of the events of a run in this process, or of the lines of its log, which any process may
read while it grows.
"""

import json
import mmap
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any, Final

from spl_batch.engine.settings.mistaken_file import refuse_no_output
from spl_batch.engine.store.output_lock import holder
from spl_batch.engine.tasks.step import stages as stages_of
from spl_batch.errors import WorkflowError, reason_of
from spl_batch.receivers import IMAGING

LOG: Final = "log.jsonl"
"""Name of the log, below the output."""

_BEGINS: Final = b'"event": "RunStarted"'
_WORKS: Final = b'"event": "PhaseStarted"'
_NO_EVENT: Final = (ValueError, KeyError, TypeError, AttributeError)
"""What a line of the log leads to that a kill has cut off."""


@dataclass(slots=True)
class StageStatus:
    """State of one stage."""

    stage: str
    #: Tasks known, finished and failed [count].
    total: int = 0
    done: int = 0
    failed: int = 0
    found: int = 0  #: Tasks that this run found finished, among those [count].
    points: int = 0  #: Points handled by tasks that this run finished [count].
    left_points: int = 0  #: Points of tasks that are still to do [count].
    #: When its first phase began, and its latest event; 0 before that [s since 1970].
    began_s: float = 0.0
    latest_s: float = 0.0
    expected_s: float = 0.0  #: Time that the whole stage was expected to take; 0 where unknown [s].

    @property
    def left(self) -> int:
        """Tasks that are still to do [count]."""
        return self.total - self.done - self.failed

    @property
    def elapsed_s(self) -> float:
        """Time from its beginning to its latest event [s]."""
        return max(self.latest_s - self.began_s, 0.0)

    @property
    def points_per_s(self) -> float:
        """Points that all workers together handle in a second; 0 where unknown [1/s]."""
        return self.points / self.elapsed_s if self.elapsed_s > 0.5 else 0.0

    @property
    def left_s(self) -> float:
        """Time that it will still take, by its speed or as was expected [s]."""
        if not self.began_s:
            return self.expected_s
        if self.points_per_s and self.left_points > 0:
            return self.left_points / self.points_per_s
        return self.expected_s * self.left / max(self.total, 1)


@dataclass(frozen=True, slots=True)
class FailedTask:
    """A task that failed, or an input file that cannot be used."""

    task: str  #: What a user calls it.
    reason: str


@dataclass(slots=True)
class RunStatus:
    """State of a run."""

    stages: dict[str, StageStatus] = field(default_factory=dict)  #: By name, in order.
    #: What a user calls each task that has begun, by kind and name.
    running: dict[tuple[str, str], str] = field(default_factory=dict)
    failures: list[FailedTask] = field(default_factory=list)
    #: Input files that the latest run cannot use.
    unusable: list[FailedTask] = field(default_factory=list)
    #: Fields of the latest :class:`~spl_batch.engine.watch.events.WorkersSeen`.
    workers: Mapping[str, Any] = field(default_factory=dict)
    peak_mb: float = 0.0  #: Highest memory that a worker has reported [MiB].
    dashboard: str = ""  #: Link to dask's dashboard while the run works.
    #: Fields of :class:`~spl_batch.engine.watch.events.RunEnded`; None where the log has none.
    ended: Mapping[str, Any] | None = None
    #: Host, process and start of the run that works here now; None where none does.
    holder: Mapping[str, Any] | None = None
    kinds: set[str] = field(default_factory=set)  #: Kinds of task whose phases have begun.
    #: Fields of a :class:`~spl_batch.engine.watch.events.RunStarted` whose phases have not begun:
    #: the state is that of the run before.
    started: Mapping[str, Any] | None = None

    def __post_init__(self) -> None:
        self._forget(stages_of(IMAGING), {})

    @property
    def left_s(self) -> float:
        """Time that the run will still take [s]."""
        stages = [*self.stages.values()]
        busy = [k for k, stage in enumerate(stages) if stage.began_s and stage.left]
        begun = [k for k, stage in enumerate(stages) if stage.began_s]
        first = busy[0] if busy else max(begun, default=0)
        return sum(stage.left_s for stage in stages[first:])

    def feed(self, record: Mapping[str, Any]) -> None:
        """Take in an event, as :func:`spl_batch.engine.watch.events.as_record` gives it."""
        match record["event"]:
            case "RunStarted":
                self.ended, self.started = None, record
                listed = record.get("unusable", ())
                self.unusable = [FailedTask(one["path"], one["reason"]) for one in listed]
            case "WorkersReady":
                self.dashboard = record.get("dashboard", "")
            case "PhaseStarted":
                self._phase_started(record)
            case "TaskStarted":
                self.running[record["kind"], record["name"]] = _called(record)
            case "TaskEnded" | "TaskSettled":
                self._task_over(record)
            case "WorkersSeen":
                self.workers = record
            case "RunEnded":
                self.ended, self.dashboard = record, ""
                self.running.clear()

    def _phase_started(self, record: Mapping[str, Any]) -> None:
        if self.started is not None:
            names = self.started.get("stages") or stages_of(IMAGING)
            self._forget(names, self.started.get("expected_s", {}))
            self.started, self.peak_mb = None, 0.0
        elif record["kind"] in self.kinds:  # again, as a file was damaged
            self._forget(self.stages, {k: v.expected_s for k, v in self.stages.items()})
        self.kinds.add(record["kind"])
        stage = self.stages[record["stage"]]
        stage.total += record["tasks"] + record["skipped"]
        stage.done += record["skipped"]
        stage.found += record["skipped"]
        stage.left_points += record["points"]
        stage.latest_s = seconds(record)
        stage.began_s = stage.began_s or stage.latest_s

    def _forget(self, names: Iterable[str], expected_s: Mapping[str, float]) -> None:
        """Forget what was done."""
        self.stages = {k: StageStatus(k, expected_s=expected_s.get(k, 0.0)) for k in names}
        self.kinds, self.running, self.failures = set(), {}, []

    def _task_over(self, record: Mapping[str, Any]) -> None:
        """Count a task that has ended, or needs no doing."""
        self.running.pop((record["kind"], record["name"]), None)
        stage = self.stages[record["stage"]]
        stage.latest_s = seconds(record)
        stage.left_points -= record["points"]
        if record["event"] == "TaskSettled":
            stage.done += record["found"]
            stage.found += record["found"]
            stage.total -= not record["found"]
        elif record["reason"]:
            stage.failed += 1
            self.failures.append(FailedTask(_called(record), record["reason"]))
        else:
            stage.done += 1
            stage.points += record["points"]
        self.peak_mb = max(self.peak_mb, record.get("peak_rss_mb", 0.0))


def _called(record: Mapping[str, Any]) -> str:
    """What a user calls the task of an event."""
    return record.get("called") or f"{record['kind']} {record['name']}"


def seconds(record: Mapping[str, Any]) -> float:
    """When an event was logged [s since 1970]."""
    return datetime.fromisoformat(record["time"]).timestamp()


class Follower:
    """Reads the log of an output folder as it grows, each line once.

    Raises
    ------
    WorkflowError
        If no run has worked there.
    """

    def __init__(self, output: Path | str) -> None:
        self.output, self.status, self._rest = Path(output), RunStatus(), b""
        refuse_no_output(self.output, "status")
        self._log = self.output / LOG
        try:
            self._read = _latest_run(self._log)
        except OSError:
            raise WorkflowError(f"{output}: no run has worked here (no {LOG})") from None

    def update(self) -> RunStatus:
        """State as of now."""
        try:
            with self._log.open("rb") as stream:
                stream.seek(self._read)
                content = stream.read()
        except OSError as error:
            raise WorkflowError(f"{self._log}: cannot be read: {reason_of(error)}") from None
        self._read += len(content)
        *lines, self._rest = (self._rest + content).split(b"\n")
        for line in lines:
            try:
                self.status.feed(json.loads(line))
            except _NO_EVENT:
                continue
        self.status.holder = holder(self.output)
        if self.status.holder is None:  # the run is over, or was killed
            self.status.running.clear()
        return self.status


def status(output: Path | str) -> RunStatus:
    """State of the latest run of an output folder, which may be working at this moment.

    Raises
    ------
    WorkflowError
        If no run has worked there.
    """
    return Follower(output).update()


def _latest_run(log: Path) -> int:
    """Where the lines begin of the latest run that has found something to look at [byte]."""
    if not log.stat().st_size:
        return 0
    with log.open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as whole:
        works = whole.rfind(_WORKS)
        first = whole.rfind(_BEGINS, 0, works if works >= 0 else len(whole))
        return whole.rfind(b"\n", 0, max(first, 0)) + 1
