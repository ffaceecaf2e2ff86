"""What a client asks for: tiles by polygons, contours, clouds and rasters in another CRS."""

from collections.abc import Iterator, Mapping
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray
from rasterio.transform import Affine
from rasterio.windows import Window

from spl_batch.airborne.catalogue import CLIENT_TILES, CONTOURS
from spl_batch.airborne.catalogue.catalogues import Layer, in_units, write_layers
from spl_batch.airborne.context import Context, reprojection
from spl_batch.airborne.store.flown_lines import read_shifts
from spl_batch.airborne.tasks.index import BOXES, CHUNK_POINTS
from spl_batch.constants import NODATA, QUANTA_PER_M
from spl_batch.engine.store.working_store import read_receipt
from spl_batch.engine.tasks.context import Produced
from spl_batch.errors import WorkflowError
from spl_batch.formats.files.atomic import replacing, scratch_folder
from spl_batch.formats.las.copc import copy_as_copc
from spl_batch.formats.las.cut import Piece, write_cut
from spl_batch.formats.named_areas import lies_in
from spl_batch.formats.rasters import parts
from spl_batch.formats.rasters.geotiff import write_cog
from spl_batch.formats.reprojection import KEY, Reprojection
from spl_batch.formats.verified.parquet_npz import read_arrays


def deliver_client_tile(args: Mapping[str, Any], context: Context) -> Produced:
    """Cut a tile out of delivered clouds and rasters; what has nothing there is left out."""
    name, area = args["name"], in_units(shapely.from_wkb(args["area"]), context.units)
    if args["in_another_unit"]:
        area = _reprojection(context).shape(area)
    shapely.prepare(area)
    folder, outputs = context.output / CLIENT_TILES, []
    settings = context.workflow.outputs.client_tiles
    copc = settings is not None and settings.format == "copc"
    target = folder / f"{name}{'.copc' if copc else ''}.laz"
    points = _cut_cloud(args, area, target, context, copc=copc)
    if points:
        outputs.append(target)
    for href in args["rasters"]:
        source = context.output / href
        cut = folder / f"{name}_{source.name}"
        if _cut_raster(source, cut, area):
            outputs.append(cut)
    return Produced(outputs, {"name": name, "points": points}, points)


def _cut_cloud(
    args: Mapping[str, Any], area: shapely.Geometry, target: Path, context: Context, *, copc: bool
) -> int:
    """Points of a tile, written where there are any [count]."""
    clouds, near = context.output / args["clouds"], shapely.from_wkb(args["area"])
    pieces = [
        Piece(clouds / name, ranges)
        for source, name in args["sources"]
        if (ranges := _ranges(source, near, context))
    ]
    if not pieces:
        return 0
    shifts = read_shifts(args, context.store)
    record = None if shifts is None else shifts.record()
    with scratch_folder(target) as folder:
        whole = folder / "whole.laz"
        points = write_cut(
            whole,
            pieces,
            partial(lies_in, area),
            records_of_file=[] if record is None else [record],
        )
        if points and copc:
            copy_as_copc(whole, target)
        elif points:
            with replacing(target) as temporary:
                whole.replace(temporary)
    return points


def _ranges(source: str, area: shapely.Geometry, context: Context) -> list[tuple[int, int]]:
    """Records of a delivered file that may lie in an area [m], by the boxes of its chunks."""
    boxes = read_arrays(context.store.path("index", f"{source}.npz"))[BOXES]
    receipt = read_receipt(context.store, "deliver_file", source)
    facts = {} if receipt is None else receipt.facts
    points = 0 if receipt is None else receipt.points
    starts = np.minimum(np.arange(len(boxes) + 1) * CHUNK_POINTS, points)
    if "kept" in facts:
        starts = np.concatenate([[0], np.cumsum(facts["kept"])])
    # Boxes are of places that were rounded to whole quanta.
    west, south, east, north = np.array(shapely.bounds(area)) * QUANTA_PER_M + [-1, -1, 1, 1]
    near = (boxes[:, 0] <= east) & (boxes[:, 2] >= west)
    near &= (boxes[:, 1] <= north) & (boxes[:, 3] >= south) & (np.diff(starts) > 0)
    return [(int(starts[k]), int(starts[k + 1])) for k in np.flatnonzero(near).tolist()]


