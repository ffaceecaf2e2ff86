"""All catalogues of a delivery: STAC, virtual point cloud, index."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import shapely
from pyproj import CRS

from spl_batch.airborne.catalogue import INDEX
from spl_batch.airborne.catalogue.stac import (
    Cloud,
    Delivery,
    leads_to_degrees,
    read_cloud,
    write_stac,
)
from spl_batch.airborne.settings import SurveySettings
from spl_batch.errors import plain
from spl_batch.formats.crs import compound, crs_name, in_unit, same_crs
from spl_batch.formats.files.atomic import replacing, scratch_folder
from spl_batch.formats.heights import SOME_HEIGHTS
from spl_batch.formats.las.header import read_header
from spl_batch.formats.las.known_records import header_crs
from spl_batch.formats.units import Units

REMEDY: Final = "; name it in survey.crs"
"""Where no CRS is known."""

WRITTEN: Final = "1980-01-06T00:00:00.000Z"
"""Date of change that the file states, so that the same content has the same bytes."""


UNDEFINED: Final = (
    'ENGCRS["Undefined Cartesian SRS",EDATUM["Unknown engineering datum"],CS[Cartesian,2],'
    'AXIS["easting",east,ORDER[1]],AXIS["northing",north,ORDER[2]],LENGTHUNIT["metre",1]]'
)
"""What GeoPackage 1.3 calls coordinates in metres without a CRS (``srs_id`` -1), by GDAL's name."""


class Layer(NamedTuple):
    """Features of one kind."""

    name: str
    shapes: Sequence[shapely.Geometry]  #: Where they are.
    columns: Mapping[str, Sequence[Any]]  #: Their attributes.


def write_catalogues(
    output: Path,
    survey: SurveySettings,
    crs: CRS | None,
    args: Mapping[str, Any],
    outlines: Mapping[str, shapely.MultiPolygon],
) -> tuple[list[Path], list[str]]:
    """Write every catalogue of the clouds and rasters of a run.

    Parameters
    ----------
    survey : SurveySettings
        Its name, and who delivers.
    args : mapping
        ``clouds`` (``href``, ``span_s``), ``rasters``, ``reprojected`` (clouds in another CRS),
        ``flightlines`` (``id, points, first_s,
        last_s, files``) and ``checkpoints``, as the plan gives them.
    outlines : mapping of str to MultiPolygon
        Where flightlines lie, by their names [m]; others lie in the boxes of their files.

    Returns
    -------
    written : list of Path
        Every file.
    remarks : list of str
        What could not be written, and why.
    """
    units = Units.of(crs)
    clouds = [read_cloud(output, crs=crs, **one) for one in args["clouds"]]
    moved = [
        read_cloud(output, crs=header_crs(read_header(output / one["href"]))[0], **one)
        for one in args["reprojected"]
    ]
    text = None if crs is None else crs.to_wkt()
    written = [write_layers(output / INDEX, list(_layers(args, clouds, outlines, units)), text)]
    held = [cloud for cloud in clouds if cloud.points]
    reason = _why_without_places(crs, held, args["rasters"])
    if crs is not None and not reason:
        elsewhere = [cloud for cloud in moved if cloud.points]
        name = plain(survey.name)
        delivery = Delivery(output, name, survey, crs, held, args["rasters"], elsewhere)
        written += write_stac(delivery)
    remark = f"{reason}: no STAC and no virtual point cloud are written"
    return written, [f"{remark}{REMEDY if crs is None else ''}"] if reason else []


def _why_without_places(crs: CRS | None, held: Sequence[Cloud], rasters: Sequence[str]) -> str:
    """Why nothing can be listed by its place on earth; empty if it can."""
    if crs is None:
        return "without a CRS nothing shows where on earth the survey lies"
    if not leads_to_degrees(crs):
        return f"the CRS {crs_name(crs)} does not show where on earth the survey lies"
    if not held and not rasters:
        return "no delivered cloud holds a point, and there is no raster"
    return ""


