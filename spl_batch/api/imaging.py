"""Airborne single-photon lidar: the receiver that the project began with."""

from collections import Counter
from collections.abc import Callable, Container, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from statistics import median
from types import MappingProxyType
from typing import Any, ClassVar, Final

import numpy as np

from spl_batch.api.receiver import Limits, Place, Prepared, Receiver
from spl_batch.constants import QUANTA_PER_M
from spl_batch.errors import WorkflowError, grouped, named, told_together
from spl_batch.io.cells import create_raster_store
from spl_batch.io.las import promised_points
from spl_batch.kernels.ahead import compile_share
from spl_batch.plan.blocks import (
    remember_sizes,
    remember_stretch,
    remembered_sizes,
    remembered_stretch,
)
from spl_batch.plan.cost import SurveyCost, estimate
from spl_batch.plan.first_look import first_look, holds_few
from spl_batch.plan.flightlines import FALLBACK_PRF_HZ
from spl_batch.plan.inputs import gather_inputs
from spl_batch.plan.ledger import Phase
from spl_batch.plan.memory import REMEDIES, surface_reach_m
from spl_batch.plan.phases import PHASES
from spl_batch.plan.survey import Survey, mosaic_parts, timeless_sources
from spl_batch.report.model import Report
from spl_batch.report.summary import screen_summary
from spl_batch.runner import code_version
from spl_batch.runner.context import Context
from spl_batch.runner.remember import Receipts, RunFacts
from spl_batch.settings import BaseWorkflow
from spl_batch.stages.geometry import Ahead
from spl_batch.stages.surface import PRODUCTS
from spl_batch.task import Receipt
from spl_batch.tiling import quanta
from spl_batch.workflow import Workflow

_WORDS: Final[Mapping[str, str]] = MappingProxyType(
    {
        "index_file": "file",
        "build_tile": "tile",
        "gather": "stretch",
        "gather_range": "stretch",
        "scatter": "stretch",
        "fit_line": "flightline",
        "denoise": "block",
        "ground": "ground cell",
        "surface": "ground cell",
        "accuracy": "square of the reference",
    }
)


PAIRS_NAMED: Final = 5
"""Pairs of files with the same returns that are named; of tiles that overlap there are thousands
[count]."""

PRF_APART: Final = 0.05
"""A stated pulse rate may differ by this part from the one that gps_time tells."""


