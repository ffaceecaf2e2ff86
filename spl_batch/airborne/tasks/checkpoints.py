"""Heights of the terrain model at the checkpoints of a field survey."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from pyproj import CRS

from spl_batch.airborne.accuracy.raster_and_reference import Raster
from spl_batch.airborne.context import Context
from spl_batch.airborne.settings import ReferenceSettings
from spl_batch.engine.findings import Finding
from spl_batch.engine.tasks.context import Produced
from spl_batch.formats.checkpoints import Checkpoint, read_checkpoints
from spl_batch.formats.crs import parse_crs


def checkpoints(args: Mapping[str, Any], context: Context) -> Produced:
    """Compare the terrain with checkpoints."""
    # What is wrong with single ones was told before the work began.
    known, _, _ = read_named(Path(args["path"]), context.crs, context.workflow.reference)
    found = [_record(point, _terrain_m(point, context)) for point in known]
    beyond = [one["id"] for one in found if one["error_m"] is None]
    lost = Finding("C01", {"kind": "beyond", "count": len(beyond), "names": beyond})
    facts = {
        "name": args["name"],
        "checkpoints": found,
        "findings": [lost] if beyond else [],
    }
    return Produced([], facts, len(known))


def read_named(
    path: Path, crs: CRS | None, settings: ReferenceSettings | None
) -> tuple[list[Checkpoint], list[str], list[str]]:
    """Checkpoints of a file as a workflow has them, what is wrong with some, units of heights.

    Raises InputError if the file as a whole cannot be used.
    """
    stated = settings.checkpoints_crs if settings else None
    own = None if stated is None else parse_crs(stated, "reference.checkpoints_crs")
    return read_checkpoints(path, crs, own, settings.checkpoints_accuracy_m if settings else None)


def _terrain_m(point: Checkpoint, context: Context) -> float | None:
    """Height of the terrain, bilinear between cell centres; None where there is none [m]."""
    place = np.array([(point.x_m, point.y_m)])
    terrain = Raster.around(context.output / "dtm.tif", place)
    if terrain is None:
        return None
    height = float(terrain.bilinear(place)[0])
    return height if np.isfinite(height) else None


def _record(point: Checkpoint, terrain_m: float | None) -> dict[str, Any]:
    return {**asdict(point), "error_m": None if terrain_m is None else terrain_m - point.z_m}


def results(receipts: Mapping[str, Any]) -> Sequence[Mapping[str, Any]]:
    """What the task has found, by its receipts; nothing where it has not run."""
    return [one for receipt in receipts.values() for one in receipt.facts["checkpoints"]]
