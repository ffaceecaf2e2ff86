"""What receipts show together of coverage, flightlines, checkpoints, and what is required."""

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np

from spl_batch.airborne.accuracy.checkpoint_errors import (
    OUTLIER_SIGMA,
    CheckpointError,
    CheckpointStatistics,
    at_checkpoints,
    statement,
)
from spl_batch.airborne.accuracy.evidence import (
    Evidence,
    PulseTotals,
    SwathDifferences,
)
from spl_batch.airborne.accuracy.requirements import Requirement, requirements
from spl_batch.airborne.context import Context
from spl_batch.airborne.diagnostics.terrain_sigma import unsure_share
from spl_batch.airborne.lines.comparison import pairs_of
from spl_batch.airborne.lines.pair_table import StripPair
from spl_batch.airborne.plan.flightlines import Flightline, find_flightlines, swath_totals
from spl_batch.airborne.pulses.swaths import SPACINGS, Coverage
from spl_batch.airborne.report.model import (
    Checkpoint,
    Checkpoints,
    Density,
    Swath,
)
from spl_batch.airborne.settings import ClassSettings
from spl_batch.airborne.settings.standards import LEVELS
from spl_batch.airborne.tasks import pulses
from spl_batch.airborne.tasks.reference import checkpoint_results
from spl_batch.constants import FOOT_M, QUANTUM_M
from spl_batch.engine.findings import Finding
from spl_batch.engine.report.run_record import Receipts
from spl_batch.formats.crs import vertical
from spl_batch.formats.gps_clock import time_standard
from spl_batch.formats.heights import NAVD88

VEGETATION_PER_M2: Final = 1.0
"""Below this density shrubs become ground (``docs/delivery.md``) [1/m2]."""

FEET_ALIKE: Final = 0.01
"""Share by which heights over those of the terrain may differ from the ratio of units."""


def judged(done: Receipts, context: Context) -> tuple[Requirement, ...]:
    """Every requirement, as a report has it."""
    workflow = context.workflow
    asked, crs = workflow.requirements, context.crs
    limits = LEVELS[asked.quality_level]
    nva, vva = _tested(done)
    flown = find_flightlines(done.get("index_file", {}), workflow)
    datum = None if crs is None else vertical(crs)
    known = Evidence(
        level=asked.quality_level,
        rmse_v_m=asked.rmse_v_m or limits.rmse_v_m,
        pulses_per_m2=asked.pulses_per_m2 or limits.pulses_per_m2,
        nva=nva,
        vva=vva,
        pulses=_pulses(done, context, limits.spacing),
        single=asked.coverage == "single",
        by_swath=swath_totals(done.get("surface", {}).values(), flown, limits.spacing),
        water_known=workflow.water is not None,
        swaths=_swaths(pairs_of(done.get("strip_pairs", {}).values())),
        flightlines=len(flown),
        classes=_classes(done),
        withheld_unclassified=sum(
            done["index_file"][key].facts["withheld_unclassified"]
            for key in done.get("deliver_file", {})
        ),
        filtered=workflow.filter.method != "none",
        has_crs=crs is not None,
        vertical_datum=None if datum is None else datum.name,
        time_standard=_time_standard(flown),
        units=context.shown_units,
    )
    return requirements(known)


def checkpoint_report(done: Receipts, context: Context) -> Checkpoints | None:
    """Results at the checkpoints; None where there are none."""
    found = checkpoint_results(done.get("checkpoints", {}))
    nva, vva = _tested(done)
    if nva is None or vva is None:
        return None
    outliers = {*nva.outliers, *vva.outliers}
    return Checkpoints(
        statement=statement(nva, vva, _class_m(context), context.shown_units.of_heights),
        nva=nva,
        vva=vva,
        points=tuple(Checkpoint(**one, outlier=one["id"] in outliers) for one in found),
    )


def checkpoint_findings(tested: Checkpoints | None, context: Context) -> Iterator[Finding]:
    """Heights in another unit, and blunders: outliers beyond three times the class's RMSE_V."""
    limit_m = OUTLIER_SIGMA * _class_m(context)
    points = tested.points if tested else ()
    heights = [(z, z + off) for z, off in ((p.z_m, p.error_m) for p in points) if z and off]
    ratio = float(np.median([z / terrain for z, terrain in heights if terrain] or [1.0]))
    if min(abs(ratio * FOOT_M - 1.0), abs(ratio / FOOT_M - 1.0)) < FEET_ALIKE:
        values = {"kind": "feet", "count": len(heights), "ratio": ratio, "codes": NAVD88}
        yield Finding("C01", values)
    gross = [one for one in points if one.outlier and abs(one.error_m or 0.0) > limit_m]
    if gross:
        worst = max(gross, key=lambda one: abs(one.error_m or 0.0))
        values = {
            "kind": "blunder", "count": len(gross), "of": len(points), "limit_m": limit_m,
            "names": [one.id for one in gross], "worst": worst.id,
            "error_m": worst.error_m or 0.0,
        }  # fmt: skip
        yield Finding("C01", values)


def _class_m(context: Context) -> float:
    """Vertical accuracy class that is asked for: the largest RMSE_V [m]."""
    asked = context.workflow.requirements
    return asked.rmse_v_m or LEVELS[asked.quality_level].rmse_v_m


