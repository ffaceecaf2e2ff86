"""Stage ``report``: what all receipts have together, as a page with its pictures."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from spl_batch.engine.report import number_format as text
from spl_batch.engine.report import run_record, style
from spl_batch.engine.report.maps import WIDTH_IN as MAP_WIDTH_IN
from spl_batch.engine.report.maps import Raster, draw_ramp, spread
from spl_batch.engine.report.number_format import metres, millimetres, number
from spl_batch.engine.report.page import Front, render_page, write_both
from spl_batch.engine.report.picture import Picture
from spl_batch.engine.report.run_record import Receipts, RunFacts
from spl_batch.engine.report.verdict import Verdict, failure_verdict
from spl_batch.engine.tasks.task import Receipt
from spl_batch.formats.rasters.parts import read_overview
from spl_batch.formats.verified.parquet_npz import read_arrays
from spl_batch.geiger.water import accuracy
from spl_batch.geiger.water.accuracy import pixel_maps
from spl_batch.geiger.water.pixel_geometry import Floats
from spl_batch.geiger.water.report import model
from spl_batch.geiger.water.report.model import SurfaceError, WaterReport
from spl_batch.geiger.water.tasks import WaterContext


def render(report: WaterReport, pictures: Mapping[str, Picture]) -> str:
    """The page; any picture may be missing."""
    water = [file for file in report.files if file.role == "water"]
    frames = number(report.frames_per_acquisition)
    front = Front(
        title=report.name,
        kicker="Water surface from a Geiger-mode array",
        facts=(
            f"{len(water)} file{'s' * (len(water) != 1)} of frames",
            f"{number(_surfaces(report))} acquisitions of {frames} frames",
            report.crs or "no CRS",
        ),
        sections=tuple((name.lower(), name) for name in ("Accuracy", "Surface", "Calibration")),
        verdicts=(_accuracy_verdict(report), failure_verdict(report.failures, report.findings)),
        cards=tuple(cards(report)),
    )
    return render_page("water.html.j2", report, front, package=__package__, pictures=pictures)


def _surfaces(report: WaterReport) -> int:
    return sum(file.acquisitions for file in report.files)


def cards(report: WaterReport) -> Iterator[tuple[str, str, str]]:
    """Label, value and remark of each key number."""
    made, floor, calibration = report.surfaces, report.floor, report.calibration
    yield "Surfaces", number(_surfaces(report)), f"{text.large(report.points)} points"
    if made is not None:
        mean = f"{text.significant(made.normal_deg)}° of the mean normal"
        yield "Normals", f"{text.significant(made.pixel_normal_deg)}°", mean
        bias = f"spread; bias {millimetres(made.signed_bias_m)} down"
        yield "Height", millimetres((made.variance_m2 or 0.0) ** 0.5), bias
    else:
        yield "Accuracy", "no truth", "nor a level surface: errors are unknown"
    if floor is not None:
        level = f"{millimetres(floor.level_beam_m)} under a level surface"
        yield "Sea floor", millimetres(floor.refracted_beam_m), level
    if calibration is not None:
        walk = f"range walk: {calibration.range_walk.replace('_', ' ')}"
        yield "Calibration", "fitted" if calibration.fitted else "as given", walk
        yield "Dead pixels", number(calibration.dead), f"of {number(calibration.used)} in use"


def _accuracy_verdict(report: WaterReport) -> Verdict:
    made = report.surfaces
    if made is None or made.pixel_normal_deg is None:
        return Verdict("neutral", "No truth and no level surface were given: accuracy is unknown.")
    return Verdict(
        "good",
        f"Normals lie {text.significant(made.pixel_normal_deg)}° from the true ones, heights "
        f"{millimetres((made.mse_m2 or 0.0) ** 0.5)} (root mean square).",
    )


def _height(raster: Raster | None) -> Picture:
    title = "Mean surface"
    if raster is None or not raster.any_value:
        return Picture(title, "No raster holds a value.")
    middle = float(np.nanmedian(raster.masked()))
    shown = Raster(1000 * (raster.masked() - middle), raster.extent_m)
    reach = max(float(np.abs(spread(shown.values, 1, 99)).max()), 1.0)
    label, limits = "height above the median [mm]", (-reach, reach)
    return style.picture(
        draw_ramp(shown, title, label, ramp=style.DIFFERENCE, limits=limits, extend="both"),
        title,
        f"Mean of the surfaces of the first file, above its median height of {metres(middle, 3)}. "
        "Calm water is even; a tilt or a bowl points to the boresight or to range walk.",
    )


def _histogram(counts: NDArray[np.int64], gate: Sequence[int]) -> Picture:
    title = "Time bins of the first file"
    low, high = gate
    first, last = max(low - 40, 1), min(high + 40, len(counts))
    with style.type_context():
        drawn = style.figure(style.WIDTH_IN, 3.0)
        axes = drawn.add_subplot()
        axes.bar(np.arange(first, last), counts[first:last], width=1.0, color=style.SIGNAL)
        axes.axvspan(low - 0.5, high - 0.5, color=style.RULE, zorder=0)
        axes.set(title=title, xlabel="time bin [number]", ylabel="hits [count]", xlim=(first, last))
        axes.yaxis.set_major_formatter(lambda hits, _: number(hits))
    caption = f"Grey is the gate, bins {low} to {high - 1}: hits outside are not used."
    return style.picture(drawn, title, caption)


def _intensity(share: Floats) -> Picture:
    title = "Intensity"
    with style.type_context():
        drawn = style.figure(MAP_WIDTH_IN, 4.2)
        axes = drawn.add_subplot(title=title)
        _array(axes, share, "share of frames with a hit [1/1]", cmap=style.DENSITY, vmin=0.0)
    caption = "Where the beam lies on the array, and which pixels are dead."
    return style.picture(drawn, title, caption)


def _pixels(maps: dict[str, Floats]) -> Picture:
    title = "Errors of each pixel"
    panels = {
        "bias [mm]": 1e3 * maps["bias_m"],
        "standard deviation [mm]": 1e3 * np.sqrt(maps["variance_m2"]),
        "root mean square error [mm]": 1e3 * np.sqrt(maps["mse_m2"]),
        "angle of the normal [deg]": maps["normal_deg"],
    }
    with style.type_context():
        drawn = style.figure(style.WIDTH_IN, 8.0)
        for axes, (label, values) in zip(drawn.subplots(2, 2).flat, panels.items(), strict=True):
            top = float(np.nanpercentile(np.abs(values), 98)) if np.isfinite(values).any() else 1.0
            signed = label.startswith("bias")
            colours = style.DIFFERENCE if signed else style.SKY
            _array(axes, values, label, cmap=colours, vmin=-top if signed else 0.0, vmax=top)
    return style.picture(
        drawn,
        title,
        "Over all acquisitions. What follows the beam points to range walk, what follows nothing "
        "to the delays of pixels.",
    )


def _array(axes: Any, values: Floats, label: str, **colours: Any) -> None:
    """Draw a value of each pixel."""
    shown = axes.imshow(values, interpolation="nearest", **colours)
    axes.figure.colorbar(shown, ax=axes, label=label)
    axes.set(xlabel="column [pixel]", ylabel="row [pixel]")


def summarise(done: Receipts, context: WaterContext, facts: RunFacts) -> WaterReport:
    """Write ``report.json`` and ``report.html``."""
    workflow = context.workflow
    counted = sorted(done.get("count_frames", {}).items(), key=lambda item: item[1].facts["name"])
    each, floor, pixels = _errors(done, context, dict(counted))
    inputs = [run_record.indexed_file(r.facts, "frames", r.facts["frames"]) for _, r in counted]
    report = WaterReport(
        name=workflow.survey.name,
        crs=context.crs.to_string() if context.crs else None,
        method=workflow.surface.method,
        frames_per_acquisition=workflow.surface.frames_per_acquisition,
        files=tuple(_file(key, receipt, done) for key, receipt in counted),
        calibration=_calibration(done),
        points=sum(r.facts["points"] for r in done.get("deliver_file", {}).values()),
        surfaces=_mean(each),
        each_surface=tuple(each),
        floor=_floor_errors(floor, workflow.path.in_water_m),
        **run_record.common_parts(context, facts, sum(file.points or 0 for file in inputs), inputs),
    )
    water = [(key, r.facts) for key, r in counted if r.facts["role"] == "water"]
    pictures = _pictures(*water[0], done, context) if water else {}
    if pixels.any():
        pictures["pixels"] = _pixels(pixel_maps(pixels))
    write_both(context.output, report, render(report, pictures))
    return report


def _file(key: str, counted: Receipt, done: Receipts) -> model.WaterFile:
    """A file that was counted; one without surfaces was recorded of a target, or failed."""
    made = done.get("make_surfaces", {}).items()
    surfaces = sum(r.facts["acquisitions"] for name, r in made if name.startswith(f"{key}/"))
    known = {**counted.facts, "acquisitions": surfaces}
    return model.WaterFile(**{k: known[k] for k in model.WaterFile.model_fields})


def _calibration(done: Receipts) -> model.WaterCalibration | None:
    made = done.get("calibrate", {}).get("all")
    if made is None:
        return None
    known = {**made.facts["settings"], **made.facts}
    return model.WaterCalibration(**{k: known[k] for k in model.WaterCalibration.model_fields})


def _errors(
    done: Receipts, context: WaterContext, counted: Mapping[str, Receipt]
) -> tuple[list[SurfaceError], Floats, Floats]:
    """Errors of the surfaces in the order of files, of the ends of rays (a, 6), of the pixels."""
    each: list[SurfaceError] = []
    floors, sums = [np.empty((0, len(accuracy.FloorError._fields)))], np.zeros(())
    pieces = [
        (counted[name.partition("/")[0]].facts["name"], name)
        for name, receipt in done.get("make_surfaces", {}).items()
        if receipt.facts["truth"]
    ]
    seen = Counter[str]()
    for file, name in sorted(pieces):
        kept = read_arrays(context.store.path("errors", f"{name}.npz"))
        floors.append(kept["floor"])
        sums = sums + kept["pixels"]
        for row in kept["errors"].tolist():
            numbers = accuracy.SurfaceError(*row)._asdict()
            each.append(SurfaceError(file=file, acquisition=seen[file], **numbers))
            seen[file] += 1
    return each, np.concatenate(floors), sums


def _mean(each: list[SurfaceError]) -> model.SurfaceErrors | None:
    known = [e for e in each if e.bias_m is not None and np.isfinite(e.bias_m)]
    if not known:
        return None
    names = accuracy.SurfaceError._fields[:-1]
    rows = np.array([[getattr(e, k) for k in names] for e in known], dtype=np.float64)
    mean = dict(zip(names, rows.mean(axis=0).tolist(), strict=True))
    mean |= {"bias_m": float(np.abs(rows[:, 0]).mean()), "signed_bias_m": mean["bias_m"]}
    return model.SurfaceErrors(acquisitions=len(known), **mean)


def _floor_errors(floor: Floats, in_water_m: float) -> model.FloorErrors | None:
    known = floor[np.isfinite(floor[:, 0])]
    if not len(known):
        return None
    means = accuracy.FloorError(*known.mean(axis=0).tolist())
    return model.FloorErrors(in_water_m=in_water_m, **means._asdict())


def _pictures(
    key: str, facts: Mapping[str, Any], done: Receipts, context: WaterContext
) -> dict[str, Picture]:
    """What the first file of the water shows."""
    sums = read_arrays(context.store.path("counts", f"{key}.npz"))
    delivered = done.get("deliver_file", {}).get(key)
    height = None
    # Where no point is known the table of points is delivered alone, without rows.
    if delivered is not None and delivered.points:
        part = read_overview(context.output / f"surfaces/{delivered.facts['delivered']}.tif")
        height = Raster(part.values, part.extent_m)
    return {
        "height": _height(height),
        "intensity": _intensity(sums["hits"] / facts["frames"]),
        "histogram": _histogram(sums["histogram"], facts["gate"]),
    }
