"""Run a workflow: phase after phase, skipping what is finished, isolating what fails."""

import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from spl_batch.api.events import (
    Listener,
    Note,
    PhaseStarted,
    RunEnded,
    RunStarted,
    WorkersReady,
    ignore,
)
from spl_batch.api.failures import Invocation, failures
from spl_batch.api.lock import lock_file, locked
from spl_batch.api.planning import fitting_cost
from spl_batch.api.preparing import DEFAULT_MEMORY, Prepared, prepare
from spl_batch.api.progress import Progress
from spl_batch.api.repair import Repairs
from spl_batch.api.tilemap import TileMap
from spl_batch.api.withdrawal import withdraw_stale
from spl_batch.constants import QUANTA_PER_M
from spl_batch.errors import SplBatchError, StoppedError, StoreError, WorkflowError
from spl_batch.graph import Executor, Footing, executor
from spl_batch.io.cells import create_raster_store
from spl_batch.plan.cost import RATES_POINTS_PER_S, Cost
from spl_batch.plan.flightlines import FALLBACK_PRF_HZ
from spl_batch.plan.phases import PHASES, Phase
from spl_batch.plan.survey import Survey, mosaic_parts, timeless_sources
from spl_batch.plan.worklist import Worklist
from spl_batch.report.model import Report
from spl_batch.runner import KINDS, STAGES
from spl_batch.runner.summary import RunFacts, StageCost, recall, summarise
from spl_batch.stages.surface import PRODUCTS
from spl_batch.task import Receipt
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
    prepared = prepare(Path(workflow), overrides, memory=memory, workers=workers)
    cost = fitting_cost(prepared)
    output = prepared.context.output
    invocation = Invocation(workflow, workers, prepared.survey.memory_bytes, overrides)
    with locked(output) as mark:
        if fresh:
            prepared.context.store.clear()
        repairs = Repairs(prepared.context.store)
        progress = Progress(output, listener, invocation, repairs)
        code = prepared.context.code
        progress.tell(RunStarted(str(workflow), workers, code, _expected_s(cost)))
        progress.tidy()
        with _telling_the_end(progress):
            for warning in prepared.survey.inputs.warnings:
                progress.warn(warning)
            for bad in prepared.survey.inputs.bad:
                progress.tell(Note("error", str(bad)))
            with executor(
                workers=workers,
                memory_bytes=prepared.survey.memory_bytes,
                scheduler=scheduler,
                observer=progress,
                footing=Footing(code, str(lock_file(output)), mark),
            ) as (pool, dashboard):
                progress.tell(WorkersReady(scheduler or "", dashboard))
                _process(prepared, pool, progress, until, verify=verify)
            result = _conclude(prepared, progress, until, start)
        progress.tell(RunEnded(result.exit_status))
    return result


def _conclude(
    prepared: Prepared, progress: Progress, until: str | None, start_s: float
) -> RunResult:
    """Take away what is stale, and write the report unless the run was to stop before it."""
    survey, output = prepared.survey, prepared.context.output
    if until is None or STAGES.index(until) >= STAGES.index("deliver"):
        for path in withdraw_stale(survey, output):
            progress.tell(Note("info", f"taken away, as nothing in this run made it: {path}"))
    if until is not None and until != "report":
        return RunResult(int(bool(progress.failures or survey.inputs.bad)), output, None)
    facts = RunFacts(
        time.perf_counter() - start_s + _earlier_wall_s(output, progress),
        progress.invocation.workers,
        progress.costs,
        tuple(failures(survey, progress.failures)),
        progress.notes,
        [str(p) for p in survey.inputs.reference],
        _not_read(survey),
    )
    written = summarise(survey.done, prepared.context, facts)
    return RunResult(int(bool(written.failures)), output, written)