def _tested(
    done: Receipts,
) -> tuple[CheckpointStatistics, CheckpointStatistics] | tuple[None, None]:
    """Accuracy at open and at vegetated checkpoints."""
    receipts = done.get("checkpoints", {})
    if not receipts:
        return None, None
    errors: dict[str, list[CheckpointError]] = {"open": [], "vegetated": []}
    for one in checkpoint_results(receipts):
        if one["error_m"] is not None:
            errors[one["surface"]].append(
                CheckpointError(one["id"], one["error_m"], one["accuracy_m"])
            )
    return at_checkpoints(errors["open"]), at_checkpoints(errors["vegetated"])


def _pulses(done: Receipts, context: Context, spacing: str) -> PulseTotals | None:
    """First returns of all ground cells; None without any."""
    facts: list[Mapping[str, Any]] = [r.facts for r in done.get("surface", {}).values()]
    if not facts:
        return None
    found = [Coverage(*of_cell[pulses.LEVELS][spacing]) for of_cell in facts]
    cells, returns, bare = (sum(of_cell[pulses.PULSES][k] for of_cell in facts) for k in range(3))
    cell_m2 = context.workflow.products.cell_m**2
    place_m2 = (SPACINGS[spacing] * QUANTUM_M) ** 2
    return PulseTotals(
        pulses=returns,
        area_m2=cells * cell_m2,
        squares=sum(one.squares for one in found),
        filled=sum(one.filled for one in found),
        void_m2=sum(one.void for one in found) * place_m2,
        bare_m2=bare * cell_m2,
    )


def swath_reports(done: Receipts, context: Context) -> tuple[Swath, ...]:
    """Density of each flightline by itself, as a report has it."""
    workflow = context.workflow
    flown = find_flightlines(done.get("index_file", {}), workflow)
    spacing = LEVELS[workflow.requirements.quality_level].spacing
    return tuple(
        Swath(
            id=name or None,
            area_m2=one.area_m2,
            pulses=one.pulses,
            middle_per_m2=one.middle_pulses / one.middle_m2,
            filled_share=one.filled / one.squares if one.squares else None,
        )
        for name, one in swath_totals(done.get("surface", {}).values(), flown, spacing).items()
    )


def _swaths(pairs: Sequence[StripPair]) -> SwathDifferences | None:
    """Differences of all pairs of flightlines together; None where none were measured."""
    known = [(one.flat_patches, one.rmsd_z_m) for one in pairs if one.flat_patches and one.rmsd_z_m]
    if not known:
        return None
    places = sum(count for count, _ in known)
    squares = sum(count * rmsd**2 for count, rmsd in known)
    return SwathDifferences(math.sqrt(squares / places), len(known), places)


def _classes(done: Receipts) -> Mapping[int, int]:
    total: Counter[int] = Counter()
    for receipt in done.get("deliver_file", {}).values():
        total.update({int(kind): n for kind, n in receipt.facts["classes"].items()})
    return total


def _time_standard(flown: Sequence[Flightline]) -> str | None:
    """Time standards of the flightlines; None where they have no times."""
    found = {str(time_standard(np.array([line.first_s, line.last_s]))) for line in flown}
    return " and ".join(sorted(found)) or None


def area_km2(done: Receipts, context: Context) -> float | None:
    """Area of the raster cells that were flown [km2]; None without any ground cell."""
    cells = _cells(done)
    return cells.total() * context.workflow.products.cell_m**2 / 1e6 if cells else None


def density(done: Receipts, context: Context, ground: int) -> Density:
    """How densely returns cover a survey, of which so many points are ground."""
    cells = _cells(done)
    if not cells:
        return Density()
    cell_m2 = context.workflow.products.cell_m**2
    area_m2 = cells.total() * cell_m2
    returns = sum(held * n for held, n in cells.items())
    return Density(
        mean_per_m2=returns / area_m2,
        median_per_m2=_quantile(cells, 0.5) / cell_m2,
        p05_per_m2=_quantile(cells, 0.05) / cell_m2,
        # Without signal no ground was looked for.
        ground_per_m2=ground / area_m2 if returns else None,
        void_share=sum(r.facts[pulses.VOIDS] for r in done["surface"].values()) / cells.total(),
        unsure_share=unsure_share(done),
    )


def sparse_vegetation(found: Density, asked: ClassSettings) -> tuple[Finding, ...]:
    """Whether classes of low and medium vegetation are asked of too few returns."""
    density_m2 = found.mean_per_m2
    if asked.vegetation is None or density_m2 is None or density_m2 >= VEGETATION_PER_M2:
        return ()
    values = {"per_m2": density_m2, "high_m": asked.vegetation.high}
    return (Finding("G03", values),)


def _cells(done: Receipts) -> Counter[int]:
    """Raster cells that were flown, by the signal returns in them [count]."""
    cells: Counter[int] = Counter()
    for receipt in done.get("surface", {}).values():
        cells.update({int(returns): n for returns, n in receipt.facts[pulses.CELLS].items()})
    return cells


def _quantile(cells: Mapping[int, int], share: float) -> int:
    """Smallest value that so many cells do not exceed."""
    values = sorted(cells)
    below: Iterable[int] = np.cumsum([cells[value] for value in values])
    wanted = share * sum(cells.values())
    return next(value for value, n in zip(values, below, strict=True) if n >= wanted)


def pairs_not_compared(done: Receipts) -> tuple[tuple[str, str], ...]:
    """Flightlines that overlap without planar patches enough to be compared."""
    receipts = done.get("strip_pairs", {}).values()
    return tuple((one, other) for r in receipts for one, other in r.facts.get("not_compared", ()))
