"""Tasks of the water surface: count frames, calibrate, make surfaces, deliver points and rasters.

Cells of rasters lie on whole multiples of their edge. They count from where easting and northing
are 0, wherever the local frame begins: cells of acquisitions from several sites fit onto each
other. Rows count from the south, as in :mod:`spl_batch.numerics.triangulation.tin_raster`.

Deviation: the source's raster is the array itself, whose pixels lie unevenly on the water. Here
cells are equal, and take their depth from the triangles between pixels.
"""

import math
from collections.abc import Iterator, Mapping
from functools import reduce
from operator import add
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.constants import NODATA
from spl_batch.engine.tasks.context import Produced, RunContext
from spl_batch.engine.tasks.input_changes import unchanged
from spl_batch.errors import InputError
from spl_batch.formats.files.atomic import checksum
from spl_batch.formats.rasters.geotiff import write_cog
from spl_batch.formats.verified.parquet_npz import read_arrays, write_arrays, writing
from spl_batch.geiger.water import accuracy, ranges
from spl_batch.geiger.water.formats import FrameTruth, inspect_frames, iter_frames, read_truth
from spl_batch.geiger.water.pixel_geometry import Floats, View, floor_points, refracted, view_of
from spl_batch.geiger.water.settings import CalibrationSettings, Vector, WaterWorkflow
from spl_batch.geiger.water.surface import Surface, make_surface
from spl_batch.numerics.triangulation.tin_raster import tin_raster

WaterContext = RunContext[WaterWorkflow]
Arrays = dict[str, NDArray[Any]]


def count_frames(args: Mapping[str, Any], context: WaterContext) -> Produced:
    """Read a file once from end to end: its histogram, its gate, what its pixels add up to."""
    workflow, path, frames = context.workflow, Path(args["path"]), int(args["frames"])
    camera, used = workflow.camera, ranges.used_pixels(workflow.camera)
    with unchanged(path, args["stamp"]):
        digest = checksum(path)
        inspect_frames(path, camera.rows, camera.cols)
        counts = np.zeros(camera.bins + 1, dtype=np.int64)
        for _, piece in iter_frames(path, 0, frames, camera.bins):
            counts += ranges.histogram(piece, used, camera.bins)
        # A target has a distance of its own: its gate is where its peak is.
        given = {"centre_bin": None} if args["role"] == "target" else {}
        gate = ranges.find_gate(counts, workflow.gate.model_copy(update=given))
        if gate is None:
            raise InputError(str(path), "no pixel has a hit in any frame; leave the file out")
        (whole,) = _add_up(path, (0, frames), frames, gate, camera.bins)
    out = context.store.path("counts", f"{args['source']}.npz")
    write_arrays(out, {"histogram": counts, **{k: getattr(whole, k) for k in ranges.SUMS}})
    facts = {
        "name": args["name"],
        "role": args["role"],
        "path": str(path),
        "hash": digest,
        "size": args["stamp"][0],
        "frames": frames,
        "gate": [gate.low, gate.high],
        "hits": int(whole.hits.sum()),
        "outside": int(whole.outside[used].sum()),
    }
    return Produced([out], facts, frames, {str(path): args["stamp"]})


