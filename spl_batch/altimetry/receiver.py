"""Photon profiles along a track: the receiver ``kind: altimetry``."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, ClassVar, Final

from spl_batch.altimetry.filter.track import MARGIN_M
from spl_batch.altimetry.plan import Inputs, Tracks, estimate, first_look, gather_inputs
from spl_batch.altimetry.report.model import TrackReport
from spl_batch.altimetry.report.page import screen_summary
from spl_batch.altimetry.settings import TrackWorkflow
from spl_batch.altimetry.tasks.context import Context
from spl_batch.engine.findings import Finding
from spl_batch.engine.plan.budget import Cost
from spl_batch.engine.tasks.step import Step
from spl_batch.engine.tasks.task import Receipt
from spl_batch.engine.verbs.receiver import FirstLook, Prepared, Receiver, none_usable
from spl_batch.errors import grouped


class Altimetry(Receiver[Tracks, Context]):
    """Photon files to labels and profiles."""

    delivered: ClassVar[tuple[str, ...]] = ("photons/**/*", "profiles/**/*", "hdf5/**/*")

    ledger = Tracks

    def gather(self, workflow: TrackWorkflow, base: Path, output: Path) -> Inputs:
        """Find and check every file of a workflow, from headers alone."""
        return gather_inputs(workflow, base, output)

    def first_look(self, prepared: Prepared[Tracks, Context]) -> FirstLook:
        """What tables of photons hold that a run refuses."""
        tracks = prepared.ledger
        return first_look(tracks.inputs, tracks.workflow.rate.cell_m)

    def cost(self, prepared: Prepared[Tracks, Context]) -> Cost:
        """What a run is expected to cost."""
        return estimate(prepared.ledger, prepared.context)

    def plan_rows(
        self,
        prepared: Prepared[Tracks, Context],
        cost: Cost,  # noqa: ARG002 - the form that every receiver has
    ) -> list[tuple[str, str]]:
        """Label and value of what a plan shows beside disk, memory and time."""
        return [
            ("beams", grouped(len(list(prepared.ledger.beams())))),
            ("segments", f"{grouped(prepared.ledger.expected_segments)} of track"),
            ("margin", f"{MARGIN_M:g} m of track to each side of a segment"),
        ]

    def after(
        self, step: Step, prepared: Prepared[Tracks, Context], failed: Sequence[Receipt]
    ) -> Iterable[Finding]:
        """Warn of what a step has brought to light, or stop."""
        tracks = prepared.ledger
        if step.name != "take_in":
            return
        taken = tracks.of("take_in")
        if not any(receipt.facts["placed"] for receipt in taken.values()):
            none_usable(failed, {"index_file", "take_in"}, map(str, tracks.inputs.bad))
        for source, beam, key in tracks.beams():
            lost = taken[key].points - taken[key].facts["placed"] if key in taken else 0
            if lost:
                values = {"kind": "unplaced", "count": lost}
                yield Finding("P01", values, f"{source.name} {beam.name}", badness=lost)

    def reference(self, ledger: Tracks) -> list[str]:
        """Files that the results are compared with."""
        return [str(path) for path in ledger.inputs.reference]

    def not_read(self, ledger: Tracks) -> int:
        """Photons that headers promise which could not be read to their end [count]."""
        taken = ledger.of("take_in")
        return sum(beam.photons for _, beam, key in ledger.beams() if key not in taken)

    def screen(self, report: TrackReport) -> list[tuple[str, str]]:
        """Label and value of each number that the console shows after a run."""
        return screen_summary(report)

    def results(self, output: Path) -> list[tuple[str, list[Path]]]:
        """What a user looks at first."""
        return [
            ("report", [output / "report.html"]),
            ("profiles", [output / "profiles"]),
            ("photons", [output / "photons", output / "hdf5"]),
        ]


RECEIVER: Final[Receiver[Any, Any]] = Altimetry()
"""The one there is."""
