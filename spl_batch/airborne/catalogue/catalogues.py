"""All catalogues of a delivery: STAC, virtual point cloud, index, QGIS, metadata."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

import numpy as np
import shapely
from numpy.typing import NDArray
from pyproj import CRS

from spl_batch.airborne.catalogue import index_layers, metadata, qgis, virtual_cloud
from spl_batch.airborne.catalogue.delivered_files import (
    UNKNOWN_SPAN,
    Cloud,
    Delivery,
    RasterFile,
    Span,
    leads_to_degrees,
    read_cloud,
    read_raster_file,
    utc_span,
)
from spl_batch.airborne.catalogue.index_layers import Layer
from spl_batch.airborne.catalogue.stac import write_stac
from spl_batch.constants import QUANTUM_M
from spl_batch.errors import plain
from spl_batch.formats.crs import crs_name
from spl_batch.lattice.tiles import Bounds, cell_bounds, parse_cell

REMEDY: Final = "; name it in survey.crs"
"""Where no CRS is known."""


def write_catalogues(
    output: Path,
    name: str,
    crs: CRS | None,
    args: Mapping[str, Any],
    outlines: Mapping[str, shapely.MultiPolygon] = MappingProxyType({}),
) -> tuple[list[Path], list[str]]:
    """Write every catalogue of the clouds and rasters of a run.

    Parameters
    ----------
    args : mapping
        ``clouds`` (``href``, ``span_s``), ``rasters``, ``flightlines`` (``id, points, first_s,
        last_s, files``), ``blocks`` (name, core, whether it is finished), ``tiles`` (points by
        name), ``tile_q``, ``checkpoints`` and ``steps`` (sentences), as the plan gives them.
    outlines : mapping of str to MultiPolygon
        Where flightlines lie, by their names; others lie in the boxes of their files.

    Returns
    -------
    written : list of Path
        Every file.
    remarks : list of str
        What could not be written, and why.
    """
    clouds = [read_cloud(output, one["href"], _span(one["span_s"])) for one in args["clouds"]]
    rasters = [read_raster_file(output, href) for href in args["rasters"]]
    layers = [layer for layer in _layers(args, clouds, outlines) if len(layer.shapes)]
    written = [index_layers.write_index(output, layers, crs)]
    held = [cloud for cloud in clouds if cloud.points]
    reason = _why_without_places(crs, held, rasters)
    vpc = None
    if crs is not None and not reason:
        written += _of_places(output, Delivery(plain(name), crs, held, rasters), args)
        vpc = virtual_cloud.NAME
    written += _of_qgis(output, rasters, vpc, [layer.name for layer in layers], crs)
    remark = f"{reason}: no STAC, no virtual point cloud and no metadata are written"
    return written, [f"{remark}{REMEDY if crs is None else ''}"] if reason else []


def _why_without_places(
    crs: CRS | None, held: Sequence[Cloud], rasters: Sequence[RasterFile]
) -> str:
    """Why nothing can be listed by its place on earth; empty if it can."""
    if crs is None:
        return "without a CRS nothing tells where on earth the survey lies"
    if not leads_to_degrees(crs):
        return f"the CRS {crs_name(crs)} does not tell where on earth the survey lies"
    if not held and not rasters:
        return "no delivered cloud holds a point, and there is no raster"
    return ""


def _of_places(output: Path, with_points: Delivery, args: Mapping[str, Any]) -> list[Path]:
    told = args["checkpoints"], len(args["flightlines"]), args["steps"]
    return [
        *write_stac(output, with_points),
        virtual_cloud.write_vpc(output, with_points),
        metadata.write_metadata(output, with_points, *told),
    ]


def _of_qgis(
    output: Path,
    rasters: Sequence[RasterFile],
    vpc: str | None,
    layers: Sequence[str],
    crs: CRS | None,
) -> list[Path]:
    index = index_layers.NAME
    return [
        *qgis.write_styles(output, rasters, vpc),
        qgis.write_layers(output, rasters, vpc, index, layers, crs),
    ]


def _span(seconds: Sequence[float] | None) -> Span:
    return UNKNOWN_SPAN if seconds is None else utc_span(*seconds)


def _layers(
    args: Mapping[str, Any],
    clouds: Sequence[Cloud],
    outlines: Mapping[str, shapely.MultiPolygon],
) -> Iterator[Layer]:
    """Topmost first."""
    points = args["checkpoints"]
    yield Layer(
        "checkpoints",
        [shapely.Point(one["x_m"], one["y_m"], one["z_m"]) for one in points],
        {key: [one[key] for one in points] for key in ("id", "surface", "accuracy_m", "error_m")},
    )
    boxes = {cloud.href: shapely.box(*cloud.box_m) for cloud in clouds}
    lines = args["flightlines"]
    flown = [
        outlines.get(one["id"]) or _together([boxes[href] for href in one["files"]])
        for one in lines
    ]
    keys = ("id", "points", "first_s", "last_s", "area_m2", "per_m2")
    yield Layer("flightlines", flown, {key: [one[key] for one in lines] for key in keys})
    yield Layer(
        "files",
        list(boxes.values()),
        {
            "file": [cloud.href for cloud in clouds],
            "points": [cloud.points for cloud in clouds],
            "per_m2": [cloud.per_m2 for cloud in clouds],
        },
    )
    yield from _squares(args)


def _together(boxes: Sequence[shapely.Geometry]) -> shapely.Geometry:
    """Where the files of a flightline lie, as several polygons."""
    found = shapely.union_all(boxes)
    return found if found.geom_type == "MultiPolygon" else shapely.MultiPolygon([found])


def _squares(args: Mapping[str, Any]) -> Iterator[Layer]:
    tiles = {tile: cell_bounds(parse_cell(tile), args["tile_q"]) for tile in args["tiles"]}
    counts = list(args["tiles"].values())
    edges = np.array(list(tiles.values()), np.int64).reshape(-1, 4).T
    held = np.array(counts, np.float64)
    for name, wanted in (("failures", False), ("blocks", True)):
        mine = [(block, Bounds(*core)) for block, core, done in args["blocks"] if done is wanted]
        squares = [_box(core) for _, core in mine]
        points = [_points_in(core, edges, held) for _, core in mine]
        said = {"block": [block for block, _ in mine], "points": points}
        yield Layer(name, squares, {**said, "per_m2": _per_m2(points, squares)})
    squares = list(map(_box, tiles.values()))
    said = {"tile": list(tiles), "points": counts, "per_m2": _per_m2(counts, squares)}
    yield Layer("tiles", squares, said)


def _points_in(core: Bounds, edges: NDArray[np.int64], held: NDArray[np.float64]) -> int:
    """Points of a block: those of its tiles, of a tile that it cuts as many as its share."""
    west, south, east, north = edges
    wide = np.minimum(east, core.xmax) - np.maximum(west, core.xmin)
    high = np.minimum(north, core.ymax) - np.maximum(south, core.ymin)
    share = wide.clip(0) * high.clip(0) / ((east - west) * (north - south))
    return round(float(share @ held))


def _per_m2(points: Sequence[int], shapes: Sequence[shapely.Geometry]) -> list[float | None]:
    """Points by area; None where a place has none."""
    areas = map(shapely.area, shapes)
    return [n / area if area else None for n, area in zip(points, areas, strict=True)]


def _box(bounds_q: Sequence[int]) -> shapely.Geometry:
    return shapely.box(*(edge * QUANTUM_M for edge in bounds_q))
