"""State of a run, event by event: what is done, running, failed and left.

It is made alike from the events of a run in this process and from the lines of its log
(:mod:`spl_batch.engine.watch.log_follower`).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

from spl_batch.engine.tasks.step import stages as stages_of
from spl_batch.engine.watch.listing import listed
from spl_batch.engine.watch.log_lines import seconds
from spl_batch.receivers import IMAGING

PAGE: Final = "page"
"""What the writing of the report is called among the stages."""

TRUSTED_SHARE: Final = 0.2
"""Share of a stage's points from which on the time left follows from its own speed alone."""


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
    wall_s: float = 0.0  #: Summed time of those tasks [s].
    left_points: int = 0  #: Points of tasks that are still to do [count].
    #: Points of tasks that this run had to do when their phases began [count].
    points_to_do: int = 0
    #: When its first phase began, and its latest event; 0 before that [s since 1970].
    began_s: float = 0.0
    latest_s: float = 0.0
    now_s: float = 0.0  #: Up to when it is known to be at work; 0 where it is not [s since 1970].
    expected_s: float = 0.0  #: Time that the whole stage was expected to take; 0 where unknown [s].
    phases_left: int = 0  #: Phases of it that have not begun, as far as is known [count].

    @property
    def left(self) -> int:
        """Tasks that are still to do [count]."""
        return self.total - self.done - self.failed

    @property
    def of_earlier_runs(self) -> bool:
        """Whether this run had nothing to do in it: earlier ones had done it all."""
        return self.found == self.total > 0

    @property
    def elapsed_s(self) -> float:
        """Time from its beginning to its latest event, or to the present while it works [s]."""
        return max(self.latest_s - self.began_s, self.now_s - self.began_s, 0.0)

    @property
    def counted_s(self) -> float:
        """Time from its beginning to its latest event, up to which its points are counted [s]."""
        return max(self.latest_s - self.began_s, 0.0)

    @property
    def points_per_s(self) -> float:
        """Points that all workers together handle in a second; 0 where unknown [1/s]."""
        return self.points / self.counted_s if self.counted_s > 0.5 else 0.0

    @property
    def left_s(self) -> float:
        """Time that it will still take, as far as can be told [s]."""
        if not self.began_s:
            return self.expected_s
        if self.of_earlier_runs:  # nor has it anything to do in the phases that are to come
            return 0.0
        left_s = self._left_of_phases_s() if self.left else 0.0
        left_s -= self.elapsed_s - self.counted_s
        return max(left_s, self.expected_s - self.elapsed_s if self.phases_left else 0.0, 0.0)

    def _left_of_phases_s(self) -> float:
        """Time left of the phases that have begun [s]."""
        expected_s = self.expected_s * self.left / self.total
        if self.left_points == 0:  # tasks that handle no points: each takes as long as another
            ended = self.total - self.left - self.found
            return max(expected_s, self.counted_s * self.left / ended) if ended else expected_s
        if self.points_per_s == 0:
            return expected_s
        # The first tasks compile kernels and warm caches: their rate tells little. Squared, as it
        # multiplies a time that falls with the points that are done.
        weight = 1.0
        # A log that has lost lines may tell of points done and of none to do.
        if expected_s and self.points_to_do:
            weight = min(self.points / (TRUSTED_SHARE * self.points_to_do), 1.0) ** 2
        return weight * self.left_points / self.points_per_s + (1 - weight) * expected_s


@dataclass(frozen=True, slots=True)
class FailedTask:
    """A task that failed, or an input file that cannot be used."""

    #: What a user calls it; why; the command that does it alone, none for a file.
    task: str
    reason: str
    command: str


