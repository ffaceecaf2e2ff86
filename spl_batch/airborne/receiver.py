"""Airborne single-photon lidar: the receiver that the project began with."""

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, ClassVar, Final

from spl_batch.airborne.catalogue import (
    CLIENT_TILES,
    CONTOURS,
    INDEX,
    REPROJECTED,
    STAC,
    VIRTUAL,
)
from spl_batch.airborne.context import Context
from spl_batch.airborne.lines.comparison import done_sentence, shifts_of
from spl_batch.airborne.plan.cost import SurveyCost, estimate
from spl_batch.airborne.plan.inputs.findings import (
    beams_without_trajectory,
    copies,
    judge_index,
    points_astray,
    refuse_empty_area,
)
from spl_batch.airborne.plan.inputs.survey_inputs import Inputs, gather_inputs
from spl_batch.airborne.plan.space_tasks import is_one_flightline
from spl_batch.airborne.plan.survey_ledger import Survey
from spl_batch.airborne.plan.task_memory import surface_reach_m
from spl_batch.airborne.precompile import compiling
from spl_batch.airborne.products.product_table import ABOVE_GEOID, PRODUCTS
from spl_batch.airborne.report.model import Report
from spl_batch.airborne.report.verdicts import screen_summary
from spl_batch.airborne.settings.workflow import Workflow
from spl_batch.engine.findings import Finding
from spl_batch.engine.flow.warm_up import WarmUp
from spl_batch.engine.tasks.input_changes import stamp_if_there
from spl_batch.engine.tasks.step import Step
from spl_batch.engine.tasks.task import Receipt
from spl_batch.engine.verbs.receiver import FirstLook, Prepared, Receiver
from spl_batch.errors import WorkflowError, grouped, merged_faults
from spl_batch.formats.las.header import waveform_file
from spl_batch.formats.las.reader import promised_points
from spl_batch.formats.units import Units, in_words


