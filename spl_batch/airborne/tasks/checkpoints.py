"""Heights of the terrain model at the checkpoints of a field survey."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from spl_batch.airborne.accuracy import Raster
from spl_batch.airborne.context import Context
from spl_batch.engine.tasks.context import Produced
from spl_batch.errors import Remark, grouped, named
from spl_batch.formats.checkpoints import Checkpoint, read_checkpoints
from spl_batch.formats.crs import parse_crs
from spl_batch.formats.rasters.parts import read_part, windows


def checkpoints(args: Mapping[str, Any], context: Context) -> Produced:
    """Compare the terrain of every piece of the survey with checkpoints."""
    settings = context.workflow.reference
    stated = settings.checkpoints_crs if settings else None
    own = None if stated is None else parse_crs(stated, "reference.checkpoints_crs")
    accuracy_m = settings.checkpoints_accuracy_m if settings else None
    path = Path(args["path"])
    known, remarks = read_checkpoints(path, context.crs, own, accuracy_m)
    found = [_record(point, _terrain_m(point, args["rasters"], context)) for point in known]
    beyond = [one["id"] for one in found if one["error_m"] is None]
    if known and len(beyond) == len(known):
        remarks.append(_all_beyond(known, context.output / f"{args['rasters'][0]}.tif"))
    elif beyond:
        noun = "checkpoint lies" if len(beyond) == 1 else "checkpoints lie"
        remarks.append(
            f"{len(beyond)} {noun} where the terrain model has no value, outside of the survey or "
            f"in a void, and {'counts' if len(beyond) == 1 else 'count'} for nothing: "
            f"{named(beyond)}"
        )
    facts = {
        "name": args["name"],
        "checkpoints": found,
        "warnings": [Remark(text) for text in remarks],
    }
    return Produced([], facts, len(known))


def _all_beyond(points: Sequence[Checkpoint], terrain: Path) -> str:
    """Where all checkpoints lie and where the terrain does: a wrong CRS shows at once."""
    with windows(terrain) as model:
        rows, columns = model.shape
        west_m, north_m = model.left_m, model.top_m
        survey = _box((west_m, west_m + columns * model.cell_m),
                      (north_m - rows * model.cell_m, north_m))  # fmt: skip
    mine = _box([point.x_m for point in points], [point.y_m for point in points])
    return (
        f"none of {len(points)} checkpoints lies on the terrain: they lie within {mine}, the "
        f"terrain within {survey}; name their CRS in reference.checkpoints_crs if it is another"
    )


def _box(x_m: Sequence[float], y_m: Sequence[float]) -> str:
    east, north = (f"{grouped(min(v))} to {grouped(max(v))}" for v in (x_m, y_m))
    return f"{east} E, {north} N"


def _terrain_m(point: Checkpoint, rasters: Iterable[str], context: Context) -> float | None:
    """Height of the terrain, bilinear between cell centres; None where no raster has one [m]."""
    place = (point.x_m, point.y_m)
    for name in rasters:
        part = read_part(context.output / f"{name}.tif", (*place, *place))
        if part is None:
            continue
        terrain = Raster(part.values, part.left_m, part.top_m, part.cell_m)
        height = float(terrain.bilinear(np.array([place]))[0])
        if np.isfinite(height):
            return height
    return None


def _record(point: Checkpoint, terrain_m: float | None) -> dict[str, Any]:
    return {
        "id": point.id,
        "x_m": point.x_m,
        "y_m": point.y_m,
        "z_m": point.z_m,
        "surface": point.surface,
        "accuracy_m": point.accuracy_m,
        "error_m": None if terrain_m is None else terrain_m - point.z_m,
    }


def results(receipts: Mapping[str, Any]) -> Sequence[Mapping[str, Any]]:
    """What the task has found, by its receipts; nothing where it has not run."""
    return [one for receipt in receipts.values() for one in receipt.facts["checkpoints"]]
