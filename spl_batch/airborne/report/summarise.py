"""Stage ``report``: what all receipts hold together, as one report with its pictures."""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict
from itertools import chain
from pathlib import Path
from typing import Any, cast

import numpy as np

from spl_batch.airborne.context import Context, reprojection
from spl_batch.airborne.diagnostics.air_fill import air_findings
from spl_batch.airborne.diagnostics.noise_fit import noise_findings, p_values, uniformity
from spl_batch.airborne.diagnostics.terrain_sigma import terrain_findings
from spl_batch.airborne.hydro.flattening import bank_findings
from spl_batch.airborne.lines.comparison import difference_map, pairs_of, shifts_of
from spl_batch.airborne.report.good_enough import (
    area_km2,
    checkpoint_findings,
    checkpoint_report,
    density,
    judged,
    pairs_not_compared,
    sparse_vegetation,
    swath_reports,
)
from spl_batch.airborne.report.model import (
    Basis,
    ClientTile,
    Counts,
    DeliveredUnits,
    Flightline,
    Noise,
    NoiseFit,
    Report,
    Survey,
)
from spl_batch.airborne.report.pictures import OF_PRODUCTS, make_pictures
from spl_batch.airborne.report.profile_strips import read_strip, tallest_strip
from spl_batch.airborne.report.survey_page import render
from spl_batch.airborne.report.verdicts import mostly_unfiltered
from spl_batch.airborne.settings import FilterSettings
from spl_batch.airborne.settings.workflow import Workflow
from spl_batch.airborne.tasks.accuracy import Comparison, compared, not_compared, own_points
from spl_batch.constants import NODATA, QUANTUM_M
from spl_batch.engine.findings import Finding
from spl_batch.engine.report.maps import Raster
from spl_batch.engine.report.page import write_both
from spl_batch.engine.report.parts import InputFile, Provenance
from spl_batch.engine.report.reported import reported
from spl_batch.engine.report.run_record import (
    Receipts,
    RunFacts,
    input_file,
    performance,
    provenance,
)
from spl_batch.formats.geoid import grid_file
from spl_batch.formats.rasters.parts import RasterPart, read_overview


def summarise(done: Receipts, context: Context, facts: RunFacts) -> Report:
    """Write ``report.json`` and ``report.html``."""
    found, counts = compared(done, context), _counts(done, context, facts)
    tested = checkpoint_report(done, context)
    noise = _noise(done, context, counts.background)
    covered = density(done, context, counts.ground)
    report = Report(
        survey=_survey(done, context),
        counts=counts,
        header_changes=_header_changes(done),
        accuracy=None if found is None else found.accuracy,
        requirements=judged(done, context),
        checkpoints=tested,
        density=covered,
        noise=noise,
        swaths=swath_reports(done, context),
        strips=pairs_of(done.get("strip_pairs", {}).values()),
        strips_not_compared=pairs_not_compared(done),
        alignment=shifts_of(done.get("align", {}).values()),
        client_tiles=tuple(
            ClientTile(name=name, points=r.points)
            for name, r in sorted(done.get("deliver_client_tile", {}).items())
        ),
        performance=performance(facts, sum(r.facts["points"] for r in done["index_file"].values())),
        failures=tuple(facts.failures),
        findings=reported(
            (
                *_unfiltered(counts, context),
                *facts.findings,
                *noise_findings(done),
                *air_findings(done, context.workflow.filter),
                *terrain_findings(done),
                *sparse_vegetation(covered, context.workflow.classes),
                *bank_findings(
                    r.facts["banks"] for r in done["surface"].values() if "banks" in r.facts
                ),
                *checkpoint_findings(tested, context),
                *not_compared(done, context, facts),
                *own_points(None if found is None else found.own_share),
            ),
            context.workflow.report.ignore,
            units=context.shown_units,
        ),
        provenance=_provenance(done, context, facts.reference),
    )
    parts = _parts(done, context, found)
    cut = tallest_strip(parts["chm"]) if "chm" in parts else None
    pictures = make_pictures(
        {name: Raster(part.values, part.extent_m) for name, part in parts.items()},
        report,
        None if cut is None else read_strip(cut, done, context),
        None if found is None else found.differences_m,
    )
    write_both(context.output, report, render(report, pictures))
    return report


