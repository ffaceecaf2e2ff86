"""All catalogues of a delivery: STAC, virtual point cloud, index."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

import shapely
from pyproj import CRS

from spl_batch.airborne.catalogue import index_layers
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
from spl_batch.errors import plain
from spl_batch.formats.crs import crs_name

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
        last_s, files``) and ``checkpoints``, as the plan gives them.
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
    written = [index_layers.write_index(output, list(_layers(args, clouds, outlines)), crs)]
    held = [cloud for cloud in clouds if cloud.points]
    reason = _why_without_places(crs, held, rasters)
    if crs is not None and not reason:
        written += write_stac(output, Delivery(plain(name), crs, held, rasters))
    remark = f"{reason}: no STAC and no virtual point cloud are written"
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


def _together(boxes: Sequence[shapely.Geometry]) -> shapely.Geometry:
    """Where the files of a flightline lie, as several polygons."""
    found = shapely.union_all(boxes)
    return found if found.geom_type == "MultiPolygon" else shapely.MultiPolygon([found])
