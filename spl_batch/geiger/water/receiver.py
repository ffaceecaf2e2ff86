"""Water surface from a Geiger-mode array, as the verbs see it."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any, ClassVar, Final

from pyproj import CRS

from spl_batch.engine.findings import Finding
from spl_batch.engine.plan.budget import Cost, measured_rates
from spl_batch.engine.plan.input_files import check_keys, expand, refuse_own, stem_names, usable
from spl_batch.engine.plan.worker_memory import WORKER_BASE_BYTES
from spl_batch.engine.report.verdict import card_rows
from spl_batch.engine.tasks.input_changes import stamp_if_there
from spl_batch.engine.tasks.ledger import Ledger
from spl_batch.engine.tasks.step import Step
from spl_batch.engine.tasks.task import Receipt, Task
from spl_batch.engine.verbs.receiver import Prepared, Receiver, none_usable
from spl_batch.errors import InputError, WorkflowError, counted, grouped
from spl_batch.formats.crs import projected_crs
from spl_batch.geiger.water.formats import PIECE_VALUES, FrameFacts, inspect_frames
from spl_batch.geiger.water.settings import WaterWorkflow
from spl_batch.geiger.water.tasks import WaterContext

BYTES_PER_PIXEL: Final = 180
"""Of each acquisition's results while a task holds them [byte]."""

WORK_BYTES_PER_PIXEL: Final = 1200
"""Of the one acquisition that is being made [byte]."""

RATES_FRAMES_PER_S: Final = MappingProxyType(
    {"index": 6.0e4, "calibrate": 1.0e6, "surfaces": 7.0e3, "deliver": 2.0e5}
)
"""Frames of 1024 pixels a second until a store has measured its own."""


PIECE_ACQUISITIONS: Final = 50
"""Acquisitions of a task, at most [count]."""

PIECE_PIXELS: Final = 51_200
"""Pixels of all its acquisitions, where more than one are done [count]."""


@dataclass(frozen=True, slots=True)
class FrameSource:
    """A file of frames that can be used."""

    path: Path  #: Where it lies.
    name: str
    key: int  #: What tasks call it; depends on its name alone.
    facts: FrameFacts
    #: Of the target, where it is for calibration; 0 where it is of the water [m].
    distance_m: float = 0.0

    @property
    def args(self) -> dict[str, object]:
        """The file as the arguments of a task name it."""
        return {
            "source": str(self.key),
            "name": self.name,
            "path": str(self.path),
            "stamp": stamp_if_there(self.path),
            "frames": self.facts.frames,
        }


@dataclass(frozen=True, slots=True)
class WaterInputs:
    """Everything that a workflow names, checked."""

    sources: tuple[FrameSource, ...]  #: Files of the water, by name.
    targets: tuple[FrameSource, ...]  #: Files for calibration, as the workflow lists them.
    bad: tuple[InputError, ...]  #: Files that cannot be used.
    crs: CRS | None
    warnings: tuple[Finding, ...]  #: What a user should know before the work starts.


