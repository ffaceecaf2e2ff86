"""``index.gpkg``: files, flightlines, blocks and checkpoints as layers, with counts."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import shapely
from pyproj import CRS

from spl_batch.formats.files.atomic import replacing, scratch_folder

NAME: Final = "index.gpkg"
"""File below the output."""

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
    columns: Mapping[str, Sequence[Any]]  #: What is said of them.


def write_index(output: Path, layers: Sequence[Layer], crs: CRS | None) -> Path:
    """Write ``index.gpkg``; layers without features are left out.

    ``crs``: of the coordinates; :data:`UNDEFINED` where it is None.
    """
    import pyogrio  # noqa: PLC0415 - 28 MiB of every worker, and few read such files

    path = output / NAME
    pyogrio.set_gdal_config_options({"OGR_CURRENT_DATE": WRITTEN})
    try:
        with replacing(path) as target, scratch_folder(path) as folder:
            whole = folder / NAME  # GDAL keeps its journal beside the file
            for layer in layers:
                if len(layer.shapes):
                    _write(whole, layer, crs)
            whole.replace(target)
    finally:
        pyogrio.set_gdal_config_options({"OGR_CURRENT_DATE": None})
    return path


def _write(path: Path, layer: Layer, crs: CRS | None) -> None:
    import pyogrio  # noqa: PLC0415 - 28 MiB of every worker, and few read such files

    shapes = np.asarray(layer.shapes, object)
    kinds = {shape.geom_type for shape in layer.shapes}
    pyogrio.raw.write(
        path,
        shapely.to_wkb(shapes),
        [_column(values) for values in layer.columns.values()],
        list(layer.columns),
        layer=layer.name,
        driver="GPKG",
        geometry_type=f"{kinds.pop()}{' Z' if layer.shapes[0].has_z else ''}",
        crs=UNDEFINED if crs is None else crs.to_wkt(),
        append=path.exists(),
    )


def _column(values: Sequence[Any]) -> Any:
    """Values of one type; text where one is text, else numbers, NaN for None."""
    if any(isinstance(value, str) for value in values):
        return np.array(["" if value is None else value for value in values], object)
    if all(isinstance(value, int) for value in values):
        return np.array(values, np.int64)
    return np.array([np.nan if value is None else value for value in values], np.float64)
