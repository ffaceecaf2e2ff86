"""Stage ``report``: what all receipts say together, with its pictures."""

from collections.abc import Iterator
from typing import Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.engine.report.maps import Raster
from spl_batch.engine.report.run_record import (
    Receipts,
    RunFacts,
    common_parts,
    indexed_file,
    remember,
)
from spl_batch.engine.report.write import write_both
from spl_batch.formats.rasters.parts import read_overview
from spl_batch.formats.verified.parquet_npz import read_arrays
from spl_batch.geiger.water.accuracy import PixelSums
from spl_batch.geiger.water.report.model import (
    FloorErrors,
    PixelErrors,
    SurfaceError,
    SurfaceErrors,
    WaterCalibration,
    WaterFile,
    WaterReport,
)
from spl_batch.geiger.water.report.page import render
from spl_batch.geiger.water.report.pictures import WaterPictures, make_pictures
from spl_batch.geiger.water.tasks.surfaces import WaterContext

Floats = NDArray[np.float64]

_ERROR_FIELDS: Final = ("bias_m", "variance_m2", "mse_m2", "normal_deg", "pixel_normal_deg")
"""Columns of the errors that a task leaves; the number of pixels is the last one."""


def summarise(done: Receipts, context: WaterContext, facts: RunFacts) -> WaterReport:
    """Write ``report.json`` and ``report.html``."""
    workflow = context.workflow
    errors, floor, pixels = _errors(done, context)
    counted = done.get("count_frames", {}).values()
    inputs = [indexed_file(r.facts, "frames", r.facts["frames"]) for r in counted]
    report = WaterReport(
        name=workflow.survey.name,
        crs=context.crs.to_string() if context.crs else None,
        method=workflow.surface.method,
        frames_per_acquisition=workflow.surface.frames_per_acquisition,
        files=_files(done),
        calibration=_calibration(done),
        points=sum(r.facts["points"] for r in done.get("deliver_points", {}).values()),
        surfaces=_surface_errors(errors),
        each_surface=tuple(_each_surface(done, context)),
        pixels=PixelErrors(**{k: _rows(v) for k, v in pixels.items()}) if pixels else None,
        floor=_floor_errors(floor, workflow.path.in_water_m),
        **common_parts(context, facts, sum(file.points or 0 for file in inputs), inputs),
    )
    pictures = make_pictures(_pictures(done, context, pixels, report))
    write_both(context.output, report, render(report, pictures))
    remember(done, context, facts)
    return report


def _files(done: Receipts) -> tuple[WaterFile, ...]:
    """Each file that was counted; one without surfaces was recorded of a target, or failed."""
    surfaces: dict[str, int] = {}
    for name, receipt in done.get("make_surfaces", {}).items():
        key = name.split("/", maxsplit=1)[0]
        surfaces[key] = surfaces.get(key, 0) + receipt.facts["acquisitions"]
    return tuple(
        WaterFile(
            name=r.facts["name"],
            role=r.facts["role"],
            frames=r.facts["frames"],
            acquisitions=surfaces.get(key, 0),
            gate=tuple(r.facts["gate"]),
            hits=r.facts["hits"],
            outside=r.facts["outside"],
        )
        for key, r in sorted(
            done.get("count_frames", {}).items(), key=lambda item: str(item[1].facts["name"])
        )
    )


def _calibration(done: Receipts) -> WaterCalibration | None:
    made = done.get("calibrate", {}).get("all")
    if made is None:
        return None
    settings = made.facts["settings"]
    keys = ("scale", "offset_ns", "range_walk", "walk_ns", "walk_exponent", "pulse_ns")
    rest = ("fitted", "residual_ns", "dead", "used")
    return WaterCalibration(**{k: settings[k] for k in keys}, **{k: made.facts[k] for k in rest})


