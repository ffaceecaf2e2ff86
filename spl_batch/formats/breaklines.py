"""Breaklines of water: polygons and lines with heights, of any vector format.

A polygon with a line in it is a river, whose heights are the line's. Any other is a lake of one
height: that of all its vertices, or a field :data:`HEIGHT_FIELDS`. Every fault of a file is
reported at once.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import shapely
from numpy.typing import NDArray
from pyproj import CRS

from spl_batch.errors import InputError
from spl_batch.formats.units import Units, both
from spl_batch.formats.vector_files import LINES, POLYGONS, Layer, read_layers

HEIGHT_FIELDS: Final = ("z", "height", "elevation")
"""Names of a field with the height of a feature whose vertices have none [m]."""

LEVEL_M: Final = 0.02
"""Heights of a lake's vertices differ by no more: by two roundings to centimetres [m]."""

Geometries = NDArray[np.object_]
Heights = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class CentreLine:
    """A line along which water runs, from its upper end."""

    line: shapely.LineString  #: Its course, in the survey's CRS [m].
    along: Heights  #: (k,) float64: distance of each vertex from the upper end, rising [m].
    z: Heights  #: (k,) float64: height of the water there, nowhere rising [m].


@dataclass(frozen=True, slots=True)
class Water:
    """A lake or a river."""

    area: shapely.Geometry  #: What it covers, in the survey's CRS; islands are holes.
    level_m: float | None  #: Height of a lake; None for a river [m].
    lines: tuple[CentreLine, ...] = ()  #: Of a river.


def read_breaklines(path: Path, crs: CRS | None) -> list[Water]:
    """Lakes and rivers of a file in metres, in the order of its layers and features.

    ``path``: a GeoPackage or another vector file; every layer is taken.

    Raises
    ------
    InputError
        With all faults of the file: a damaged shape, none of its polygons, no CRS, another unit
        than the survey's, heights of another vertical datum, a polygon without one height and
        without a line.
    """
    names: list[str] = []
    parts: list[Geometries] = []
    fields: list[Heights] = []
    for layer in read_layers(path, (*POLYGONS, *LINES), crs, fields=True, heights=True):
        names += [f"{layer.name} {k}" for k in range(1, len(layer.shapes) + 1)]
        parts.append(layer.shapes)
        fields.append(_heights(layer) * Units.of(crs).vertical_m)
    if not parts:
        raise InputError(str(path), "holds no polygons of water; draw some or remove the key")
    shapes, height = np.concatenate(parts), np.concatenate(fields)
    kind = shapely.get_type_id(shapes)
    if not np.isin(kind, POLYGONS).any():
        raise InputError(str(path), "holds lines alone: draw the polygon of each river as well")
    lines = _merged(shapes[np.isin(kind, LINES)])
    faults: list[str] = []
    found, unit = [], Units.of(crs).of_heights
    for k in np.flatnonzero(np.isin(kind, POLYGONS)):
        try:
            found.append(_water(shapes[k], float(height[k]), lines, unit))
        except ValueError as fault:
            faults.append(f"{names[k]}: {fault}")
    if faults:
        raise InputError(str(path), faults)
    return found


def _heights(layer: Layer) -> Heights:
    """The field of heights; NaN without."""
    heights = np.full(len(layer.shapes), np.nan)
    for field, values in layer.fields.items():
        if field in HEIGHT_FIELDS and np.issubdtype(values.dtype, np.number):
            heights = values.astype(np.float64)
    return heights


def _merged(lines: Geometries) -> list[shapely.LineString]:
    """Lines that continue one another are one."""
    if not len(lines):
        return []
    merged = shapely.line_merge(shapely.union_all(shapely.get_parts(lines)))
    return [*shapely.get_parts(merged)]


def _water(
    shape: shapely.Geometry,
    height: float,
    lines: list[shapely.LineString],
    unit: tuple[str, float],
) -> Water:
    """What a polygon is; ValueError, in the survey's unit, where its heights leave it open."""
    flat = shapely.force_2d(shape)
    area = flat if shapely.is_valid(flat) else shapely.make_valid(flat)
    inside = [line for line in lines if shapely.length(shapely.intersection(line, area)) > 0]
    if inside:
        return Water(area, None, tuple(map(_downhill, inside)))
    z = shapely.get_coordinates(shape, include_z=True)[:, 2]
    if np.isnan(z).all():
        z = np.array([height])
    if not np.isfinite(z).all():
        raise ValueError("has no height: give its vertices one, or a field z")
    # A comparison with NaN, of a feature without the field, is false.
    if max(z.max() - height, height - z.min()) > LEVEL_M:
        raise ValueError(
            f"its vertices lie at {both(z.min(), unit)} to {both(z.max(), unit)}, its field of "
            f"heights states {both(height, unit)}: correct one, or leave the field out"
        )
    if np.ptp(z) > LEVEL_M:
        raise ValueError(
            f"its vertices differ by {both(np.ptp(z), unit)} and no line lies in it: a lake has "
            "one height, a river a centre line with heights"
        )
    return Water(area, float(z.min()))


def _downhill(line: shapely.LineString) -> CentreLine:
    """A centre line from its upper end, on which nothing rises."""
    xyz = shapely.get_coordinates(line, include_z=True)
    z = xyz[:, 2]
    if not np.isfinite(z).all():
        raise ValueError("a line in it has vertices without heights")
    if z[-1] > z[0]:
        xyz, line = xyz[::-1], shapely.reverse(line)
    steps = np.hypot(*np.diff(xyz[:, :2], axis=0).T)
    along = np.append(0.0, np.cumsum(steps))
    return CentreLine(shapely.force_2d(line), along, np.minimum.accumulate(xyz[:, 2]))
