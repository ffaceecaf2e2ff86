"""Stage ``deliver``: clouds and rasters once more in the CRS of ``outputs.crs``."""

from collections.abc import Mapping
from typing import Any

from spl_batch.airborne.context import Context
from spl_batch.engine.tasks.context import Produced
from spl_batch.errors import WorkflowError
from spl_batch.formats.reprojection import KEY, Reprojection


def _reprojection(context: Context) -> Reprojection:
    named = context.workflow.outputs.crs
    if named is None:  # a plan makes no such task
        raise WorkflowError(f"{KEY}: none is named")
    return Reprojection(context.crs, named)


def reproject_file(args: Mapping[str, Any], context: Context) -> Produced:
    """Write a delivered cloud there, every point once and in order."""
    target = context.output / args["target"]
    written = _reprojection(context).cloud(context.output / args["source"], target)
    return Produced([target], {"points": written}, written)


def reproject_raster(args: Mapping[str, Any], context: Context) -> Produced:
    """Write a delivered raster there."""
    outputs, moved = context.workflow.outputs, _reprojection(context)
    target = context.output / args["target"]
    moved.raster(
        context.output / args["source"],
        target,
        cell=outputs.cell or moved.in_units(context.workflow.products.cell_m),
        above_datum=args["above_datum"],
        meaning=args["meaning"],
        unit=args["unit"],
    )
    return Produced([target], {"name": target.name})
