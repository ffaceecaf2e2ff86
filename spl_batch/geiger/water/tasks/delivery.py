"""Tasks of the water surface: deliver points with rays, and rasters.

Cells of rasters lie on whole multiples of their edge.

They count from where easting and northing are 0, wherever the local frame begins: cells of
acquisitions from several places fit onto each other. Rows count from the south, as in
:mod:`spl_batch.numerics.triangulation.tin_raster`.

Deviation: the source's raster is the array itself, whose pixels lie unevenly on the water. Here
cells are equal, and take their depth from the triangles between pixels.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.constants import NODATA
from spl_batch.engine.tasks.context import Produced
from spl_batch.formats.rasters.geotiff import write_cog
from spl_batch.formats.verified.parquet_npz import read_arrays, writing
from spl_batch.geiger.water.pixel_geometry import floor_points, refracted, view_of
from spl_batch.geiger.water.tasks.surfaces import WaterContext
from spl_batch.numerics.triangulation.tin_raster import tin_raster

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Grid:
    """Cells of a raster."""

    #: east, north: of the south-west corner [cell], counted from easting and northing 0.
    east: int
    north: int
    rows: int
    cols: int
    cell_m: float
    #: Easting and northing of the local frame's origin [m].
    origin_m: tuple[float, float] = (0.0, 0.0)


def grid_around(
    places_m: Floats, cell_m: float, origin_m: tuple[float, float] = (0.0, 0.0)
) -> Grid | None:
    """Smallest grid around places, north, east, down [m]; None where none is known.

    ``origin_m``: easting and northing of the local frame's origin [m].
    """
    known = places_m[np.isfinite(places_m).all(axis=-1)]
    if not len(known):
        return None
    place_m = known[:, 1::-1] + np.array(origin_m)
    low = np.floor(place_m.min(axis=0) / cell_m).astype(np.int64)
    high = np.floor(place_m.max(axis=0) / cell_m).astype(np.int64) + 1
    cols, rows = (int(n) for n in high - low)
    return Grid(int(low[0]), int(low[1]), rows, cols, cell_m, origin_m)


def height_raster(places_m: Floats, grid: Grid) -> Floats:
    """Heights (less down) at the centres of cells: (rows, cols) float64 [m], NaN where unknown.

    ``places_m``: north, east, down [m]; NaN where unknown. ``grid``: where to.
    """
    known = places_m[np.isfinite(places_m).all(axis=-1)]
    corner = grid.cell_m * np.array([grid.east, grid.north]) - np.array(grid.origin_m)
    vertices = np.column_stack([known[:, 1] - corner[0], known[:, 0] - corner[1], -known[:, 2]])
    # Pixels are about evenly spaced: a centre farther than a few spacings lies outside.
    area = grid.rows * grid.cols * grid.cell_m**2
    reach = max(3.0 * math.sqrt(area / max(len(known), 1)), 1.5 * grid.cell_m)
    return tin_raster(vertices, grid.cell_m, (grid.rows, grid.cols), reach)


Arrays = Mapping[str, NDArray[Any]]

MEAN_SHARE: Final = 0.9
"""Least share of a file's surfaces that a cell of their mean is known in."""

POINT_COLUMNS: Final = MappingProxyType(
    {
        "acquisition": np.int32,
        "row": np.int16,
        "col": np.int16,
        "time_s": np.float64,
        "north_m": np.float64,
        "east_m": np.float64,
        "down_m": np.float64,
        "normal_north": np.float32,
        "normal_east": np.float32,
        "normal_down": np.float32,
        "range_m": np.float64,
        "intensity": np.float32,
        "floor_north_m": np.float64,
        "floor_east_m": np.float64,
        "floor_down_m": np.float64,
    }
)
"""Columns of the delivered points; those of the floor are NaN where no rays are traced."""


def read_pieces(context: WaterContext, pieces: list[str]) -> Iterator[Arrays]:
    """What :func:`make_surfaces` left of the pieces of a file, in order."""
    for name in pieces:
        yield read_arrays(context.store.path("surfaces", f"{name}.npz"))