class Imaging(Receiver[Survey, Context]):
    """Flightlines to classified clouds, terrain and surface rasters."""

    workflow: ClassVar[type[BaseWorkflow]] = Workflow
    noun: ClassVar[str] = "airborne survey"
    phases: ClassVar[Sequence[Phase]] = PHASES
    words: ClassVar[Mapping[str, str]] = _WORDS
    remedies: ClassVar[Mapping[str, str]] = REMEDIES
    essential: ClassVar[frozenset[str]] = frozenset({"trajectory"})

    @property
    def compiles(self) -> Callable[[int, int], int]:
        """Compiles a share of the kernels."""
        return compile_share

    def prepare(
        self, workflow: Workflow, place: Place, limits: Limits
    ) -> Prepared[Survey, Context]:
        """Find and check every file of a workflow, from headers alone."""
        _check_cells(workflow, place.workflow)
        inputs = gather_inputs(workflow, place.base, place.output)
        crs_wkt = inputs.crs.to_wkt() if inputs.crs is not None else ""
        context = Context(workflow, place.base, place.output, crs_wkt, code_version())
        survey = Survey(inputs, workflow, limits.memory_bytes, limits.workers)
        survey.remembered = remembered_sizes(context.store, workflow)
        survey.remembered_stretch = remembered_stretch(context.store)
        return Prepared(self, survey, context)

    def cost(self, prepared: Prepared[Survey, Context]) -> SurveyCost:
        """What a run is expected to cost."""
        return estimate(prepared.ledger, prepared.context)

    def plan_rows(
        self, prepared: Prepared[Survey, Context], cost: SurveyCost
    ) -> list[tuple[str, str]]:
        """Label and value of what a plan tells beside disk, memory and time."""
        settings = prepared.ledger.workflow
        area_km2 = cost.tiles * settings.tiling.tile_m**2 / 1e6
        blocks = (
            f"about {grouped(cost.blocks)} of up to {cost.block_tiles} x {cost.block_tiles} tiles; "
            f"with their halos they read {cost.block_reads:.2f} times the points"
        )
        if cost.roomier is not None:
            memory_bytes, read = cost.roomier
            blocks += f", {read:.2f} times with --memory {memory_bytes / 2**30:g}GiB"
        halo = (
            f"{cost.halo_m:g} m around a block; around a ground cell "
            f"{settings.ground.buffer_m:g} m for the ground, "
            f"{surface_reach_m(settings):g} m for its rasters"
        )
        return [
            ("area", f"{grouped(area_km2, 3)} km2 of tiles"),
            ("stretches", f"{grouped(cost.stretches)} of flightlines"),
            ("tiles", grouped(cost.tiles)),
            ("blocks", blocks),
            ("ground cells", grouped(cost.cells)),
            ("halo", halo),
        ]

    def first_look(
        self, prepared: Prepared[Survey, Context]
    ) -> tuple[Sequence[str], Sequence[str]]:
        """What both ends of the files tell of their times and channels, and of the trajectory's."""
        survey = prepared.ledger
        faults, odd = first_look(survey.inputs, survey.workflow, prepared.context.base)
        return faults, (*odd, *survey.cut_anew())

    def before(self, phase: Phase, prepared: Prepared[Survey, Context]) -> None:
        """Settle the size of stretches and blocks; make room for the raster cells of ``surfaces``.

        What is remembered is read again: the run may have begun with emptying the store.
        """
        workflow, survey = prepared.context.workflow, prepared.ledger
        store = prepared.context.store
        if phase.kind == "index_part":
            survey.remembered_stretch = remembered_stretch(store)
            remember_stretch(store, survey.stretch_points)
        if phase.kind == "denoise" and workflow.tiling.block_tiles is None:
            survey.remembered = remembered_sizes(store, workflow)
            remember_sizes(store, workflow, survey.block_sizes)
        if phase.kind == "surface":
            create_raster_store(
                prepared.context.rasters,
                (*PRODUCTS, "noise"),
                ground_cell=quanta(workflow.ground.cell_m),
                raster_cell=quanta(workflow.products.cell_m),
            )

    def after(
        self, phase: Phase, prepared: Prepared[Survey, Context], failed: Sequence[Receipt]
    ) -> Iterable[str]:
        """Warn of what a phase has brought to light, or stop."""
        survey = prepared.ledger
        if phase.kind == "index_file":
            yield from _judge_index(survey, [r for r in failed if r.kind.startswith("index_")])
        if phase.kind == "gather":
            yield from _copies(survey)
            yield from _looks_ahead(survey)
        if phase.kind == "trajectory" and survey.inputs.trajectory and not survey.of("trajectory"):
            failures = [r.reason for r in failed if r.kind == "trajectory"]
            if failures:
                raise WorkflowError(f"survey.trajectory: {failures[-1]}")
        if phase.kind == "sensor_path" and survey.of("sensor_path"):
            yield _beams_without_trajectory(survey)
        if phase.kind == "surface" and len(mosaic_parts(survey)) > 1:
            yield (
                "the survey lies in pieces far apart: each has rasters of its own "
                "(dtm.tif, dtm_2.tif, ...), the largest piece comes first"
            )

    def follows(self, phase: Phase, prepared: Prepared[Survey, Context]) -> Container[str]:
        """Along wrong beams no gate is what it seems."""
        if phase.kind != "fit_line":
            return ()
        leaps, off = _times_off(prepared.ledger)
        return {*leaps, *off}

    def edge_m(self, kind: str, ledger: Survey) -> float:
        """Edge of the squares that a kind of task works on; 0 where they are no squares [m]."""
        if kind in {"build_tile", "denoise", "deliver_tile"}:
            return ledger.tile_q / QUANTA_PER_M
        return ledger.cell_q / QUANTA_PER_M if kind in {"ground", "surface"} else 0.0

    def reference(self, ledger: Survey) -> list[str]:
        """Files that the results are compared with."""
        return [str(facts.path) for facts in ledger.inputs.reference]

    def not_read(self, ledger: Survey) -> int:
        """Points that the headers of files promise which could not be read to their end [count]."""
        indexed, inputs = ledger.of("index_file"), ledger.inputs
        lost = sum(s.facts.n_points for s in inputs.sources if str(s.key) not in indexed)
        return lost + sum(promised_points(Path(path)) for path in {bad.path for bad in inputs.bad})

    def load_report(self) -> None:
        """Import what a report is drawn with."""
        import spl_batch.runner.summary  # noqa: F401, PLC0415 - a plan draws nothing

    def report(self, done: Receipts, context: Context, facts: RunFacts) -> Report:
        """Write ``report.json`` and ``report.html``."""
        from spl_batch.runner.summary import summarise  # noqa: PLC0415 - a plan draws nothing

        return summarise(done, context, facts)

    def screen(self, report: Report) -> list[tuple[str, str]]:
        """Label and value of each number that the console shows after a run."""
        return screen_summary(report)

    def results(self, output: Path) -> list[tuple[str, list[Path]]]:
        """What a user looks at first."""
        return [
            ("report", [output / "report.html"]),
            ("rasters", [output / "dtm.tif", output / "dsm.tif"]),
            ("clouds", [output / "laz"]),
        ]