def _add_up(
    path: Path, frames: tuple[int, int], per: int, gate: ranges.Gate, bins: int
) -> Iterator[ranges.Hits]:
    """What each acquisition of ``per`` frames adds up to; their number is a multiple of it."""
    parts: list[ranges.Hits] = []
    for start, piece in iter_frames(path, *frames, bins):
        first = start
        while first < start + len(piece):
            last = min((first // per + 1) * per, start + len(piece))
            parts.append(ranges.add_up(piece[first - start : last - start], gate))
            if last % per == 0:
                yield reduce(add, parts)
                parts = []
            first = last


def calibrate(args: Mapping[str, Any], context: WaterContext) -> Produced:
    """Find dead pixels, and fit the laws from frames of targets where there are some."""
    workflow, camera = context.workflow, context.workflow.camera
    used, counted = ranges.used_pixels(camera), []
    for source in args["sources"]:
        sums = read_arrays(context.store.path("counts", f"{source['source']}.npz"))
        gate, parts = ranges.Gate(*source["gate"]), [sums[k] for k in ranges.SUMS]
        counted.append(ranges.Hits(source["frames"], gate, *parts))
    dead = ranges.dead_pixels(reduce(add, counted), used, workflow.pixels)
    made = ranges.Calibration(workflow.calibration, np.zeros(used.shape))
    if args["distances_m"]:
        norm = view_of(camera, workflow.mount).norm
        seen = [
            ranges.observation(hits, dead, norm, distance, camera.bin_ns)
            for hits, distance in zip(counted, args["distances_m"], strict=True)
        ]
        if faults := ranges.faults_of(seen, workflow.calibration):
            raise InputError("calibration", faults)
        made = ranges.fit(seen, workflow.calibration)
    out = context.store.path("calibration.npz")
    write_arrays(out, {"pixel_ns": made.pixel_ns, "dead": dead})
    facts = {
        "settings": made.settings.model_dump(mode="json", exclude={"frames"}),
        "residual_ns": made.residual_ns,
        "dead": int((dead & used).sum()),
        "used": int(used.sum()),
        "fitted": bool(args["distances_m"]),
    }
    return Produced([out], facts)


def make_surfaces(args: Mapping[str, Any], context: WaterContext) -> Produced:
    """Surfaces of some acquisitions of a file, and their errors where truth is known."""
    workflow, path = context.workflow, Path(args["path"])
    camera, view = workflow.camera, view_of(workflow.camera, workflow.mount)
    fitted = read_arrays(context.store.path("calibration.npz"))
    settings = CalibrationSettings.model_validate(args["calibration"])
    calibration = ranges.Calibration(settings, fitted["pixel_ns"], args["residual_ns"])
    way = calibration, view, camera, workflow.pixels, workflow.surface
    gate, per = ranges.Gate(*args["gate"]), workflow.surface.frames_per_acquisition
    first, last = args["acquisitions"]
    with unchanged(path, args["stamp"]):
        added = _add_up(path, (first * per, last * per), per, gate, camera.bins)
        surfaces = [make_surface(hits, fitted["dead"], *way) for hits in added]
        truth = _truth(args, workflow, view, path)
    outputs = [context.store.path("surfaces", f"{args['name']}.npz")]
    arrays = {name: np.stack([getattr(s, name) for s in surfaces]) for name in Surface.__slots__}
    write_arrays(outputs[0], arrays | {"normals": arrays["normals"].astype(np.float32)})
    if truth is not None:
        outputs.append(context.store.path("errors", f"{args['name']}.npz"))
        write_arrays(outputs[1], _errors(surfaces, truth, view, workflow))
    facts = {"acquisitions": last - first, "truth": truth is not None}
    return Produced(outputs, facts, (last - first) * per)


def _truth(
    args: Mapping[str, Any], workflow: WaterWorkflow, view: View, path: Path
) -> FrameTruth | None:
    """Truth beside the frames, or the level surface that the workflow names; None without both."""
    first, last = args["acquisitions"]
    if args["truth_frames"] == workflow.surface.frames_per_acquisition:
        return read_truth(path, first, last)
    if workflow.level is None:
        return None
    shape = last - first, *view.x.shape
    up = np.broadcast_to(np.array([0.0, 0.0, -1.0]), (*shape, 3))
    return FrameTruth(np.full(shape, workflow.level.down_m), up)


def _errors(
    surfaces: list[Surface], truth: FrameTruth, view: View, workflow: WaterWorkflow
) -> Arrays:
    """Errors of each surface and of the ends of its rays (a, 6); sums of the pixels' errors."""
    rows, floors, ways = [], [], workflow.path
    sums = np.zeros((len(accuracy.PIXEL_SUMS), *view.x.shape))
    footprint = accuracy.middle(view.x.shape, ways.beam_pixels)
    for surface, down, normals in zip(surfaces, truth.down_m, truth.normals, strict=True):
        own = surface.points_m, surface.normals
        made, error, angle = accuracy.surface_error(*own, down, normals)
        sums += accuracy.pixel_sums(error, angle)
        rows.append(made)
        true_points = view.points((down - view.origin_m[2]) / view.look[..., 2])
        found, true = (
            (point[footprint], normal[footprint]) for point, normal in (own, (true_points, normals))
        )
        lengths = ways.in_water_m, ways.index_water
        floors.append(accuracy.floor_error(view.look[footprint], found, true, *lengths))
    return {"errors": np.array(rows), "floor": np.array(floors), "pixels": sums}


class Grid(NamedTuple):
    """Cells of a raster."""

    #: East and north of the south-west corner [cell], counted from easting and northing 0.
    east: int
    north: int
    rows: int
    cols: int
    cell_m: float


def known_points(points_m: Floats, origin_m: Vector) -> Floats:
    """Easting, northing, height, (n, 3), of what is known of points north, east, down [m]."""
    known = points_m[np.isfinite(points_m).all(axis=-1)]
    return known[:, [1, 0, 2]] * [1.0, 1.0, -1.0] + origin_m


def grid_around(points_m: Floats, cell_m: float) -> Grid:
    """Smallest grid around points, easting and northing first [m]."""
    low = np.floor(points_m[:, :2].min(axis=0) / cell_m).astype(int)
    cols, rows = np.floor(points_m[:, :2].max(axis=0) / cell_m).astype(int) + 1 - low
    return Grid(int(low[0]), int(low[1]), int(rows), int(cols), cell_m)


def height_raster(points_m: Floats, grid: Grid) -> Floats:
    """Heights at the centres of cells, (rows, cols) [m], of :func:`known_points`; NaN for none."""
    vertices = points_m - [grid.east * grid.cell_m, grid.north * grid.cell_m, 0.0]
    # Pixels are about evenly spaced: a centre farther than a few spacings lies outside.
    area = grid.rows * grid.cols * grid.cell_m**2
    reach = max(3.0 * math.sqrt(area / max(len(vertices), 1)), 1.5 * grid.cell_m)
    return tin_raster(vertices, grid.cell_m, (grid.rows, grid.cols), reach)


_AXES: Final = ("north", "east", "down")

POINT_COLUMNS: Final = MappingProxyType(
    {
        "acquisition": np.int32,
        "row": np.int16,
        "col": np.int16,
        "time_s": np.float64,
        **{f"{axis}_m": np.float64 for axis in _AXES},
        **{f"normal_{axis}": np.float32 for axis in _AXES},
        "range_m": np.float64,
        "intensity": np.float32,
        **{f"floor_{axis}_m": np.float64 for axis in _AXES},
    }
)
"""Columns of the delivered points; those of the floor are NaN where no rays are traced."""


def _pieces(args: Mapping[str, Any], context: WaterContext) -> Iterator[Arrays]:
    """What :func:`make_surfaces` left of the pieces of a file, in order."""
    for name in args["pieces"]:
        yield read_arrays(context.store.path("surfaces", f"{name}.npz"))


def deliver_file(args: Mapping[str, Any], context: WaterContext) -> Produced:
    """Points of a file with their normals as Parquet, mean height of its surfaces as a GeoTIFF.

    A raster of each acquisition too where that is asked for.
    """
    workflow, name = context.workflow, args["delivered"]
    outputs = [context.output / "points" / f"{name}.parquet"]
    done, points, corners = 0, 0, []
    with writing(outputs[0], POINT_COLUMNS, durable=True) as writer:
        for piece in _pieces(args, context):
            columns = _columns(piece, done, workflow)
            writer.write(columns)
            known = known_points(piece["points_m"], workflow.survey.origin_m)
            if len(known):
                corners += [known.min(axis=0), known.max(axis=0)]
            points += len(columns["row"])
            done += len(piece["points_m"])
    if corners:
        grid = grid_around(np.array(corners), workflow.outputs.cell_m)
        outputs += _rasters(args, context, grid, done)
    return Produced(outputs, {"points": points, "delivered": name}, points)


def _columns(piece: Arrays, first: int, workflow: WaterWorkflow) -> Arrays:
    """Points of the acquisitions of a piece, from the ``first`` on."""
    per, points = workflow.surface.frames_per_acquisition, piece["points_m"]
    ends = np.full(points.shape, np.nan)
    if workflow.path.in_water_m > 0:
        look = view_of(workflow.camera, workflow.mount).look
        normals = piece["normals"].astype(np.float64)
        rays = refracted(look, normals, workflow.path.index_water)
        ends = floor_points(points, rays, workflow.path.in_water_m)
    at = np.nonzero(np.isfinite(points[..., 2]))
    columns: Arrays = {
        "acquisition": first + at[0],
        "row": at[1],
        "col": at[2],
        "time_s": ((first + at[0]) * per + (per - 1) / 2) / workflow.camera.prf_hz,
        "range_m": piece["range_m"][at],
        "intensity": piece["intensity"][at],
    }
    for axis, name in enumerate(_AXES):
        columns[f"{name}_m"] = points[at][:, axis]
        columns[f"normal_{name}"] = piece["normals"][at][:, axis]
        columns[f"floor_{name}_m"] = ends[at][:, axis]
    return {name: columns[name].astype(dtype) for name, dtype in POINT_COLUMNS.items()}


def _rasters(
    args: Mapping[str, Any], context: WaterContext, grid: Grid, surfaces: int
) -> Iterator[Path]:
    """Write the mean of a file's surfaces, and each of them where that is asked for."""
    folder, name = context.output / "surfaces", args["delivered"]
    total, count = np.zeros((2, grid.rows, grid.cols))
    each = (points for piece in _pieces(args, context) for points in piece["points_m"])
    for k, points in enumerate(each):
        height = height_raster(known_points(points, context.workflow.survey.origin_m), grid)
        known = np.isfinite(height)
        total[known] += height[known]
        count += known
        if context.workflow.outputs.each_acquisition:
            yield _write_raster(folder / name / f"{k:05d}.tif", height, grid, context)
    # Cells at the rim are seen while a wave is high only, or low: nine surfaces in ten must know
    # a cell.
    mean = np.full(total.shape, np.nan)
    np.divide(total, count, out=mean, where=count >= max(0.9 * surfaces, 1))
    yield _write_raster(folder / f"{name}.tif", mean, grid, context)


def _write_raster(path: Path, height: Floats, grid: Grid, context: WaterContext) -> Path:
    values = np.where(np.isfinite(height), height, NODATA).astype(np.float32)
    write_cog(
        path,
        np.ascontiguousarray(values[::-1]),
        shape=values.shape,
        origin_xy_m=(grid.east * grid.cell_m, (grid.north + grid.rows) * grid.cell_m),
        cell_m=grid.cell_m,
        crs=context.crs_wkt or None,
        description="height of the water surface",
        unit="m",
    )
    return path
