"""Stage ``report``: what all receipts have together, as a page with its pictures."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.engine.report import number_format as text
from spl_batch.engine.report import style
from spl_batch.engine.report.maps import WIDTH_IN as MAP_WIDTH_IN
from spl_batch.engine.report.maps import Raster, draw_ramp, spread
from spl_batch.engine.report.number_format import metres, number
from spl_batch.engine.report.page import Front, render_page, write_both
from spl_batch.engine.report.picture import Picture
from spl_batch.engine.report.run_record import (
    Receipts,
    RunFacts,
    common_parts,
    indexed_file,
    remember,
)
from spl_batch.engine.report.verdict import Verdict, ending_rows, failure_verdict
from spl_batch.engine.tasks.task import Receipt
from spl_batch.formats.rasters.parts import read_overview
from spl_batch.formats.verified.parquet_npz import read_arrays
from spl_batch.geiger.water.accuracy import pixel_maps
from spl_batch.geiger.water.report.model import (
    FloorErrors,
    SurfaceError,
    SurfaceErrors,
    WaterCalibration,
    WaterFile,
    WaterReport,
)
from spl_batch.geiger.water.tasks.surfaces import WaterContext


def render(report: WaterReport, pictures: Mapping[str, Picture]) -> str:
    """The page.

    ``pictures``: from :mod:`~spl_batch.geiger.water.report.summarise`; any may be missing.
    """
    sections = (("accuracy", "Accuracy"), ("surface", "Surface"), ("calibration", "Calibration"))
    return render_page(
        "water.html.j2",
        report,
        Front(
            title=report.name,
            kicker="Water surface from a Geiger-mode array",
            facts=tuple(_facts(report)),
            sections=sections,
            verdicts=(
                _accuracy_verdict(report),
                failure_verdict(report.failures, report.findings),
            ),
            cards=tuple(_cards(report)),
        ),
        package=__package__,
        pictures=pictures,
    )


def _surfaces(report: WaterReport) -> int:
    return sum(file.acquisitions for file in report.files)


def _facts(report: WaterReport) -> Iterator[str]:
    water = [file for file in report.files if file.role == "water"]
    yield f"{len(water)} file{'s' * (len(water) != 1)} of frames"
    frames = text.number(report.frames_per_acquisition)
    yield f"{text.number(_surfaces(report))} acquisitions of {frames} frames"
    yield report.crs or "no CRS"


def _cards(report: WaterReport) -> Iterator[tuple[str, str, str]]:
    yield "Surfaces", text.number(_surfaces(report)), f"{text.large(report.points)} points"
    if report.surfaces is not None:
        made = report.surfaces
        spread = None if made.variance_m2 is None else made.variance_m2**0.5
        yield (
            "Normals",
            f"{text.significant(made.pixel_normal_deg)}°",
            f"{text.significant(made.normal_deg)}° of the mean normal",
        )
        yield (
            "Height",
            text.millimetres(spread),
            f"spread; bias {text.millimetres(made.signed_bias_m)} down",
        )
    if report.floor is not None:
        yield (
            "Sea floor",
            text.millimetres(report.floor.refracted_beam_m),
            f"{text.millimetres(report.floor.level_beam_m)} under a level surface",
        )
    if report.calibration is not None:
        dead = report.calibration.dead
        yield "Dead pixels", text.number(dead), f"of {text.number(report.calibration.used)} in use"


def _accuracy_verdict(report: WaterReport) -> Verdict:
    made = report.surfaces
    if made is None or made.pixel_normal_deg is None:
        return Verdict("neutral", "No truth and no level surface were given: accuracy is unknown.")
    return Verdict(
        "good",
        f"Normals lie {text.significant(made.pixel_normal_deg)}° from the true ones, heights "
        f"{text.millimetres((made.mse_m2 or 0.0) ** 0.5)} (root mean square).",
    )


def screen_summary(report: WaterReport) -> list[tuple[str, str]]:
    """Label and value of each number that the console shows after a run."""
    rows = [
        ("surfaces", f"{text.number(_surfaces(report))}, {text.number(report.points)} points"),
    ]
    if report.calibration is not None:
        made = report.calibration
        rows.append(("calibration", "fitted" if made.fitted else "as given"))
        rows.append(("dead pixels", f"{text.number(made.dead)} of {text.number(made.used)} in use"))
    if report.surfaces is None:
        rows.append(("accuracy", "no truth"))
    else:
        found = report.surfaces
        rows.append(("normals", f"{text.significant(found.pixel_normal_deg)} deg"))
        rows.append(("bias", text.millimetres(found.signed_bias_m)))
    if report.floor is not None:
        rows.append(("sea floor", text.millimetres(report.floor.refracted_beam_m)))
    plain = [(label, text.as_ascii(value)) for label, value in rows]
    return plain + ending_rows(report.performance, report.failures, report.findings)


Floats = NDArray[np.float64]

PANELS = (
    ("bias_m", "bias [mm]", 1e3),
    ("variance_m2", "standard deviation [mm]", 1e3),
    ("mse_m2", "root mean square error [mm]", 1e3),
    ("normal_deg", "angle of the normal [deg]", 1.0),
)
"""Errors of a pixel: their names, and the factor to the unit in the name."""


def _height(raster: Raster | None) -> Picture:
    title = "Mean surface"
    if raster is None or not raster.any_value:
        return Picture(title, "No raster holds a value.")
    middle = float(np.nanmedian(raster.masked()))
    shown = Raster(1000 * (raster.masked() - middle), raster.extent_m)
    reach = max(float(np.abs(spread(shown.values, 1, 99)).max()), 1.0)
    drawn = draw_ramp(
        shown,
        title,
        "height above the median [mm]",
        ramp=style.DIFFERENCE,
        limits=(-reach, reach),
        extend="both",
    )
    return style.picture(
        drawn,
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
    return style.picture(
        drawn, title, f"Grey is the gate, bins {low} to {high - 1}: hits outside are not used."
    )


def _intensity(share: Floats) -> Picture:
    title = "Intensity"
    with style.type_context():
        drawn = style.figure(MAP_WIDTH_IN, 4.2)
        axes = drawn.add_subplot()
        shown = axes.imshow(share, cmap=style.DENSITY, vmin=0.0, interpolation="nearest")
        drawn.colorbar(shown, ax=axes, label="share of frames with a hit [1/1]")
        axes.set(title=title, xlabel="column [pixel]", ylabel="row [pixel]")
    return style.picture(
        drawn, title, "Where the beam lies on the array, and which pixels are dead."
    )


def _pixels(maps: dict[str, Floats]) -> Picture:
    title = "Errors of each pixel"
    with style.type_context():
        drawn = style.figure(style.WIDTH_IN, 8.0)
        for axes, (key, label, factor) in zip(drawn.subplots(2, 2).flat, PANELS, strict=True):
            values = factor * (maps[key] if key in {"bias_m", "normal_deg"} else np.sqrt(maps[key]))
            top = float(np.nanpercentile(np.abs(values), 98)) if np.isfinite(values).any() else 1.0
            colours = {"cmap": style.SKY, "vmin": 0.0, "vmax": top}
            if key == "bias_m":
                colours |= {"cmap": style.DIFFERENCE, "vmin": -top}
            shown = axes.imshow(values, interpolation="nearest", **colours)
            drawn.colorbar(shown, ax=axes, label=label)
            axes.set(xlabel="column [pixel]", ylabel="row [pixel]")
    return style.picture(
        drawn,
        title,
        "Over all acquisitions. What follows the beam points to range walk, what follows nothing "
        "to the delays of pixels.",
    )


_ERRORS: Final = ("bias_m", "variance_m2", "mse_m2", "normal_deg", "pixel_normal_deg")
"""Columns of the errors that a task leaves; the number of pixels is the last one."""

_CALIBRATION: Final = ("scale", "offset_ns", "range_walk", "walk_ns", "walk_exponent", "pulse_ns")


def summarise(done: Receipts, context: WaterContext, facts: RunFacts) -> WaterReport:
    """Write ``report.json`` and ``report.html``."""
    workflow = context.workflow
    counted = sorted(done.get("count_frames", {}).items(), key=lambda item: item[1].facts["name"])
    each, floor, pixels = _errors(done, context, dict(counted))
    inputs = [indexed_file(r.facts, "frames", r.facts["frames"]) for _, r in counted]
    report = WaterReport(
        name=workflow.survey.name,
        crs=context.crs.to_string() if context.crs else None,
        method=workflow.surface.method,
        frames_per_acquisition=workflow.surface.frames_per_acquisition,
        files=tuple(_file(key, receipt, done) for key, receipt in counted),
        calibration=_calibration(done),
        points=sum(r.facts["points"] for r in done.get("deliver_points", {}).values()),
        surfaces=_mean(each),
        each_surface=tuple(each),
        floor=_floor_errors(floor, workflow.path.in_water_m),
        **common_parts(context, facts, sum(file.points or 0 for file in inputs), inputs),
    )
    water = [(key, r.facts) for key, r in counted if r.facts["role"] == "water"]
    pictures = _pictures(*water[0], done, context, pixels) if water else {}
    write_both(context.output, report, render(report, pictures))
    remember(done, context, facts)
    return report


def _file(key: str, counted: Receipt, done: Receipts) -> WaterFile:
    """A file that was counted; one without surfaces was recorded of a target, or failed."""
    made = [
        receipt.facts["acquisitions"]
        for name, receipt in done.get("make_surfaces", {}).items()
        if name.startswith(f"{key}/")
    ]
    keys = ("name", "role", "frames", "gate", "hits", "outside")
    return WaterFile(**{k: counted.facts[k] for k in keys}, acquisitions=sum(made))


def _calibration(done: Receipts) -> WaterCalibration | None:
    made = done.get("calibrate", {}).get("all")
    if made is None:
        return None
    rest = {k: made.facts[k] for k in ("fitted", "residual_ns", "dead", "used")}
    return WaterCalibration(**{k: made.facts["settings"][k] for k in _CALIBRATION}, **rest)


def _errors(
    done: Receipts, context: WaterContext, counted: Mapping[str, Receipt]
) -> tuple[list[SurfaceError], Floats, dict[str, Floats]]:
    """Errors of the surfaces in the order of files, of the ends of rays (a, 6), of the pixels."""
    each: list[SurfaceError] = []
    floors, sums = [np.empty((0, 6))], np.zeros(())
    made = done.get("make_surfaces", {})
    places = {name: name.partition("/") for name, receipt in made.items() if receipt.facts["truth"]}
    for key, receipt in counted.items():
        before = len(each)
        for name in sorted((n for n, p in places.items() if p[0] == key), key=_piece):
            kept = read_arrays(context.store.path("errors", f"{name}.npz"))
            floors.append(kept["floor"])
            sums = sums + kept["pixels"]
            for *row, pixels in kept["errors"].tolist():
                numbers = dict(zip(_ERRORS, row, strict=True))
                place = {"file": receipt.facts["name"], "acquisition": len(each) - before}
                each.append(SurfaceError(**place, **numbers, pixels=int(pixels)))
    return each, np.concatenate(floors), pixel_maps(sums) if sums.any() else {}


def _piece(name: str) -> int:
    return int(name.partition("/")[2])


def _mean(each: list[SurfaceError]) -> SurfaceErrors | None:
    known = [e for e in each if e.bias_m is not None and np.isfinite(e.bias_m)]
    if not known:
        return None
    rows = np.array([[getattr(e, k) for k in _ERRORS] for e in known], dtype=np.float64)
    mean = dict(zip(_ERRORS, rows.mean(axis=0).tolist(), strict=True))
    mean |= {"bias_m": float(np.abs(rows[:, 0]).mean()), "signed_bias_m": mean["bias_m"]}
    return SurfaceErrors(acquisitions=len(known), **mean)


def _floor_errors(floor: Floats, in_water_m: float) -> FloorErrors | None:
    known = floor[np.isfinite(floor[:, 0])]
    if not len(known):
        return None
    names = [k for k in FloorErrors.model_fields if k != "in_water_m"]
    means = dict(zip(names, known.mean(axis=0).tolist(), strict=True))
    return FloorErrors(in_water_m=in_water_m, **means)


def _pictures(
    key: str,
    facts: Mapping[str, Any],
    done: Receipts,
    context: WaterContext,
    pixels: dict[str, Floats],
) -> dict[str, Picture]:
    """What the first file of the water shows, and the errors of all."""
    sums = read_arrays(context.store.path("counts", f"{key}.npz"))
    delivered = done.get("deliver_rasters", {}).get(key)
    height = None
    if delivered is not None and delivered.outputs:
        part = read_overview(context.output / f"surfaces/{delivered.facts['delivered']}.tif")
        height = Raster(part.values, part.extent_m)
    made = {
        "height": _height(height),
        "intensity": _intensity(sums["hits"] / facts["frames"]),
        "histogram": _histogram(sums["histogram"], facts["gate"]),
    }
    return made | ({"pixels": _pixels(pixels)} if pixels else {})
