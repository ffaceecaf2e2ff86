"""Water surface from a Geiger-mode array, as the verbs see it."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, ClassVar, Final

from spl_batch.engine.findings import Finding
from spl_batch.engine.plan.budget import Cost
from spl_batch.engine.report.run_record import Receipts, RunFacts
from spl_batch.engine.settings.base import BaseWorkflow
from spl_batch.engine.tasks.ledger import Phase
from spl_batch.engine.tasks.runner import code_version
from spl_batch.engine.tasks.task import Receipt, Task
from spl_batch.engine.verbs.receiver import FirstLook, Limits, Place, Prepared, Receiver
from spl_batch.errors import WorkflowError, counted, grouped
from spl_batch.geiger.water.calibration_targets import WITHOUT, refuse_unusable
from spl_batch.geiger.water.plan import PHASES, WaterLedger, estimate, gather_inputs
from spl_batch.geiger.water.report.model import WaterReport
from spl_batch.geiger.water.settings import WaterWorkflow
from spl_batch.geiger.water.tasks.surfaces import WaterContext

_WORDS: Final[Mapping[str, str]] = MappingProxyType(
    {
        "count_frames": "file",
        "make_surfaces": "acquisitions",
        "deliver_points": "file",
        "deliver_rasters": "file",
    }
)


def _silent(counted: Iterable[Receipt]) -> Iterable[Finding]:
    """Files with more frames without a hit than chance explains: a chunk that is gone reads so."""
    found = sorted((r.facts for r in counted), key=lambda f: str(f["name"]))
    for facts in found:
        if facts["silent_beyond_chance"]:
            values = {"kind": "silent", "count": facts["silent"], "of": facts["frames"]}
            badness = facts["silent"] / facts["frames"]
            yield Finding("W01", values, str(facts["name"]), badness=badness)


class Water(Receiver[WaterLedger, WaterContext]):
    """Frames of time bins to surfaces, normals and rays."""

    workflow: ClassVar[type[BaseWorkflow]] = WaterWorkflow
    noun: ClassVar[str] = "water surface"
    phases: ClassVar[Sequence[Phase]] = PHASES
    words: ClassVar[Mapping[str, str]] = _WORDS
    remedies: ClassVar[Mapping[str, str]] = MappingProxyType(
        {"make_surfaces": "store frames in smaller chunks"}
    )
    delivered: ClassVar[tuple[str, ...]] = ("points/*", "surfaces/**/*")

    def prepare(
        self, workflow: WaterWorkflow, place: Place, limits: Limits
    ) -> Prepared[WaterLedger, WaterContext]:
        """Find and check every file of a workflow, from what it declares."""
        inputs = gather_inputs(workflow, place.base, place.output)
        crs_wkt = inputs.crs.to_wkt() if inputs.crs is not None else ""
        context = self.context(workflow, place, crs_wkt, code_version(workflow.kind))
        ledger = WaterLedger(inputs, workflow, limits.memory_bytes, limits.workers)
        return Prepared(self, ledger, context)

    def cost(self, prepared: Prepared[WaterLedger, WaterContext]) -> Cost:
        """What a run is expected to cost."""
        return estimate(prepared.ledger, prepared.context)

    def first_look(self, prepared: Prepared[WaterLedger, WaterContext]) -> FirstLook:
        """Refuse frames for calibration that a run could not use."""
        refuse_unusable(prepared.ledger, prepared.context)
        return FirstLook()

    def plan_rows(
        self,
        prepared: Prepared[WaterLedger, WaterContext],
        cost: Cost,  # noqa: ARG002 - the form that every receiver has
    ) -> list[tuple[str, str]]:
        """Label and value of what a plan tells beside disk, memory and time."""
        ledger = prepared.ledger
        surfaces = sum(s.facts.frames // ledger.per for s in ledger.inputs.sources)
        targets = len(ledger.inputs.targets)
        return [
            ("surfaces", f"{grouped(surfaces)} of {grouped(ledger.per)} frames each"),
            (
                "calibration",
                f"from {counted(targets, 'files')}" if targets else "as the workflow gives it",
            ),
        ]

    def after(
        self,
        phase: Phase,
        prepared: Prepared[WaterLedger, WaterContext],
        failed: Sequence[Receipt],
    ) -> Iterable[Finding]:
        """Stop where nothing is left to go on with."""
        ledger = prepared.ledger
        if phase.kind == "count_frames":
            counted = ledger.of("count_frames")
            if not any(str(s.key) in counted for s in ledger.inputs.sources):
                reasons = "; ".join(r.reason for r in failed if r.kind == "count_frames")
                raise WorkflowError(f"no input is usable: {reasons}")
            yield from _silent(counted.values())
        if phase.kind == "calibrate" and "all" not in ledger.of("calibrate"):
            reasons = "; ".join(r.reason for r in failed if r.kind == "calibrate")
            raise WorkflowError(f"{WITHOUT}: {reasons}")

    def targets(self, task: Task, workflow: WaterWorkflow) -> Sequence[str]:
        """Names of the files, below the output, that a task delivers."""
        del workflow
        if task.kind == "deliver_points":
            return [f"points/{task.args['delivered']}.parquet"]
        if task.kind == "deliver_rasters":
            name = task.args["delivered"]
            return [f"surfaces/{name}.tif", f"surfaces/{name}/"]
        return []

    def report(self, done: Receipts, context: WaterContext, facts: RunFacts) -> WaterReport:
        """Write ``report.json`` and ``report.html``."""
        from spl_batch.geiger.water.report.summarise import summarise  # noqa: PLC0415 - draws

        return summarise(done, context, facts)

    def screen(self, report: WaterReport) -> list[tuple[str, str]]:
        """Label and value of each number that the console shows after a run."""
        from spl_batch.geiger.water.report.page import screen_summary  # noqa: PLC0415 - as above

        return screen_summary(report)

    def results(self, output: Path) -> list[tuple[str, list[Path]]]:
        """What a user looks at first."""
        return [
            ("report", [output / "report.html"]),
            ("rasters", [output / "surfaces"]),
            ("points", [output / "points"]),
        ]


RECEIVER: Final[Receiver[Any, Any]] = Water()
"""The one there is."""