def _layers(
    args: Mapping[str, Any],
    clouds: Sequence[Cloud],
    outlines: Mapping[str, shapely.MultiPolygon],
    units: Units,
) -> Iterator[Layer]:
    """Topmost first."""
    points = args["checkpoints"]
    places = np.array([(one["x_m"], one["y_m"], one["z_m"]) for one in points]).reshape(-1, 3)
    yield Layer(
        "checkpoints",
        list(shapely.points(places / units.xyz_m)),
        {key: [one[key] for one in points] for key in ("id", "surface", "accuracy_m", "error_m")},
    )
    boxes = {cloud.href: shapely.box(*cloud.box) for cloud in clouds}
    lines = args["flightlines"]
    flown = [
        in_units(outlines.get(one["id"]), units)
        or shapely.union_all([boxes[href] for href in one["files"]])
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


def in_units(shape: shapely.Geometry | None, units: Units) -> shapely.Geometry | None:
    """A shape in metres, in the units of the survey's CRS."""
    if shape is None or units.are_metres:
        return shape
    return shapely.transform(shape, lambda xy: xy / units.horizontal_m)


def write_layers(path: Path, layers: Sequence[Layer], crs: str | None) -> Path:
    """Write a GeoPackage; layers without features are left out, the same content is equal bytes.

    ``crs``: of the coordinates, as WKT; :data:`UNDEFINED` where it is None.
    """
    import pyogrio  # noqa: PLC0415 - 28 MiB of every worker, and few read such files

    pyogrio.set_gdal_config_options({"OGR_CURRENT_DATE": WRITTEN})
    try:
        with replacing(path) as target, scratch_folder(path) as folder:
            whole = folder / path.name  # GDAL keeps its journal beside the file
            text = UNDEFINED if crs is None else _as_gdal_takes_it(crs, folder)
            for layer in layers:
                if len(layer.shapes):
                    _write(whole, layer, text)
            whole.replace(target)
    finally:
        pyogrio.set_gdal_config_options({"OGR_CURRENT_DATE": None})
    return path


def _write(path: Path, layer: Layer, crs: str) -> None:
    import pyogrio  # noqa: PLC0415 - 28 MiB of every worker, and few read such files

    shapes = np.asarray(layer.shapes, object)
    kind = max({shape.geom_type for shape in layer.shapes}, key=len)  # several parts, if any has
    pyogrio.raw.write(
        path,
        shapely.to_wkb(shapes),
        [_column(values) for values in layer.columns.values()],
        list(layer.columns),
        layer=layer.name,
        driver="GPKG",
        geometry_type=f"{kind}{' Z' if layer.shapes[0].has_z else ''}",
        promote_to_multi=kind.startswith("Multi"),
        crs=crs,
        append=path.exists(),
    )


def _as_gdal_takes_it(crs: str, folder: Path) -> str:
    """WKT of a CRS by which a GeoPackage is in that CRS.

    GDAL takes a UTM of WGS 84, NAD83 or NAD27 without a code, such as one in feet, for EPSG's in
    metres (``OGRSpatialReference::AutoIdentifyEPSG``), but for one with heights. Readers do so too.
    """
    import pyogrio  # noqa: PLC0415 - 28 MiB of every worker, and few read such files

    known = CRS.from_wkt(crs)
    if known.to_epsg() is not None:
        return crs
    trial = folder / "trial.gpkg"
    _write(trial, Layer("trial", [shapely.Point(0, 0)], {}), crs)
    found = CRS.from_user_input(pyogrio.read_info(trial)["crs"])
    if same_crs(found, known):
        return crs
    return compound(known, in_unit(SOME_HEIGHTS, Units.of(known).vertical)).to_wkt()


def _column(values: Sequence[Any]) -> Any:
    """Values of one type; text where one is text, else numbers, NaN for None."""
    if any(isinstance(value, str) for value in values):
        return np.array(["" if value is None else value for value in values], object)
    if all(isinstance(value, int) for value in values):
        return np.array(values, np.int64)
    return np.array([np.nan if value is None else value for value in values], np.float64)