class WaterLedger(Ledger[WaterInputs, WaterWorkflow]):
    """Inputs and finished tasks of a run."""

    @property
    def per(self) -> int:
        """Frames of an acquisition [count]."""
        return self.workflow.surface.frames_per_acquisition

    @property
    def most(self) -> int:
        """Acquisitions of a task, at most [count]."""
        pixels = self.workflow.camera.rows * self.workflow.camera.cols
        return max(min(PIECE_PIXELS // pixels, PIECE_ACQUISITIONS), 1)

    def pieces(self, source: FrameSource) -> Iterator[tuple[str, int, int]]:
        """Name, first and last acquisition of each task on a file."""
        whole = source.facts.frames // self.per
        for number, first in enumerate(range(0, whole, self.most)):
            yield f"{source.key}/{number:06d}", first, min(first + self.most, whole)


def _by_key(sources: Sequence[FrameSource]) -> dict[str, FrameSource]:
    """Each file once, though a workflow may name it for two purposes."""
    return {str(s.key): s for s in sources}


def count_frames(ledger: WaterLedger) -> Iterator[Task]:
    """Files whose frames are counted, each once."""
    inputs = ledger.inputs
    for key, source in _by_key((*inputs.targets, *inputs.sources)).items():
        args = {**source.args, "role": "target" if source.distance_m else "water"}
        yield Task("count_frames", key, args, (), source.facts.frames)


def calibrate(ledger: WaterLedger) -> Iterator[Task]:
    """One task that finds the calibration."""
    done, inputs = ledger.of("count_frames"), ledger.inputs
    sources = [s for s in (inputs.targets or inputs.sources) if str(s.key) in done]
    if not sources:
        return
    counted = [done[str(s.key)].facts for s in sources]
    args = {
        "sources": [
            {"source": str(s.key), "gate": facts["gate"], "frames": s.facts.frames}
            for s, facts in zip(sources, counted, strict=True)
        ],
        "distances_m": [s.distance_m for s in sources] if inputs.targets else [],
    }
    needs = tuple(("count_frames", key) for key in _by_key(sources))
    refused = ""
    if len(sources) < len(inputs.targets):
        refused = "frames for calibration could not be read; repair them or take them out"
    yield Task("calibrate", "all", args, needs, 0, refused)


def make_surfaces(ledger: WaterLedger) -> Iterator[Task]:
    """Pieces of files whose surfaces are made."""
    done, calibrated = ledger.of("count_frames"), ledger.of("calibrate")
    for key, source in _by_key(ledger.inputs.sources).items():
        if key not in done or "all" not in calibrated:
            continue
        facts = calibrated["all"].facts
        needs = (("count_frames", key), ("calibrate", "all"))
        for name, first, last in ledger.pieces(source):
            args = {
                **source.args,
                "name": name,
                "gate": done[key].facts["gate"],
                "acquisitions": [first, last],
                "truth_frames": source.facts.truth_frames,
                "calibration": facts["settings"],
                "residual_ns": facts["residual_ns"],
            }
            yield Task("make_surfaces", name, args, needs, (last - first) * ledger.per)


def deliver_file(ledger: WaterLedger) -> Iterator[Task]:
    """Files of which all surfaces are made."""
    made = ledger.of("make_surfaces")
    stems = stem_names(ledger.inputs.sources)
    for source in ledger.inputs.sources:
        pieces = [name for name, _, _ in ledger.pieces(source)]
        # A surface that is missing would shift the acquisitions behind it.
        if pieces and all(name in made for name in pieces):
            args = {"pieces": pieces, "delivered": stems[source.key]}
            needs = tuple(("make_surfaces", name) for name in pieces)
            yield Task("deliver_file", str(source.key), args, needs, source.facts.frames)


Run = Prepared[WaterLedger, WaterContext]


class Water(Receiver[WaterLedger, WaterContext]):
    """Frames of time bins to surfaces, normals and rays."""

    delivered: ClassVar[tuple[str, ...]] = ("points/*", "surfaces/**/*")

    ledger = WaterLedger

    def gather(self, workflow: WaterWorkflow, base: Path, output: Path) -> WaterInputs:
        """Find and check every file of a workflow, from what it declares."""
        faults: list[str] = []
        paths = expand(workflow.survey.frames, base, "survey.frames", faults)
        targets: list[FrameSource] = []
        for k, target in enumerate(workflow.calibration.frames):
            key = f"calibration.frames[{k}]"
            look = partial(_source, workflow, target.distance_m)
            good, wrong = usable(expand(target.frames, base, key, faults), base, look)
            targets += good
            # Without one of its distances a calibration would silently be another.
            faults += [f"{key}: {error}" for error in wrong]
        refuse_own(paths, output, "survey.frames", faults)
        crs = projected_crs(workflow.survey.crs, "survey.crs", faults)
        if faults:
            raise WorkflowError("; ".join(faults))
        sources, bad = usable(paths, base, partial(_source, workflow, 0.0))
        per = workflow.surface.frames_per_acquisition
        warnings = [finding for source in sources for finding in _left_out(source, per)]
        if crs is None and sources:
            warnings.append(Finding("W02"))
        check_keys((*sources, *targets))
        return WaterInputs(sources, tuple(targets), tuple(bad), crs, tuple(warnings))

    def cost(self, prepared: Run) -> Cost:
        """What a run is expected to cost."""
        ledger, context = prepared.ledger, prepared.context
        inputs, camera = ledger.inputs, ledger.workflow.camera
        pixels = camera.rows * camera.cols
        frames = sum(s.facts.frames for s in (*inputs.sources, *inputs.targets))
        pieces = sum(len(list(ledger.pieces(s))) for s in inputs.sources)
        acquisitions = sum(s.facts.frames // ledger.per for s in inputs.sources)
        results = min(ledger.most, max(acquisitions, 1)) * BYTES_PER_PIXEL
        widest = max((*inputs.sources, *inputs.targets), key=lambda s: s.facts.piece_bytes)
        heaviest, remedy = "make_surfaces", ""
        if widest.facts.chunk_frames * pixels > PIECE_VALUES:
            heaviest = f"a chunk of {grouped(widest.facts.chunk_frames)} frames in {widest.name}"
            most = grouped(max(PIECE_VALUES // pixels, 1))
            remedy = f"store it again in chunks of {most} frames or fewer"
        rates, measured = measured_rates(RATES_FRAMES_PER_S, context)
        return Cost(
            points=frames,
            tasks=len(inputs.sources) * 2 + len(inputs.targets) + pieces + 1,
            disk_bytes=2 * acquisitions * pixels * BYTES_PER_PIXEL,
            memory_bytes=WORKER_BASE_BYTES
            + widest.facts.piece_bytes
            + pixels * (WORK_BYTES_PER_PIXEL + results),
            heaviest=heaviest,
            remedy=remedy,
            stages_s={stage: frames / rate for stage, rate in rates.items()},
            workers=ledger.workers,
            measured=measured,
        )

    def plan_rows(self, prepared: Run, cost: Cost) -> list[tuple[str, str]]:  # noqa: ARG002 - all have it
        """Label and value of what a plan prints beside disk, memory and time."""
        ledger = prepared.ledger
        surfaces = sum(s.facts.frames // ledger.per for s in ledger.inputs.sources)
        targets = len(ledger.inputs.targets)
        given = f"from {counted(targets, 'files')}" if targets else "as the workflow gives it"
        made = f"{grouped(surfaces)} of {grouped(ledger.per)} frames each"
        return [("surfaces", made), ("calibration", given)]

    def after(self, step: Step, prepared: Run, failed: Sequence[Receipt]) -> Iterable[Finding]:
        """Stop where nothing is left to go on with."""
        ledger = prepared.ledger
        if step.name == "count_frames":
            done = ledger.of("count_frames")
            if not any(str(s.key) in done for s in ledger.inputs.sources):
                none_usable(failed, {"count_frames"})
        if step.name == "calibrate" and "all" not in ledger.of("calibrate"):
            reasons = "; ".join(r.reason for r in failed if r.kind == "calibrate")
            raise WorkflowError(f"without a calibration there are no ranges: {reasons}")
        return ()

    def decisive(self, prepared: Run) -> list[Any]:
        """Frames for calibration."""
        targets = prepared.ledger.inputs.targets
        return [[str(target.path), *stamp_if_there(target.path)] for target in targets]

    def screen(self, report: Any) -> list[tuple[str, str]]:
        """Label and value of each number that the console shows after a run."""
        from spl_batch.geiger.water.report.summarise import cards  # noqa: PLC0415 - draws

        return card_rows(cards(report), report)

    def results(self, output: Path) -> list[tuple[str, list[Path]]]:
        """What a user looks at first."""
        shown = {"report": "report.html", "rasters": "surfaces", "points": "points"}
        return [(label, [output / name]) for label, name in shown.items()]


def _source(
    workflow: WaterWorkflow, distance_m: float, path: Path, name: str, key: int
) -> FrameSource:
    facts = inspect_frames(path, workflow.camera.rows, workflow.camera.cols)
    per = workflow.surface.frames_per_acquisition
    if not distance_m and facts.frames < per:
        few = f"holds {facts.frames} frames, fewer than surface.frames_per_acquisition {per}"
        raise InputError(str(path), f"{few}; lower it or leave the file out")
    return FrameSource(path, name, key, facts, distance_m)


def _left_out(source: FrameSource, per: int) -> Iterator[Finding]:
    left, truth = source.facts.frames % per, source.facts.truth_frames
    if left:
        yield Finding("W01", {"kind": "rest", "count": left, "per": per}, source.name, None, left)
    if missing := source.facts.missing_chunks:
        values = {"kind": "chunks", "count": missing}
        yield Finding("W01", values, source.name, badness=missing)
    if truth not in {0, per}:
        yield Finding("W01", {"kind": "truth", "truth": truth, "per": per}, source.name)


RECEIVER: Final[Receiver[Any, Any]] = Water()
"""The one there is."""