def _errors(done: Receipts, context: WaterContext) -> tuple[Floats, Floats, dict[str, Floats]]:
    """Errors of all surfaces (a, 6), of the ends of their rays (a, 6), maps of the pixels'."""
    rows, floors = [np.empty((0, 6))], [np.empty((0, 6))]
    camera = context.workflow.camera
    sums = PixelSums.empty((camera.rows, camera.cols))
    for name, receipt in sorted(done.get("make_surfaces", {}).items()):
        if receipt.facts["truth"]:
            made = read_arrays(context.store.path("errors", f"{name}.npz"))
            rows.append(made["errors"])
            floors.append(made["floor"])
            sums.merge(
                PixelSums(*(made[f"pixel_{k}"] for k in ("count", "error", "square", "angle")))
            )
    pixels = sums.maps() if sums.count.any() else {}
    return np.concatenate(rows), np.concatenate(floors), pixels


def _each_surface(done: Receipts, context: WaterContext) -> Iterator[SurfaceError]:
    """Errors of one surface after the other, in the order of the files' names."""
    counted = done.get("count_frames", {})
    names = [n for n, r in done.get("make_surfaces", {}).items() if r.facts["truth"]]

    def place(name: str) -> tuple[str, int]:
        key, _, piece = name.partition("/")
        return str(counted[key].facts["name"]), int(piece)

    acquisition, last = 0, ""
    for name in sorted(names, key=place):
        file, _ = place(name)
        acquisition, last = (acquisition, last) if file == last else (0, file)
        for row in read_arrays(context.store.path("errors", f"{name}.npz"))["errors"]:
            yield SurfaceError(
                file=file,
                acquisition=acquisition,
                **dict(zip(_ERROR_FIELDS, row[:5].tolist(), strict=True)),
                pixels=int(row[5]),
            )
            acquisition += 1


def _surface_errors(errors: Floats) -> SurfaceErrors | None:
    known = errors[np.isfinite(errors[:, 0])]
    if not len(known):
        return None
    mean = known.mean(axis=0)
    return SurfaceErrors(
        acquisitions=len(known),
        bias_m=float(np.abs(known[:, 0]).mean()),
        signed_bias_m=mean[0],
        variance_m2=mean[1],
        mse_m2=mean[2],
        normal_deg=mean[3],
        pixel_normal_deg=mean[4],
    )


def _floor_errors(floor: Floats, in_water_m: float) -> FloorErrors | None:
    known = floor[np.isfinite(floor[:, 0])]
    if not len(known):
        return None
    names = [k for k in FloorErrors.model_fields if k != "in_water_m"]
    means = dict(zip(names, known.mean(axis=0).tolist(), strict=True))
    return FloorErrors(in_water_m=in_water_m, **means)


def _rows(values: Floats) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(row) for row in values.tolist())


def _pictures(
    done: Receipts, context: WaterContext, pixels: dict[str, Floats], report: WaterReport
) -> WaterPictures:
    """What the first file of the water shows, and the errors of all."""
    each = [(e.bias_m, e.mse_m2, e.pixel_normal_deg) for e in report.each_surface]
    rows = np.array(each, dtype=np.float64).reshape(-1, 3)
    counted = done.get("count_frames", {})
    water = [key for key in counted if counted[key].facts["role"] == "water"]
    first = min(water, key=lambda key: str(counted[key].facts["name"]), default=None)
    if first is None:
        return WaterPictures(None, pixels, rows, None, (0, 0), None)
    facts = counted[first].facts
    sums = read_arrays(context.store.path("counts", f"{first}.npz"))
    delivered = done.get("deliver_rasters", {}).get(first)
    height = None
    if delivered is not None and delivered.outputs:
        name = f"surfaces/{delivered.facts['delivered']}.tif"
        part = read_overview(context.output / name)
        height = Raster(part.values, part.extent_m)
    low, high = facts["gate"]
    return WaterPictures(
        height, pixels, rows, sums["histogram"], (low, high), sums["hits"] / facts["frames"]
    )