def deliver_points(args: Mapping[str, Any], context: WaterContext) -> Produced:
    """Points of all acquisitions of a file with their normals, as Parquet."""
    workflow = context.workflow
    view = view_of(workflow.camera, workflow.mount)
    per, prf_hz = workflow.surface.frames_per_acquisition, workflow.camera.prf_hz
    path = context.output / "points" / f"{args['delivered']}.parquet"
    count, k = 0, 0
    with writing(path, POINT_COLUMNS, durable=True) as writer:
        for piece in read_pieces(context, args["pieces"]):
            places, normals = piece["places_m"], piece["normals"].astype(np.float64)
            ends = np.full(places.shape, np.nan)
            if workflow.path.in_water_m > 0:
                rays = refracted(view.look, normals, workflow.path.index_water)
                ends = floor_points(places, rays, workflow.path.in_water_m)
            at = np.nonzero(np.isfinite(places[..., 2]))
            columns: dict[str, NDArray[Any]] = {
                "acquisition": (k + at[0]).astype(np.int32),
                "row": at[1].astype(np.int16),
                "col": at[2].astype(np.int16),
                "time_s": ((k + at[0]) * per + (per - 1) / 2) / prf_hz,
                "range_m": piece["range_m"][at],
                "intensity": piece["intensity"][at],
            }
            for axis, name in enumerate(("north", "east", "down")):
                columns[f"{name}_m"] = places[at][:, axis]
                columns[f"normal_{name}"] = piece["normals"][at][:, axis]
                columns[f"floor_{name}_m"] = ends[at][:, axis]
            writer.write(columns)
            count += len(at[0])
            k += len(places)
    return Produced([path], {"points": count}, count)


def deliver_rasters(args: Mapping[str, Any], context: WaterContext) -> Produced:
    """Mean height of a file's surfaces as a GeoTIFF, and each of them where that is asked for."""
    workflow = context.workflow
    grid = _grid(context, args["pieces"])
    if grid is None:
        return Produced((), {"cells": 0, "delivered": args["delivered"]})
    total = np.zeros((grid.rows, grid.cols))
    count = np.zeros((grid.rows, grid.cols), dtype=np.int64)
    outputs, k = [], 0
    for piece in read_pieces(context, args["pieces"]):
        for places in piece["places_m"]:
            height = height_raster(places, grid)
            known = np.isfinite(height)
            total[known] += height[known]
            count += known
            if workflow.outputs.each_acquisition:
                path = context.output / "surfaces" / args["delivered"] / f"{k:05d}.tif"
                _write_raster(path, height, grid, context)
                outputs.append(path)
            k += 1
    # Cells at the rim are seen while a wave is high only, or low.
    seen = count >= max(MEAN_SHARE * k, 1)
    mean = np.full(total.shape, np.nan)
    np.divide(total, count, out=mean, where=seen)
    path = context.output / "surfaces" / f"{args['delivered']}.tif"
    _write_raster(path, mean, grid, context)
    facts = {"cells": int(seen.sum()), "delivered": args["delivered"]}
    return Produced([path, *outputs], facts, int(count.sum()))


def _grid(context: WaterContext, pieces: list[str]) -> Grid | None:
    """Cells that hold every acquisition of a file."""
    boxes = []
    for piece in read_pieces(context, pieces):
        known = piece["places_m"][np.isfinite(piece["places_m"]).all(axis=-1)]
        if len(known):
            boxes += [known.min(axis=0), known.max(axis=0)]
    workflow = context.workflow
    if not boxes:
        return None
    return grid_around(np.array(boxes), workflow.outputs.cell_m, workflow.survey.origin_m[:2])


def _write_raster(
    path: Path, height: NDArray[np.float64], grid: Grid, context: WaterContext
) -> None:
    up = context.workflow.survey.origin_m[2]
    values = np.where(np.isfinite(height), height + up, NODATA).astype(np.float32)
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