@contextmanager
def _telling_the_end(progress: Progress) -> Iterator[None]:
    """Log why a run stops before its end, for those who watch it from elsewhere."""
    try:
        yield
    except (SplBatchError, KeyboardInterrupt) as error:
        status = error.exit_status if isinstance(error, SplBatchError) else 3
        try:
            progress.tell(RunEnded(status, str(error) or "interrupted"))
        except StoppedError as unwritten:
            raise error from unwritten
        raise


def _expected_s(cost: Cost) -> dict[str, float]:
    """Time that each stage is expected to take, in the ratio of typical rates [s]."""
    shares = {stage: cost.points / rate for stage, rate in RATES_POINTS_PER_S.items()}
    whole = sum(shares.values())
    return {k: round(cost.time_s * v / whole, 1) for k, v in shares.items()} if whole else {}


def _process(
    prepared: Prepared, pool: Executor, progress: Progress, until: str | None, *, verify: bool
) -> None:
    """Go through the phases, and once more where a file of the store had to be made again."""
    _run_phases(prepared, pool, progress, until, verify=verify)
    while progress.repair(prepared.survey):
        _run_phases(prepared, pool, progress, until, verify=verify)


def _run_phases(
    prepared: Prepared, pool: Executor, progress: Progress, until: str | None, *, verify: bool
) -> None:
    survey, last = prepared.survey, STAGES.index(until) if until else len(STAGES)
    for phase in PHASES:
        stage = KINDS[phase.kind].stage
        if STAGES.index(stage) > last:
            return
        if phase.kind == "surface":
            make_rasters(prepared)
        work = Worklist(phase, survey, prepared.context, verify=verify)
        _run_phase(work, phase.kind, prepared, pool, progress)
        if progress.repairs.wanted(progress.failed, survey):
            return
        _judge(phase, survey, progress)
        for text in _warnings(survey.of(phase.kind)):
            progress.warn(text)


def _judge(phase: Phase, survey: Survey, progress: Progress) -> None:
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
    work: Worklist, kind: str, prepared: Prepared, pool: Executor, progress: Progress
) -> None:
    """Do what one phase has left to do."""
    survey, stage = prepared.survey, KINDS[kind].stage
    left: list[str] = []
    ready: list[str] = []
    for task, receipt in work.look():
        if receipt is None:
            left.append(task.name)
        else:
            ready.append(receipt.name)
            progress.costs.setdefault(stage, StageCost()).skip(receipt)
    if not work.left and not work.ready:
        return
    tiles = _tile_map(kind, left, ready, survey)
    left.clear()
    ready.clear()
    progress.tell(PhaseStarted(stage, kind, work.left, work.ready, work.points, tiles))

    def on_receipt(receipt: Receipt) -> None:
        progress.ended(work.ended(receipt), receipt)

    for receipt in work.refused:
        on_receipt(receipt)
    pool.run(work.jobs(), prepared.context, on_receipt)
    survey.of(kind).sort()


def _tile_map(
    kind: str, left: Sequence[str], ready: Sequence[str], survey: Survey
) -> dict[str, object]:
    """Map of a phase whose tasks are places, as it begins."""
    if kind in {"build_tile", "deliver_tile"}:
        edge = survey.tile_q
    elif kind == "denoise":
        edge = survey.block_q
    elif kind in {"ground", "surface"}:
        edge = survey.cell_q
    else:
        return {}
    tiles = TileMap.of(left, ready, edge / QUANTA_PER_M)
    return tiles.record() if tiles is not None else {}


def _judge_index(survey: Survey, progress: Progress) -> None:
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


def _earlier_wall_s(output: Path, progress: Progress) -> float:
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


def make_rasters(prepared: Prepared) -> None:
    """Make room for the raster cells of the ``surfaces`` stage."""
    workflow = prepared.context.workflow
    create_raster_store(
        prepared.context.rasters,
        (*PRODUCTS, "noise"),
        ground_cell=quanta(workflow.ground.cell_m),
        raster_cell=quanta(workflow.products.cell_m),
    )