RECEIVER: Final[Receiver[Any, Any]] = Imaging()
"""The one there is."""


def _judge_index(survey: Survey, failures: Iterable[Receipt]) -> Iterator[str]:
    """Stop where no input is usable; say which ones have no time."""
    usable = survey.of("index_file")
    if not usable or not any(r.points for r in usable.values()):
        reasons = [*told_together(survey.inputs.bad), *(r.reason for r in failures)]
        raise WorkflowError("no input is usable: " + ("; ".join(reasons) or "they hold no points"))
    _check_channels(survey)
    timeless = timeless_sources(survey)
    for source in timeless:
        yield (
            f"{source.name}: no usable gps_time (none, not finite, or the same for every "
            "point); its points are delivered unfiltered and take part in nothing"
        )
    guessed = [line.name for line in survey.flightlines if line.prf_basis == "assumed"]
    if guessed:
        yield (
            f"{named(guessed)}: gps_time does not tell the pulse rate; "
            f"{FALLBACK_PRF_HZ:.0f} Hz assumed; state acquisition.prf_hz"
        )
    yield from _contradicted_rates(survey)
    if survey.filtering and not survey.flightlines:
        raise WorkflowError(
            f"{named([source.name for source in timeless])}: no point has a usable gps_time, so "
            "there are no shots to filter by; set filter.method: none and afterpulse.enabled: "
            "false for ground and surfaces"
        )


def _check_channels(survey: Survey) -> None:
    """Stop where the dimension that was named cannot hold beamlet numbers."""
    name, sensor = survey.workflow.survey.channel_dimension, survey.workflow.sensor
    indexed = survey.of("index_file").values()
    points = sum(r.facts["points"] for r in indexed)
    if name is None or not survey.filtering:
        return
    seen = 0
    for receipt in indexed:
        seen |= int(receipt.facts["channels_seen"], 16)
    if not holds_few(seen.bit_count(), points, sensor):
        return
    listed = ", ".join(str(k) for k in range(256) if seen >> k & 1)
    files = named([r.facts["name"] for r in indexed], 3)
    raise WorkflowError(
        f"survey.channel_dimension: {name} holds only {listed} in {grouped(points)} points "
        f"({files}), and a {sensor.name} has {sensor.beamlets} beamlets; name the dimension that "
        "holds their numbers, or leave the key out: a shot is one beamlet then"
    )


def _copies(survey: Survey) -> Iterator[str]:
    """Say which files hold returns that others hold too."""
    counts: Counter[tuple[str, str]] = Counter()
    for receipt in survey.of("gather").values():
        for copy, kept, count in receipt.facts.get("copies", ()):
            counts[copy, kept] += count
    names = {str(source.key): source.name for source in survey.inputs.sources}
    most = sorted(counts.items(), key=lambda pair: (-pair[1], pair[0]))
    for (copy, kept), count in most[:PAIRS_NAMED]:
        yield (
            f"{names[copy]}: {grouped(count)} of its returns are in {names[kept]} too, at the "
            "same time and place; they count once, and the copies are delivered as not assessed: "
            "leave one of the files out, or its overlap"
        )
    if others := most[PAIRS_NAMED:]:
        yield (
            f"{grouped(len(others))} more pairs of files have returns in common, up to "
            f"{grouped(others[0][1])} of a pair and "
            f"{grouped(sum(count for _, count in others))} in all"
        )