def _survey(done: Receipts, context: Context) -> Survey:
    workflow, crs = context.workflow, context.crs
    boxes = [r.facts["bounds"] for r in done["index_file"].values() if r.facts["bounds"]]
    low = [min(b[a] for b in boxes) * QUANTUM_M for a in (0, 1)]
    high = [max(b[a] for b in boxes) * QUANTUM_M for a in (3, 4)]
    authority = crs.to_authority() if crs is not None else None
    elsewhere = reprojection(workflow.outputs, crs)
    return Survey(
        name=workflow.survey.name,
        crs=":".join(authority) if authority else (crs.name if crs is not None else None),
        crs_name=crs.name if crs is not None else None,
        reprojected_crs_name=None if elsewhere is None else elsewhere.crs.name,
        units=DeliveredUnits(**asdict(context.shown_units)),
        sensor=workflow.sensor.name if workflow.filtering else None,
        area_km2=area_km2(done, context),
        extent_m=(low[0], high[0], low[1], high[1]),
        cell_m=workflow.products.cell_m,
        flightlines=tuple(_flightlines(done, context)),
        organisation=workflow.survey.organisation,
        contact=workflow.survey.contact,
        licence=workflow.survey.licence,
    )


def _flightlines(done: Receipts, context: Context) -> Iterable[Flightline]:
    workflow = context.workflow
    for name, receipt in done.get("fit_line", {}).items():
        facts = receipt.facts
        yield Flightline(
            **{key: facts[key] for key in ("points", "prf_hz", "gate_m", "seen_fraction")},
            id=name,
            shots=_shots(facts["span_s"], facts["prf_hz"]),
            start_s=facts["span_s"][0],
            end_s=facts["span_s"][1],
            prf_basis=_basis(workflow, "prf_hz", facts["prf_basis"]),
            gate_basis=_basis(workflow, "gate_m", facts["gate_basis"]),
            beam_basis=facts["basis"],
            noise_per_m=facts["noise_per_m"],
        )


def _basis(workflow: Workflow, key: str, found: str) -> Basis:
    """Where a number of a flightline comes from; a preset states it for every survey."""
    if found in {"estimated", "assumed"}:
        return cast("Basis", found)
    from_preset = getattr(workflow.acquisition, key) is None and isinstance(
        workflow.survey.sensor, str
    )
    return "sensor" if from_preset else "given"


def _shots(span_s: Sequence[float], prf_hz: float | None) -> int | None:
    """Shots from the first to the last that returned anything [count]."""
    return None if prf_hz is None else round((span_s[1] - span_s[0]) * prf_hz) + 1


def _counts(done: Receipts, context: Context, facts: RunFacts) -> Counts:
    index = [r.facts for r in done["index_file"].values()]
    tiles = [r.facts for r in done.get("build_tile", {}).values()]
    delivered = [r.facts for r in done.get("deliver_file", {}).values()]
    noise = {k: sum(f["noise_class"].get(k, 0) for f in delivered) for k in ("0", "1", "2", "255")}
    classes = {k: sum(f["assessed"].get(k, 0) for f in delivered) for k in ("2", "6", "9")}
    if context.workflow.outputs.classes == "noise":  # class 2 is the input's there
        classes["2"] = sum(r.facts["ground"] for r in done.get("ground", {}).values())
    points_out = sum(f["points"] for f in delivered)
    cut = None
    if context.workflow.outputs.client_tiles is not None:
        cut = [r.points for r in done.get("deliver_client_tile", {}).values()]
    return Counts(
        points_in=sum(f["points"] for f in index),
        points_out=points_out,
        signal=noise["0"],
        background=noise["1"],
        afterpulse=noise["2"],
        not_assessed=noise["255"],
        ground=classes["2"],
        building=classes["6"],
        water=classes["9"],
        withheld=sum(f["withheld"] for f in index),
        vendor_flagged=sum(f["vendor_noise"] for f in index),
        no_beam=(sum(f["no_beam"] for f in tiles) + sum(f["timeless"] for f in index))
        * context.workflow.filtering,
        outside_aoi=sum(f["outside_aoi"] for f in tiles),
        copies=sum(n for f in tiles for *_, n in f["copies"]),
        not_read=facts.not_read,
        records_left_out=sum(f["records_left_out"] for f in delivered),
        classes=_total((f["written"] for f in delivered), key=int),
        dropped=_total(f["dropped"] for f in delivered if "dropped" in f),
        in_no_client_tile=None if cut is None else points_out - sum(cut),
    )


def _total(counts: Iterable[Mapping[str, int]], key: Callable[[str], Any] = str) -> dict[str, int]:
    """Counts by name together, in the order of the names."""
    total: Counter[str] = Counter()
    for one in counts:
        total.update(one)
    return {name: total[name] for name in sorted(total, key=key)}


