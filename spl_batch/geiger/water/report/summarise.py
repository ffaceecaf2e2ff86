"""Stage ``report``: what all receipts say together, with its pictures."""

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.engine.report.maps import Raster
from spl_batch.engine.report.page import write_both
from spl_batch.engine.report.picture import Picture
from spl_batch.engine.report.run_record import (
    Receipts,
    RunFacts,
    common_parts,
    indexed_file,
    remember,
)
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
from spl_batch.geiger.water.report.page import render
from spl_batch.geiger.water.report.pictures import make_pictures
from spl_batch.geiger.water.tasks.surfaces import WaterContext

Floats = NDArray[np.float64]

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
    low, high = facts["gate"]
    share = sums["hits"] / facts["frames"]
    return make_pictures(height, pixels, sums["histogram"], (low, high), share)
