"""Run a workflow: phase after phase, skipping what is finished, isolating what fails."""

import fcntl
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

from spl_batch.api.events import (
    Event,
    Listener,
    Note,
    PhaseStarted,
    RunStarted,
    TaskEnded,
    ignore,
)
from spl_batch.api.planning import fitting_cost
from spl_batch.api.preparing import DEFAULT_MEMORY, Prepared, prepare
from spl_batch.api.repair import Repairs
from spl_batch.api.withdrawal import withdraw_stale
from spl_batch.errors import StoreError, WorkflowError
from spl_batch.graph import Executor, executor
from spl_batch.io.atomic import stop_if_full, sweep
from spl_batch.io.cells import create_raster_store
from spl_batch.io.store import append_log
from spl_batch.model import Receipt
from spl_batch.plan.flightlines import FALLBACK_PRF_HZ
from spl_batch.plan.phases import PHASES, Phase
from spl_batch.plan.places import PRODUCTS
from spl_batch.plan.survey import Survey, mosaic_parts, timeless_sources
from spl_batch.plan.worklist import Worklist
from spl_batch.report.model import Failure, Report
from spl_batch.runner import KINDS, STAGES
from spl_batch.runner.summary import RunFacts, StageCost, recall, summarise
from spl_batch.tiling import quanta


@dataclass(frozen=True, slots=True)
class RunResult:
    """How a run ended.

    Parameters
    ----------
    exit_status : int
        0 all done, 1 some files or tiles failed.
    output : Path
        Folder of the results.
    report : Report or None
        None when the run was told to stop before it.
    """

    exit_status: int
    output: Path
    report: Report | None


