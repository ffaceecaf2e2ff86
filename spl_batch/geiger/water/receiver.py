"""Water surface from a Geiger-mode array, as the verbs see it."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, ClassVar, Final

from spl_batch.engine.findings import Finding
from spl_batch.engine.plan.budget import Cost
from spl_batch.engine.report.run_record import Receipts, RunFacts
from spl_batch.engine.settings.base import BaseWorkflow
from spl_batch.engine.tasks.input_changes import stamp_if_there
from spl_batch.engine.tasks.step import Step
from spl_batch.engine.tasks.task import Receipt
from spl_batch.engine.verbs.receiver import Prepared, Receiver, none_usable
from spl_batch.errors import WorkflowError, counted, grouped
from spl_batch.geiger.water.plan import WaterInputs, WaterLedger, estimate, gather_inputs
from spl_batch.geiger.water.report.model import WaterReport
from spl_batch.geiger.water.settings import WaterWorkflow
from spl_batch.geiger.water.tasks.surfaces import WaterContext


class Water(Receiver[WaterLedger, WaterContext]):
    """Frames of time bins to surfaces, normals and rays."""

    workflow: ClassVar[type[BaseWorkflow]] = WaterWorkflow
    noun: ClassVar[str] = "water surface"
    delivered: ClassVar[tuple[str, ...]] = ("points/*", "surfaces/**/*")

    ledger = WaterLedger

    def gather(self, workflow: WaterWorkflow, base: Path, output: Path) -> WaterInputs:
        """Find and check every file of a workflow, from what it declares."""
        return gather_inputs(workflow, base, output)

    def cost(self, prepared: Prepared[WaterLedger, WaterContext]) -> Cost:
        """What a run is expected to cost."""
        return estimate(prepared.ledger, prepared.context)

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
        step: Step,
        prepared: Prepared[WaterLedger, WaterContext],
        failed: Sequence[Receipt],
    ) -> Iterable[Finding]:
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

    def decisive(self, prepared: Prepared[WaterLedger, WaterContext]) -> list[Any]:
        """Frames for calibration."""
        targets = prepared.ledger.inputs.targets
        return [[str(target.path), *stamp_if_there(target.path)] for target in targets]

    def report(self, done: Receipts, context: WaterContext, facts: RunFacts) -> WaterReport:
        """Write ``report.json`` and ``report.html``."""
        from spl_batch.geiger.water.report.summarise import summarise  # noqa: PLC0415 - draws

        return summarise(done, context, facts)

    def screen(self, report: WaterReport) -> list[tuple[str, str]]:
        """Label and value of each number that the console shows after a run."""
        from spl_batch.geiger.water.report.summarise import screen_summary  # noqa: PLC0415 - as above

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
