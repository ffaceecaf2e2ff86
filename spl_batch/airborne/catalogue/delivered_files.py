"""Delivered clouds and rasters as catalogues name them: where they lie, what they hold."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Final

import laspy
import numpy as np
import shapely
from pyproj import CRS, Transformer
from pyproj.exceptions import ProjError

from spl_batch.airborne.settings import SurveySettings
from spl_batch.formats.crs import horizontal, same_crs, vertical
from spl_batch.formats.units import Units

INDEX: Final = "index.gpkg"
"""Files, flightlines and checkpoints as layers, with counts; below the output."""

STAC: Final = "stac"
"""Folder of the catalogue, below the output."""

VIRTUAL: Final = "survey.vpc"
"""Virtual point cloud, below the output."""

CONTOURS: Final = "contours.gpkg"
"""Contours of the terrain, below the output."""

CLIENT_TILES: Final = "client_tiles"
"""Folder of what a client's polygons cut out, below the output."""

REPROJECTED: Final = "reprojected"
"""Folder of clouds and rasters in another CRS or unit, below the output."""


Box = tuple[float, float, float, float]
"""West, south, east, north, in a CRS and its units."""


Span = tuple[float, float]
"""First and last adjusted standard GPS time of some points [s]."""


def plain_name(href: str) -> str:
    """What catalogues call a delivered file, by its path below the output."""
    for end in (".laz", ".copc", ".tif"):
        href = href.removesuffix(end)
    return href.replace("/", "-")


@dataclass(frozen=True)
class Cloud:
    """A delivered cloud."""

    href: str  #: Its path below the output.
    #: West, south, lowest, east, north, highest, in its CRS and that's units.
    bounds: Sequence[float]
    points: int
    span_s: Span | None  #: None without times, or of a clock without a year.
    #: Name, bytes and kind (``floating``, ``unsigned``, ``signed``) of each dimension.
    dimensions: tuple[tuple[str, int, str], ...]
    crs: CRS | None  #: Of its coordinates.

    @property
    def units(self) -> Units:
        """Of its CRS."""
        return Units.of(self.crs)

    @property
    def box(self) -> Box:
        """Where it lies."""
        west, south, _, east, north, _ = self.bounds
        return west, south, east, north

    @property
    def per_m2(self) -> float:
        """Points over the area of its box [1/m2]."""
        west, south, east, north = self.box
        area_m2 = (east - west) * (north - south) * self.units.horizontal_m**2
        return self.points / area_m2 if area_m2 else 0.0


def read_cloud(output: Path, href: str, span_s: Span | None, crs: CRS | None) -> Cloud:
    """A delivered cloud in a CRS, from its header."""
    with laspy.open(output / href) as reader:
        header = reader.header
        low, high = header.mins.tolist(), header.maxs.tolist()
        dimensions = tuple(_dimension(one) for one in header.point_format.dimensions)
        points = int(header.point_count)
    bounds = (*low, *high) if points else (0.0,) * 6
    return Cloud(href, bounds, points, span_s, dimensions, crs)


def _dimension(one: Any) -> tuple[str, int, str]:
    kinds = {"FloatingPoint": "floating", "SignedInteger": "signed"}
    return one.name, max(one.num_bits // 8, 1), kinds.get(one.kind.name, "unsigned")


@dataclass(frozen=True)
class Delivery:
    """Everything that catalogues list."""

    output: Path
    name: str
    survey: SurveySettings  #: Who delivers it, and by what terms.
    crs: CRS
    clouds: Sequence[Cloud]
    rasters: Sequence[str]  #: Their paths below the output.
    reprojected: Sequence[Cloud]  #: The same clouds in another CRS.

    @property
    def span_s(self) -> Span | None:
        """When the whole was flown."""
        ends = [end for cloud in self.clouds for end in cloud.span_s or ()]
        return (min(ends), max(ends)) if ends else None

    def crs_of(self, own: CRS | None) -> CRS:
        """The CRS of all, but of what lies in another, or is above something else, its own."""
        if own is None:
            return self.crs
        mine, ours = vertical(own), vertical(self.crs)
        alike = mine is ours if mine is None or ours is None else mine.equals(ours)
        return self.crs if alike and same_crs(own, self.crs) else own


def box_deg(box: Box, crs: CRS) -> Box:
    """A box of a CRS in longitudes and latitudes, of WGS 84 [deg]."""
    west, south, east, north = _to_degrees(crs).transform_bounds(*box)
    return west, south, east, north


@lru_cache(maxsize=8)
def _to_degrees(crs: CRS) -> Transformer:
    return Transformer.from_crs(horizontal(crs), 4326, always_xy=True)


def leads_to_degrees(crs: CRS) -> bool:
    """Whether a CRS has a place on earth; that of a building site has none."""
    try:
        _to_degrees(crs)
    except ProjError:
        return False
    return True


def outline(box: Box, crs: CRS | None = None) -> dict[str, Any]:
    """Corners of a box, as GeoJSON; in longitudes and latitudes where its CRS is given."""
    ring = shapely.get_coordinates(shapely.box(*box, ccw=True))
    if crs is not None:
        ring = np.column_stack(_to_degrees(crs).transform(*ring.T))
    return {"type": "Polygon", "coordinates": [ring.tolist()]}