def _times_off(survey: Survey) -> tuple[dict[str, int], dict[str, float]]:
    """Flightlines whose sensor is not above what it sees, as with times that are off.

    Leap seconds that the trajectory's times lack, where these explain it; else by how many
    seconds the times seem late [s]. A place is seen ahead first and astern later, so that one
    stretch of a small survey may lie on one side: what counts is the mean over all returns.
    """
    looks: dict[str, list[tuple[Ahead, int]]] = {}
    leaps: dict[str, int] = {}
    for name, receipt in survey.of("gather").items():
        line = name.split("/", maxsplit=1)[0]
        if "ahead" in receipt.facts:
            looks.setdefault(line, []).append((Ahead(*receipt.facts["ahead"]), receipt.points))
        if receipt.facts.get("leap_s"):
            leaps[line] = int(receipt.facts["leap_s"])
    off: dict[str, float] = {}
    for line, stretches in looks.items():
        means, returns = zip(*stretches, strict=True)
        whole = Ahead(*map(float, np.average(means, axis=0, weights=returns)))
        if not whole.is_above and line not in leaps:
            off[line] = whole.ahead_m / whole.speed_m_s
    return leaps, off


def _looks_ahead(survey: Survey) -> Iterator[str]:
    """Say where the trajectory's times are off, and by how much."""
    leaps, off = _times_off(survey)
    for leap in sorted(set(leaps.values())):
        said = "early, as UTC is" if leap > 0 else "late, as GPS time is for UTC"
        yield (
            f"{named([line for line in leaps if leaps[line] == leap])}: the trajectory's times are "
            f"{abs(leap)} s {said}: with them {'added' if leap > 0 else 'taken away'} the sensor "
            "is above its returns. Now noise and reflectance are reckoned along wrong beams, or "
            "returns stay unfiltered; correct gps_time in survey.trajectory and run again"
        )
    for side, late in (("behind", "early"), ("ahead of", "late")):
        those = [line for line, seconds in off.items() if (seconds < 0) == (late == "early")]
        if those:
            yield (
                f"{named(those)}: the returns lie {side} the sensor on average, so that the "
                f"trajectory's times seem about {abs(median(off[line] for line in those)):.1f} s "
                f"{late}; noise and reflectance are reckoned along wrong beams then: mend its "
                "times. Where only a part of each scan is delivered all is well"
            )


def _contradicted_rates(survey: Survey) -> Iterator[str]:
    """Say where gps_time tells another pulse rate than the one that is stated."""
    told = survey.of("index_file")
    wrong: dict[str, float] = {}
    for line in survey.flightlines:
        seen = [told[key].facts["prf_hz"].get(str(line.psid)) for key in line.sources]
        far = [hz for hz in seen if hz and abs(hz / line.clock.prf_hz - 1.0) > PRF_APART]
        if line.prf_basis == "given" and far and len(far) == sum(map(bool, seen)):
            wrong[line.name] = float(far[0])
    if wrong:
        yield (
            f"{named([*wrong])}: gps_time tells a pulse rate of about "
            f"{min(wrong.values()):.0f} Hz, not the {survey.workflow.sensor.prf_hz:.0f} Hz "
            "stated, by which noise is reckoned; leave acquisition.prf_hz and the sensor's out, "
            "and what is told is taken"
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


def _check_cells(workflow: Workflow, path: Path) -> None:
    """Edges are whole millimetres, and raster cells fill a ground cell."""
    edges = {
        "tiling.tile_m": workflow.tiling.tile_m,
        "ground.cell_m": workflow.ground.cell_m,
        "products.cell_m": workflow.products.cell_m,
        "noise.voxel_m": workflow.noise.voxel_m,
    }
    faults = [
        f"{key}: {edge:g} is not a whole number of millimetres"
        for key, edge in edges.items()
        if quanta(edge) < 1 or abs(edge * QUANTA_PER_M - quanta(edge)) > 1e-6
    ]
    if not faults and quanta(workflow.ground.cell_m) % quanta(workflow.products.cell_m):
        faults.append(
            f"ground.cell_m ({workflow.ground.cell_m:g}) must be a whole multiple of "
            f"products.cell_m ({workflow.products.cell_m:g})"
        )
    if faults:
        raise WorkflowError(f"{path}: {'; '.join(faults)}")