class Imaging(Receiver[Survey, Context]):
    """Flightlines to classified clouds, terrain and surface rasters."""

    ledger = Survey
    context = Context
    delivered: ClassVar[tuple[str, ...]] = (
        *("laz/**/*", "tiles/*", "copc/**/*", f"{REPROJECTED}/**/*", f"{STAC}/*.json"),
        *(VIRTUAL, INDEX, CONTOURS, f"{CLIENT_TILES}/*"),
        *(f"{p.name}.tif" for p in (*PRODUCTS, *ABOVE_GEOID) if p.delivered),
    )

    def warm_up(self, workflow: Workflow, until: str | None, workers: int) -> WarmUp:
        """What compiles the kernels that tasks call up to a stage."""
        return compiling(workers, workflow, until)

    def gather(self, workflow: Workflow, base: Path, output: Path) -> Inputs:
        """Find and check every file of a workflow, from headers alone."""
        return gather_inputs(workflow, base, output)

    def cost(self, prepared: Prepared[Survey, Context]) -> SurveyCost:
        """What a run is expected to cost."""
        return estimate(prepared.ledger, prepared.context)

    def plan_rows(
        self, prepared: Prepared[Survey, Context], cost: SurveyCost
    ) -> list[tuple[str, str]]:
        """Label and value of what a plan prints beside disk, memory and time."""
        settings = prepared.ledger.workflow
        area_km2 = cost.tiles * settings.tiling.tile_m**2 / 1e6
        halo = (
            f"{cost.halo_m:g} m around a cell of denoise; around a ground cell "
            f"{settings.ground.buffer_m:g} m for the ground, "
            f"{surface_reach_m(settings):g} m for its rasters"
        )
        rows = [
            ("area", f"{grouped(area_km2, 3)} km2 of tiles"),
            ("stretches", f"{grouped(cost.stretches)} of flightlines"),
            ("tiles", grouped(cost.tiles)),
            (
                "cells of denoise",
                f"{grouped(cost.denoise_cells)} of {cost.side} x {cost.side} tiles",
            ),
            ("ground cells", grouped(cost.cells)),
            ("margin", halo),
        ]
        inputs = prepared.ledger.inputs
        if settings.filtering and not inputs.trajectory:
            beams = "from where lines of sight meet, by scan_angle, or vertical"
            rows.append(("trajectory", f"none: beams are taken {beams}"))
        numbered = settings.survey.channel_dimension is not None or settings.sensor.beamlets == 1
        if settings.filtering and not numbered:
            rows.append(("beamlets", "survey.channel_dimension is not set: a shot is one beamlet"))
        if inputs.checkpoints is not None and inputs.checkpoints.units:
            heights = " and ".join(map(in_words, inputs.checkpoints.units))
            rows.append(("checkpoints", f"{inputs.checkpoints.name}: heights in {heights}"))
        if settings.survey.align == "vertical":
            rows.append(("alignment", "survey.align: vertical: heights of flightlines are shifted"))
        return rows

    def first_look(self, prepared: Prepared[Survey, Context]) -> FirstLook:
        """Which companions of the points cannot be read."""
        inputs = prepared.ledger.inputs
        faults, late = map(merged_faults, (inputs.no_trajectory, inputs.reference.bad))
        return FirstLook(tuple(faults), late=tuple(late))

    def after(
        self, step: Step, prepared: Prepared[Survey, Context], failed: Sequence[Receipt]
    ) -> Iterable[Finding]:
        """Warn of what a step has brought to light, or stop."""
        survey = prepared.ledger
        if step.name == "index_file":
            yield from judge_index(survey, [r for r in failed if r.kind.startswith("index_")])
        if step.name == "build_tile":
            refuse_empty_area(survey)
            yield from copies(survey)
            yield from points_astray(survey)
        if step.name in {"trajectory_file", "trajectory"} and not survey.of(step.name):
            failures = [r.reason for r in failed if r.kind == step.name]
            if failures:  # nothing shows where the sensor was
                raise WorkflowError(f"survey.trajectory: {'; '.join(failures)}")
        if step.name == "sensor_path" and survey.of("sensor_path"):
            yield beams_without_trajectory(survey)
        if step.name == "align" and survey.workflow.survey.align != "none":
            yield from _shift_notes(survey, prepared.context.shown_units)

    def reference(self, ledger: Survey) -> list[str]:
        """Files that the results are compared with."""
        beside = [ledger.inputs.checkpoints.path] if ledger.inputs.checkpoints else []
        return [str(path) for path in (*(f.path for f in ledger.inputs.reference.usable), *beside)]

    def decisive(self, prepared: Prepared[Survey, Context]) -> list[Any]:
        """References, trajectory, polygons, geoid and waveforms beside the files."""
        inputs = prepared.ledger.inputs
        waves = (waveform_file(s.path, s.facts.point_format) for s in inputs.sources)
        files = [*inputs.trajectory, *filter(None, waves)]
        return [
            *super().decisive(prepared),
            [[str(path), *stamp_if_there(path)] for path in files],
            [*map(list, inputs.beside)],
        ]

    def not_read(self, ledger: Survey) -> int:
        """Points that the headers of files promise which could not be read to their end [count]."""
        indexed, inputs = ledger.of("index_file"), ledger.inputs
        lost = sum(s.facts.n_points for s in inputs.sources if str(s.key) not in indexed)
        return lost + sum(promised_points(Path(path)) for path in {bad.path for bad in inputs.bad})

    def screen(self, report: Report) -> list[tuple[str, str]]:
        """Label and value of each number that the console shows after a run."""
        return screen_summary(report)

    def results(self, output: Path) -> list[tuple[str, list[Path]]]:
        """What a user looks at first."""
        return [
            ("report", [output / "report.html"]),
            (
                "rasters",
                [output / "dtm.tif", output / "dsm.tif"],
            ),
            ("clouds", [output / "laz"]),
            ("reprojected", [output / REPROJECTED]),
            ("client tiles", [output / CLIENT_TILES]),
        ]


RECEIVER: Final[Receiver[Any, Any]] = Imaging()
"""The one there is."""


def _shift_notes(survey: Survey, units: Units) -> Iterator[Finding]:
    """By how much flightlines are shifted."""
    if bool(survey.of("index_file")) and is_one_flightline(survey):
        texts = ["survey.align: there is one flightline, nothing is shifted"]
    else:
        found = shifts_of(survey.of("align").values())
        texts = [] if all(one.stays for one in found) else [done_sentence(found, units)]
    for text in texts:
        yield Finding("E01", {"kind": "memory", "what": text})
