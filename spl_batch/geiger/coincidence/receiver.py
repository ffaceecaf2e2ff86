"""Coincidence processing of Geiger-mode lidar, as the verbs need it."""

from collections.abc import Iterable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, ClassVar, Final

from spl_batch.engine.findings import Finding
from spl_batch.engine.plan.budget import Cost
from spl_batch.engine.report.run_record import Receipts, RunFacts
from spl_batch.engine.report.verdict import ending_rows
from spl_batch.engine.settings.base import BaseWorkflow
from spl_batch.engine.tasks.step import Step
from spl_batch.engine.tasks.task import Receipt
from spl_batch.engine.verbs.receiver import Prepared, Receiver, none_usable
from spl_batch.errors import WorkflowError, grouped
from spl_batch.geiger.coincidence.plan import L1Inputs, L1Ledger, estimate, gather
from spl_batch.geiger.coincidence.report.model import CoincidenceReport
from spl_batch.geiger.coincidence.settings import CoincidenceWorkflow
from spl_batch.geiger.coincidence.tasks import CoincidenceContext


class Coincidence(Receiver[L1Ledger, CoincidenceContext]):
    """Detections and looks to points."""

    workflow: ClassVar[type[BaseWorkflow]] = CoincidenceWorkflow
    noun: ClassVar[str] = "coincidence processing"
    delivered: ClassVar[tuple[str, ...]] = ("points/*",)

    ledger = L1Ledger

    def gather(self, workflow: CoincidenceWorkflow, base: Path, output: Path) -> L1Inputs:
        """Find and check every file of a workflow, from headers alone."""
        return gather(workflow, base, output)

    def cost(self, prepared: Prepared[L1Ledger, CoincidenceContext]) -> Cost:
        """What a run is expected to cost."""
        return estimate(prepared.ledger, prepared.context)

    def plan_rows(
        self,
        prepared: Prepared[L1Ledger, CoincidenceContext],
        cost: Cost,  # noqa: ARG002 - the form that every receiver has
    ) -> list[tuple[str, str]]:
        """Label and value of what a plan tells beside disk, memory and time."""
        workflow = prepared.context.workflow
        frames = sum(file.rows for file in prepared.ledger.inputs.frames)
        return [
            ("frames", f"{grouped(frames)} of {grouped(workflow.array.detectors)} looks each"),
            ("voxels", f"{workflow.voxel_q} mm, tiles of {workflow.tiling.tile_m:g} m"),
        ]

    def after(
        self,
        step: Step,
        prepared: Prepared[L1Ledger, CoincidenceContext],
        failed: Sequence[Receipt],
    ) -> Iterable[Finding]:
        """Stop where no file could be read."""
        if step.name in {"frames", "index_file"} and not prepared.ledger.of(step.name):
            none_usable(failed, {step.name})
        if step.name == "frames":
            _refuse_twice(prepared.ledger)
        if step.name == "index_file" and prepared.ledger.answered is not None:
            yield Finding("K01", {"kind": "unread"})

    def not_read(self, ledger: L1Ledger) -> int:
        """Detections that files promise which could not be read to their end [count]."""
        indexed = ledger.of("index_file")
        return sum(f.rows for f in ledger.inputs.detections if str(f.key) not in indexed)

    def report(
        self, done: Receipts, context: CoincidenceContext, facts: RunFacts
    ) -> CoincidenceReport:
        """Write ``report.json`` and ``report.html``."""
        from spl_batch.geiger.coincidence.report.summarise import summarise  # noqa: PLC0415 - a plan draws nothing

        return summarise(done, context, facts)

    def screen(self, report: CoincidenceReport) -> list[tuple[str, str]]:
        """Label and value of each number that the console shows after a run."""
        counts = report.counts
        return [
            ("looks", f"{grouped(counts.looks)} in {grouped(counts.frames)} frames"),
            ("detections", grouped(counts.detections)),
            ("points", f"{grouped(counts.points)} in {grouped(counts.tiles)} tiles"),
            *ending_rows(report.performance, report.failures, report.findings),
        ]

    def results(self, output: Path) -> list[tuple[str, list[Path]]]:
        """What a user looks at first."""
        return [("report", [output / "report.html"]), ("points", [output / "points"])]


def _refuse_twice(ledger: L1Ledger) -> None:
    """Stop where frames of two files share numbers."""
    spans = sorted(
        (*receipt.facts["numbers"], receipt.facts["name"])
        for receipt in ledger.of("frames").values()
        if receipt.facts["numbers"]
    )
    for (_, last, one), (first, _, other) in pairwise(spans):
        if first <= last:
            raise WorkflowError(
                f"{one} and {other}: frames run to {last} in the one and from {first} in the "
                "other; number frames through, file after file"
            )


RECEIVER: Final[Receiver[Any, Any]] = Coincidence()
"""The one there is."""