def _cut_raster(source: Path, target: Path, area: shapely.Geometry) -> bool:
    """Cells of a raster whose centres lie in an area, in its unit; whether there are any."""
    with parts.opened(source) as model:
        place, (rows, columns) = model.transform, model.shape
        left, top, cell = place.c, place.f, place.a
        west, south, east, north = shapely.bounds(area).tolist()
        across = parts.cells_between((west - left) / cell, (east - left) / cell)
        down = parts.cells_between((top - north) / cell, (top - south) / cell)
        (first_col, last_col), (first_row, last_row) = (
            (max(first, 0), min(past, held))
            for (first, past), held in ((across, columns), (down, rows))
        )
        if first_col >= last_col or first_row >= last_row:
            return False
        whole = Window(first_col, first_row, last_col - first_col, last_row - first_row)

        def blocks() -> Iterator[tuple[int, int, NDArray[Any]]]:
            """Those that hold anything."""
            for window in parts.windows(whole, parts.BLOCK):
                values = model.read(1, window=window)
                x, y = parts.centres((left, top), cell, window)
                inside = lies_in(area, x.ravel(), y.ravel())
                kept = np.where(inside.reshape(values.shape), values, np.float32(NODATA))
                if (kept != NODATA).any():
                    yield window.row_off - first_row, window.col_off - first_col, kept

        some = blocks()
        first = next(some, None)
        if first is None:
            return False
        write_cog(
            target,
            chain([first], some),
            shape=(whole.height, whole.width),
            place=place * Affine.translation(first_col, first_row),
            crs=model.crs.to_wkt() if model.crs else None,
            description=model.descriptions[0] or source.name,
            unit=model.units[0] or "",
        )
    return True


def deliver_contours(args: Mapping[str, Any], context: Context) -> Produced:
    """Lines of equal height of the terrain; voids interrupt them."""
    from contourpy import contour_generator  # noqa: PLC0415 - few ask for contours

    interval = args["interval"]
    pieces: dict[int, list[shapely.Geometry]] = {}
    with parts.opened(context.output / "dtm.tif") as model:
        place, whole, crs = model.transform, Window(0, 0, model.width, model.height), model.crs
        # Blocks share the cells along their edges: their lines end at the same places.
        for window in parts.windows(whole, parts.BLOCK, beyond=1):
            values = model.read(1, window=window, masked=True)
            if min(values.shape) < 2 or not values.count():
                continue
            x, y = parts.centres((place.c, place.f), place.a, window)
            lines = contour_generator(x, y, values.astype(np.float64))
            low, high = float(values.min()) / interval, float(values.max()) / interval
            for k in range(int(np.ceil(low)), int(np.floor(high)) + 1):
                found = lines.lines(k * interval)
                pieces.setdefault(k, []).extend(map(shapely.linestrings, found))
    joined = {k: shapely.line_merge(shapely.multilinestrings(pieces[k])) for k in sorted(pieces)}
    single = [(k * interval, one) for k in joined for one in shapely.get_parts(joined[k])]
    if not single:
        return Produced((), {"name": CONTOURS, "lines": 0})
    layer = Layer(
        "contours", [one for _, one in single], {"height": [height for height, _ in single]}
    )
    path = write_layers(context.output / CONTOURS, [layer], crs.to_wkt() if crs else None)
    return Produced([path], {"name": CONTOURS, "lines": len(single)})


def _reprojection(context: Context) -> Reprojection:
    found = reprojection(context.workflow.outputs, context.crs)
    if found is None:  # a plan makes no such task
        raise WorkflowError(f"{KEY}: none is named")
    return found


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