def _header_changes(done: Receipts) -> dict[str, int]:
    """Delivered clouds whose header has something in another way, by what that is."""
    changes = (r.facts["header_changes"] for r in done.get("deliver_file", {}).values())
    return dict(sorted(Counter(chain.from_iterable(changes)).items()))


def _noise(done: Receipts, context: Context, removed: int) -> Noise:
    settings = context.workflow.filter
    mean, low, high = _noise_levels(done, context)
    return Noise(
        method=settings.method,
        test=settings.test if settings.method == "vsaes" else None,
        alpha=settings.alpha if settings.method == "vsaes" else None,
        mean_per_m3=mean,
        p05_per_m3=low,
        p95_per_m3=high,
        kept_by_chance=_kept_by_chance(settings, removed),
        fit=_noise_fit(done),
        dsm_support=context.workflow.products.dsm_support,
    )


def _noise_levels(
    done: Receipts, context: Context
) -> tuple[float, float, float] | tuple[None, None, None]:
    """Mean, 5th and 95th percentile of the expected noise [1/m3]."""
    part = _overview(context.store.local / "noise.tif") if done.get("mosaic") else None
    values = np.empty(0) if part is None else part.values[part.values > NODATA]
    if not len(values):
        return None, None, None
    low, high = np.quantile(values, (0.05, 0.95), method="inverted_cdf").tolist()
    return float(values.mean(dtype=np.float64)), low, high


def _kept_by_chance(settings: FilterSettings, removed: int) -> float | None:
    """Background that a test at alpha is expected to have let through [count]."""
    if settings.method != "vsaes" or settings.test == "published":
        return None
    return removed * settings.alpha / (1 - settings.alpha)


def _noise_fit(done: Receipts) -> NoiseFit | None:
    """How p-values lie below all surfaces; None where none were counted."""
    counts = p_values(done.get("ground", {}).values())
    found = uniformity(counts)
    if found is None:
        return None
    return NoiseFit(returns_below=int(counts.sum()), p_value_times=found[0], p_value=found[1])


def _unfiltered(counts: Counts, context: Context) -> list[Finding]:
    """That most of a survey was not filtered, if so."""
    if not mostly_unfiltered(counts, context.workflow.filter.method):
        return []
    return [Finding("N06", {"share": counts.no_beam / counts.points_in})]


def _provenance(done: Receipts, context: Context, reference: Iterable[str]) -> Provenance:
    inputs = [
        InputFile(
            path=r.facts["name"],
            size=r.facts["size"],
            hash=f"blake2b:{r.facts['hash']}",
            points=r.facts["points"],
        )
        for r in done["index_file"].values()
    ]
    for receipt in done.get("trajectory", {}).values():
        inputs.extend(
            input_file(Path(item["path"]), "trajectory", item["hash"])
            for item in receipt.facts["inputs"]
        )
    settings = context.workflow.reference
    checkpoints = settings.checkpoints if settings else None
    own = None if checkpoints is None else str(context.resolve(checkpoints))
    inputs.extend(
        input_file(Path(path), "checkpoints" if path == own else "reference") for path in reference
    )
    files = {role: getattr(context.workflow, role) for role in ("aoi", "water", "breaklines")}
    inputs += [input_file(context.resolve(n), role) for role, n in files.items() if n is not None]
    tiles = context.workflow.outputs.client_tiles
    if tiles is not None:
        inputs.append(input_file(context.resolve(tiles.polygons), "client_tiles"))
    geoid = context.workflow.outputs.geoid
    grid = None if geoid is None else grid_file(geoid.grid, context.resolve(geoid.grid))
    if grid is not None:
        inputs.append(input_file(grid, "geoid"))
    return provenance(context, inputs)


def _parts(done: Receipts, context: Context, found: Comparison | None) -> dict[str, RasterPart]:
    """Rasters that pictures are drawn from, by the names of these."""
    parts = {name: _overview(context.output / f"{name}.tif") for name in OF_PRODUCTS}
    parts["noise_density"] = _overview(context.store.local / "noise.tif")
    parts["difference"] = None if found is None else found.difference
    parts["strips"] = difference_map(context) if done.get("strip_pairs") else None
    return {name: part for name, part in parts.items() if part is not None}


def _overview(path: Path) -> RasterPart | None:
    return read_overview(path) if path.exists() else None