@dataclass
class _Progress:
    """Costs and failures of one run, as they come in."""

    output: Path
    listener: Listener
    repairs: Repairs
    verify: bool = False
    costs: dict[str, StageCost] = field(default_factory=dict)
    failures: list[tuple[str, Receipt]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def tell(self, event: Event) -> None:
        """Pass an event on, to the log as well."""
        fields = {name: getattr(event, name) for name in event.__dataclass_fields__}
        stamp = datetime.now(UTC).isoformat(timespec="milliseconds")
        append_log(self.output, {"time": stamp, "event": type(event).__name__, **fields})
        self.listener(event)

    def warn(self, text: str) -> None:
        """Note something that the report repeats."""
        if text not in self.notes:
            self.notes.append(text)
            self.tell(Note("warning", text))

    def tidy(self) -> None:
        """Remove what a killed run has left unfinished."""
        count, total = sweep(self.output)
        if count:
            text = f"{count} unfinished files of a killed run removed ({total / 1e6:.1f} MB)"
            self.tell(Note("info", text))

    @property
    def failed(self) -> list[Receipt]:
        """Receipts of tasks that did not do their work."""
        return [receipt for _, receipt in self.failures]

    def repair(self, survey: Survey) -> bool:
        """Begin again where files of the store are to be made again."""
        damaged = self.repairs.begin(self.failed, survey)
        if damaged:
            self.tell(Note("info", f"damaged, made again: {', '.join(damaged)}"))
            self.costs.clear()
            self.failures.clear()
        return bool(damaged)

    def ended(self, stage: str, receipt: Receipt, points: int) -> None:
        """Count a task in."""
        cost = self.costs.setdefault(stage, StageCost())
        cost.add(receipt)
        if receipt.failed:
            self.failures.append((stage, receipt))
        self.tell(
            TaskEnded(stage, receipt.kind, receipt.name, points, receipt.wall_s, receipt.reason)
        )


def run(
    workflow: Path | str,
    *,
    workers: int = 2,
    memory: str | int = DEFAULT_MEMORY,
    scheduler: str | None = None,
    fresh: bool = False,
    verify: bool = False,
    until: str | None = None,
    overrides: Sequence[str] = (),
    listener: Listener = ignore,
) -> RunResult:
    """Process a survey; run again, it continues where it stopped.

    Parameters
    ----------
    workflow : Path or str
        Workflow file.
    workers : int
        Worker processes on this machine; 0 works in this process.
    memory : str or int
        Memory limit of a worker, e.g. ``"4GiB"`` [byte].
    scheduler : str, optional
        Address of a running dask scheduler, used instead of local workers.
    fresh : bool
        Forget what earlier runs finished.
    verify : bool
        Compare everything that is finished with its checksum, which reads all of it.
    until : str, optional
        Last stage to run.
    overrides : sequence of str
        ``key.path=value``, applied to the workflow.
    listener : callable
        Told what happens.

    Returns
    -------
    RunResult

    Raises
    ------
    WorkflowError, PlanError
        If nothing can be started.
    StoppedError
        If the run had to stop as a whole; the same call continues it.
    """
    start = time.perf_counter()
    if until is not None and until not in STAGES:
        raise WorkflowError(f"--until {until}: write one of {', '.join(STAGES)}")
    if workers < 0:
        raise WorkflowError(f"--workers {workers}: write 0 (in this process) or more")
    prepared = prepare(Path(workflow), overrides, memory=memory, workers=workers)
    fitting_cost(prepared)
    output = prepared.context.output
    with locked(output):
        if fresh:
            prepared.context.store.clear()
        progress = _Progress(output, listener, Repairs(prepared.context.store), verify)
        progress.tell(RunStarted(str(workflow), workers, prepared.context.code))
        progress.tidy()
        for warning in prepared.survey.inputs.warnings:
            progress.warn(warning)
        for bad in prepared.survey.inputs.bad:
            progress.tell(Note("error", str(bad)))
        with executor(
            workers=workers, memory_bytes=prepared.survey.memory_bytes, scheduler=scheduler
        ) as (pool, dashboard):
            if dashboard:
                progress.tell(Note("info", f"dask dashboard: {dashboard}"))
            _process(prepared, pool, progress, until)
        if until is None or STAGES.index(until) >= STAGES.index("deliver"):
            for path in withdraw_stale(prepared.survey, output):
                progress.tell(Note("info", f"taken away, as nothing in this run made it: {path}"))
        if until is not None and until != "report":
            failed = bool(progress.failures or prepared.survey.inputs.bad)
            return RunResult(int(failed), output, None)
        facts = RunFacts(
            time.perf_counter() - start + _earlier_wall_s(output, progress),
            workers,
            progress.costs,
            tuple(_failures(prepared.survey, progress)),
            progress.notes,
            [str(p) for p in prepared.survey.inputs.reference],
            _not_read(prepared.survey),
        )
        written = summarise(prepared.survey.done, prepared.context, facts)
    return RunResult(int(bool(written.failures)), output, written)


def _process(prepared: Prepared, pool: Executor, progress: _Progress, until: str | None) -> None:
    """Go through the phases, and once more where a file of the store had to be made again."""
    _run_phases(prepared, pool, progress, until)
    while progress.repair(prepared.survey):
        _run_phases(prepared, pool, progress, until)


def _run_phases(prepared: Prepared, pool: Executor, progress: _Progress, until: str | None) -> None:
    survey, last = prepared.survey, STAGES.index(until) if until else len(STAGES)
    for phase in PHASES:
        stage = KINDS[phase.kind].stage
        if STAGES.index(stage) > last:
            return
        if phase.kind == "surface":
            _make_rasters(prepared)
        _run_phase(phase, stage, prepared, pool, progress)
        if progress.repairs.wanted(progress.failed, survey):
            return
        _judge(phase, survey, progress)
        for text in _warnings(survey.of(phase.kind)):
            progress.warn(text)


def _judge(phase: Phase, survey: Survey, progress: _Progress) -> None:
    """Warn of what a phase has brought to light, or stop."""
    if phase.kind == "surface" and len(mosaic_parts(survey)) > 1:
        progress.warn(
            "the survey lies in pieces far apart: each has rasters of its own "
            "(dtm.tif, dtm_2.tif, ...), the largest piece comes first"
        )
    if phase.kind == "index_file":
        _judge_index(survey, progress)
    if phase.kind == "trajectory" and survey.inputs.trajectory and not survey.of("trajectory"):
        failures = [r.reason for r in progress.failed if r.kind == "trajectory"]
        if failures:
            raise WorkflowError(f"survey.trajectory: {failures[-1]}")
    if phase.kind == "sensor_path" and survey.of("sensor_path"):
        progress.warn(_beams_without_trajectory(survey))


def _run_phase(
    phase: Phase, stage: str, prepared: Prepared, pool: Executor, progress: _Progress
) -> None:
    """Do what one phase has left to do."""
    survey, context = prepared.survey, prepared.context
    work = Worklist(phase, survey, context, verify=progress.verify)
    for _, receipt in work.look():
        if receipt is not None:
            progress.costs.setdefault(stage, StageCost()).skip(receipt)
    if not work.left and not work.ready:
        return
    progress.tell(PhaseStarted(stage, phase.kind, work.left, work.ready, work.points))

    def on_receipt(receipt: Receipt) -> None:
        progress.ended(stage, receipt, work.ended(receipt).points)

    for receipt in work.refused:
        on_receipt(receipt)
    pool.run(work.jobs(), context, on_receipt)
    survey.of(phase.kind).sort()


def _judge_index(survey: Survey, progress: _Progress) -> None:
    """Stop where no input is usable; say which ones have no time."""
    failures = [r for r in progress.failed if r.kind == "index_file"]
    usable = survey.of("index_file")
    if not usable or not any(r.points for r in usable.values()):
        reasons = [*(str(b) for b in survey.inputs.bad), *(r.reason for r in failures)]
        raise WorkflowError("no input is usable: " + ("; ".join(reasons) or "they hold no points"))
    timeless = timeless_sources(survey)
    for source in timeless:
        progress.warn(
            f"{source.name}: no usable gps_time (none, not finite, or the same for every "
            "point); its points are delivered unfiltered and take part in nothing"
        )
    guessed = [line.name for line in survey.flightlines if line.prf_basis == "assumed"]
    if guessed:
        progress.warn(
            f"{', '.join(guessed[:5])}: gps_time does not tell the pulse rate; "
            f"{FALLBACK_PRF_HZ:.0f} Hz assumed; state acquisition.prf_hz"
        )
    if survey.filtering and not survey.flightlines:
        names = ", ".join(source.name for source in timeless[:5])
        raise WorkflowError(
            f"{names}: no point has a usable gps_time, so there are no shots to filter by; "
            "set filter.method: none and afterpulse.enabled: false for ground and surfaces"
        )


def _earlier_wall_s(output: Path, progress: _Progress) -> float:
    """Time that earlier runs took for what this one found finished [s]."""
    if not any(cost.skipped for cost in progress.costs.values()):
        return 0.0
    try:
        return float(recall(output)["wall_s"])
    except StoreError:
        return 0.0  # the earlier run was stopped before its report


def _not_read(survey: Survey) -> int:
    """Points that the headers of files promise which could not be read to their end."""
    indexed = survey.of("index_file")
    return sum(s.facts.n_points for s in survey.inputs.sources if str(s.key) not in indexed)


def _failures(survey: Survey, progress: _Progress) -> Iterator[Failure]:
    """What did not make it, inputs first."""
    for bad in survey.inputs.bad:
        reason = "; ".join(bad.faults)
        yield Failure(stage="index", place=bad.path, reason=reason, remedy="mend or remove it")
    names = {str(s.key): s.name for s in survey.inputs.sources}
    for stage, receipt in progress.failures:
        yield Failure(
            stage=stage,
            place=names.get(receipt.name, receipt.name),
            reason=receipt.reason,
            remedy="run again: only what failed is tried",
            task=f"{receipt.kind} {receipt.name}",
        )


def _beams_without_trajectory(survey: Survey) -> str:
    """What beams are taken from where there is no trajectory."""
    paths = survey.of("sensor_path")
    found = [name for name, receipt in paths.items() if receipt.facts["found"]]
    headings = survey.of("heading")
    left = [headings[name] for name in paths if name not in found and name in headings]
    angled = sum(r.facts["heading_rad"] is not None for r in left)
    return (
        "no trajectory: the sensor is found where lines of sight through several returns meet "
        f"on {len(found)} flightlines; beams are taken from scan_angle and the flight direction "
        f"on {angled} and are vertical on {len(paths) - len(found) - angled}, whose returns, "
        "scan_angle or course do not tell them"
    )


def _warnings(receipts: Mapping[str, Receipt]) -> Iterator[str]:
    """What tasks warn of; a warning that many share is given once."""
    sharing: dict[str, list[str]] = {}
    for receipt in receipts.values():
        name = str(receipt.facts.get("name", receipt.name))
        for text in receipt.facts.get("warnings", ()):
            sharing.setdefault(text, []).append(name)
    for text, names in sharing.items():
        shown = ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")
        yield f"{shown}: {text}"


def _make_rasters(prepared: Prepared) -> None:
    workflow = prepared.context.workflow
    create_raster_store(
        prepared.context.rasters,
        (*PRODUCTS, "noise"),
        ground_cell=quanta(workflow.ground.cell_m),
        raster_cell=quanta(workflow.products.cell_m),
    )


@contextmanager
def locked(output: Path) -> Iterator[None]:
    """Keep two runs out of one output; the system lets go of the lock when a run dies."""
    try:
        (output / "store").mkdir(parents=True, exist_ok=True)
        stream = (output / "store" / "lock").open("w")
    except OSError as error:
        stop_if_full(error, output)
        raise WorkflowError(f"output: {output} cannot be written: {error.strerror}") from None
    with stream:
        try:
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise WorkflowError(
                f"output: another run is working in {output}; wait for it"
            ) from None
        try:
            yield
        except OSError as error:
            stop_if_full(error, output)
            raise