@dataclass(slots=True)
class RunStatus:
    """State of a run."""

    stages: dict[str, StageStatus] = field(default_factory=dict)  #: By name, in order.
    #: Worker of each task that has begun, by kind and name.
    running: dict[tuple[str, str], str] = field(default_factory=dict)
    #: What a user calls those tasks.
    called: dict[tuple[str, str], str] = field(default_factory=dict)
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
    #: When the phase of each kind of task that has begun did so [s since 1970].
    kinds: dict[str, float] = field(default_factory=dict)
    #: Stage of each task that has begun and of whose end nothing was heard, by kind and name.
    begun: dict[tuple[str, str], str] = field(default_factory=dict)
    #: Names of the stages, in order.
    order: Sequence[str] = field(default_factory=lambda: stages_of(IMAGING))
    #: Fields of a :class:`~spl_batch.engine.watch.events.RunStarted` whose work has not begun, and
    #: of its phases so far, in which everything was finished.
    waiting: list[Mapping[str, Any]] = field(default_factory=list)
    reporting: bool = False  #: Whether the latest run is writing the report, or has.
    #: The writing of the report: none of the tasks that it counts, and so a row of its own.
    page: StageStatus = field(default_factory=lambda: StageStatus(PAGE))
    #: What lies in the output folder though its store is gone, and with it all that was finished:
    #: the next run starts over; None where the store is there.
    delivered: tuple[str, ...] | None = None
    lost_lines: int = 0  #: Lines of the log that were cut off by a kill, or damaged [count].

    def __repr__(self) -> str:
        state = "working" if self.holder else "stopped before its end"
        if self.ended is not None:
            state = f"ended with exit status {self.ended['exit_status']}"
        done = (
            (one.stage, f"{one.done} of {one.total} done, {one.failed} failed") for one in self.rows
        )
        failed = (("failed", f"{one.task}: {one.reason}") for one in self.failures)
        return listed("RunStatus", (("run", state), *done, *failed))

    def __post_init__(self) -> None:
        self.stages = {name: StageStatus(name) for name in self.order}

    @property
    def rows(self) -> list[StageStatus]:
        """What is shown line by line: the stages, and the writing of the report once it began."""
        return [*self.stages.values(), *([self.page] if self.page.began_s else [])]

    @property
    def left_s(self) -> float:
        """Time that the run will still take, as far as can be told [s]."""
        known = [stage for stage in self.stages.values() if stage.began_s]
        # Phases of two stages may be done at once.
        busy = [stage for stage in known if stage.left] or known[-1:]
        first = self.order.index(busy[0].stage) if busy else 0
        return sum(self.stages[name].left_s for name in self.order[first:])

    def advance(self, now_s: float) -> None:
        """Let the clocks of what is at work go on to the present [s since 1970]."""
        busy = [self.stages[name] for name in {self.begun[task] for task in self.running}]
        for stage in (*busy, *([self.page] if self.reporting and self.ended is None else [])):
            stage.now_s = now_s

    def feed(self, record: Mapping[str, Any]) -> None:
        """Take in an event, as :func:`spl_batch.engine.watch.events.as_record` gives it."""
        take = {
            "RunStarted": self._run_started,
            "WorkersReady": self._workers_ready,
            "PhaseStarted": self._phase_started,
            "TaskStarted": self._task_started,
            "TaskEnded": self._task_ended,
            "TaskSettled": self._task_settled,
            "WorkersSeen": self._workers_seen,
            "ReportStarted": self._report_started,
            "RunEnded": self._run_ended,
        }.get(str(record.get("event")))
        if take is not None:
            take(record)

    def _run_started(self, record: Mapping[str, Any]) -> None:
        if self.kinds:  # what earlier runs did stands until this one has something to do
            self.ended, self.waiting, self.reporting = None, [record], False
            self.unusable = _unusable(record)
        else:
            self._start_over(record)

    def _start_over(self, record: Mapping[str, Any]) -> None:
        fresh = RunStatus(order=tuple(record.get("stages") or stages_of(IMAGING)))
        for name in self.__slots__:
            setattr(self, name, getattr(fresh, name))
        self.unusable = _unusable(record)
        for name, expected_s in record.get("expected_s", {}).items():
            self.stages[name].expected_s = expected_s
        for name, phases in record.get("phases", {}).items():
            self.stages[name].phases_left = phases

    def _workers_ready(self, record: Mapping[str, Any]) -> None:
        self.dashboard = record.get("dashboard", "")

    def _phase_started(self, record: Mapping[str, Any]) -> None:
        if self.waiting and not record["tasks"]:
            self.waiting.append(record)
            return
        if self.waiting:
            started, *finished = self.waiting
            self._start_over(started)
            for phase in finished:
                self._begin(phase)
        self._begin(record)

    def _begin(self, record: Mapping[str, Any]) -> None:
        if record["kind"] in self.kinds:
            self._begin_again()
        self.kinds[record["kind"]] = seconds(record)
        stage = self.stages[record["stage"]]
        stage.phases_left -= stage.phases_left > 0
        stage.total += record["tasks"] + record["skipped"]
        stage.done += record["skipped"]
        stage.found += record["skipped"]
        stage.left_points += record["points"]
        stage.points_to_do += record["points"]
        stage.latest_s = seconds(record)
        stage.began_s = stage.began_s or stage.latest_s

    def _begin_again(self) -> None:
        """Forget what was done: phases are gone through again, as a file was damaged."""
        self.stages = {
            name: StageStatus(name, expected_s=stage.expected_s)
            for name, stage in self.stages.items()
        }
        self.page, self.reporting = StageStatus(PAGE), False
        for known in (self.kinds, self.begun, self.running, self.called, self.failures):
            known.clear()

    def _task_started(self, record: Mapping[str, Any]) -> None:
        kind, name = record["kind"], record["name"]
        self.running[kind, name] = record["worker"]
        self.called[kind, name] = record.get("called") or f"{kind} {name}"
        self.begun[kind, name] = record["stage"]

    def _task_ended(self, record: Mapping[str, Any]) -> None:
        stage, kind, name = self.stages[record["stage"]], record["kind"], record["name"]
        for known in (self.running, self.begun, self.called):
            known.pop((kind, name), None)
        failed = bool(record["reason"])
        stage.latest_s = seconds(record)
        stage.left_points -= record["points"]
        stage.failed += failed
        stage.done += not failed
        self.peak_mb = max(self.peak_mb, record.get("peak_rss_mb", 0.0))
        if failed and not record.get("mends"):
            command = record.get("command", "")
            called = record.get("called") or f"{kind} {name}"
            self.failures.append(FailedTask(called, record["reason"], command))
        if not failed:
            stage.points += record["points"]
            stage.wall_s += record["wall_s"]

    def _task_settled(self, record: Mapping[str, Any]) -> None:
        stage, found = self.stages[record["stage"]], bool(record["found"])
        for known in (self.running, self.begun, self.called):
            known.pop((record["kind"], record["name"]), None)
        stage.latest_s = seconds(record)
        stage.left_points -= record["points"]
        stage.points_to_do -= record["points"]
        stage.done += found
        stage.found += found
        stage.total -= not found

    def _workers_seen(self, record: Mapping[str, Any]) -> None:
        self.workers = record

    def _report_started(self, record: Mapping[str, Any]) -> None:
        began_s = seconds(record)
        for stage in self.stages.values():
            stage.phases_left = 0  # small surveys go without some
        self.page = StageStatus(PAGE, total=1, began_s=began_s, latest_s=began_s)
        self.reporting = True

    def _run_ended(self, record: Mapping[str, Any]) -> None:
        self.ended = record
        if self.reporting and not record["reason"]:
            self.page.done, self.page.latest_s = 1, seconds(record)
        self.dashboard = ""
        self.nothing_runs()

    def nothing_runs(self) -> None:
        """Take what was running for waiting: the run is over, or was killed."""
        self.running.clear()
        self.called.clear()


def _unusable(started: Mapping[str, Any]) -> list[FailedTask]:
    return [FailedTask(one["path"], one["reason"], "") for one in started.get("unusable", ())]
