"""STAC 1.1: a collection with an item for each cloud and raster, and a virtual point cloud.

Sources: STAC 1.1.0; extensions point cloud 1.0.0 and projection 2.0.0; the VPC specification of
PDAL wrench, a GeoJSON file of the clouds' items whose readers take STAC 1.0.0 with projection 1.1.0
alone. All links are relative, so that the folder can be moved.
"""

import datetime as dt
import hashlib
import json
from collections import Counter
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

from spl_batch.airborne.catalogue import STAC, VIRTUAL
from spl_batch.airborne.settings import SurveySettings
from spl_batch.constants import ADJUSTED_STANDARD_OFFSET_S
from spl_batch.errors import plain
from spl_batch.formats.crs import horizontal, same_crs, vertical
from spl_batch.formats.files.atomic import write_bytes
from spl_batch.formats.gps_clock import leap_seconds
from spl_batch.formats.rasters.parts import opened, place_m
from spl_batch.formats.units import Units

GPS_EPOCH: Final = dt.datetime(1980, 1, 6, tzinfo=dt.UTC)
"""Where GPS time begins."""

LONGEST_ID: Final = 200
"""Of an item: file systems allow names of 255 bytes [byte]."""

COG_TYPE: Final = "image/tiff; application=geotiff; profile=cloud-optimized"
LAZ_TYPE: Final = "application/vnd.laszip"
COPC_TYPE: Final = "application/vnd.laszip+copc"
SOFTWARE: Final = "spl-batch"

EXTENSION: Final = "https://stac-extensions.github.io/{}/schema.json"
POINT_CLOUD: Final = EXTENSION.format("pointcloud/v1.0.0")
PROJECTION: Final = EXTENSION.format("projection/v2.0.0")
VIRTUAL_PROJECTION: Final = EXTENSION.format("projection/v1.1.0")

Record = dict[str, Any]
"""Content of a JSON file."""

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


def _item_ids(hrefs: Sequence[str]) -> dict[str, str]:
    """A name for the item of each file, which is a file's name as well.

    Names that are too long for that, or would be those of two files, end in a hash.
    """
    names = {href: plain_name(href) for href in hrefs}
    taken = Counter(name.casefold() for name in names.values())
    for href, name in names.items():
        if taken[name.casefold()] > 1 or len(name.encode()) > LONGEST_ID:
            start = name.encode()[: LONGEST_ID - 17].decode(errors="ignore")
            names[href] = f"{start}-{hashlib.blake2b(href.encode(), digest_size=8).hexdigest()}"
    return names


def write_stac(delivery: Delivery) -> list[Path]:
    """Write ``stac/collection.json``, ``stac/items.json``, the items and ``survey.vpc``."""
    clouds = [*delivery.clouds, *delivery.reprojected]
    ids = _item_ids([*(one.href for one in clouds), *delivery.rasters])
    items = [_cloud_item(ids[one.href], one, delivery) for one in clouds]
    items += [_raster_item(ids[href], href, delivery) for href in delivery.rasters]
    folder = delivery.output / STAC
    written = {folder / f"{item['id']}.json": _text(item) for item in items}
    features = ",\n".join(written.values())
    texts = {
        folder / "collection.json": _text(_collection(delivery, items)),
        folder / "items.json": f'{{"type": "FeatureCollection", "features": [\n{features}\n]}}',
        **written,
    }
    # One layer shows each point once: clouds in another CRS are left out.
    virtual = [_virtual(*one, delivery.crs) for one in zip(delivery.clouds, items, strict=False)]
    texts[delivery.output / VIRTUAL] = _text({"type": "FeatureCollection", "features": virtual})
    for path, text in texts.items():
        # Thousands of items, and a receipt that knows their sizes: a disk's time for each is saved.
        write_bytes(path, f"{text}\n".encode(), durable=False)
    return list(texts)


def _collection(delivery: Delivery, items: Sequence[Record]) -> Record:
    boxes = [item["bbox"] for item in items]
    flat = [box if len(box) == 4 else [*box[:2], *box[3:5]] for box in boxes]
    west, south, east, north = zip(*flat, strict=True)
    licence = delivery.survey.licence
    is_url = licence is not None and "://" in licence
    return {
        "type": "Collection",
        "id": _slug(delivery.name),
        "stac_version": "1.1.0",
        "description": f"Classified clouds and rasters of the lidar survey {delivery.name}.",
        "links": [
            _link("root"),
            *(_link("item", f"{item['id']}.json", "application/geo+json") for item in items),
            *([{"rel": "license", "href": licence}] if is_url else []),
        ],
        "title": delivery.name,
        "extent": {
            "spatial": {"bbox": [[min(west), min(south), max(east), max(north)]]},
            "temporal": {"interval": [_moments(delivery.span_s)]},
        },
        "license": "other" if licence is None or is_url else licence,
        "providers": [
            *_producer(delivery.survey),
            {"name": SOFTWARE, "roles": ["processor"]},
        ],
    }


def _link(rel: str, name: str = "collection.json", kind: str = "application/json") -> Record:
    return {"rel": rel, "href": f"./{name}", "type": kind}


def _moments(span_s: Span | None) -> list[str]:
    """First and last moment in UTC; where no time is known, that in which GPS time begins."""
    found = [GPS_EPOCH, GPS_EPOCH]
    if span_s is not None:
        since_s = (end + ADJUSTED_STANDARD_OFFSET_S - leap_seconds(end) for end in span_s)
        found = [GPS_EPOCH + dt.timedelta(seconds=s) for s in since_s]
    return [time.isoformat().replace("+00:00", "Z") for time in found]


def _producer(survey: SurveySettings) -> list[Record]:
    """Who delivers, as far as it is known."""
    contact = survey.contact
    name = survey.organisation or contact
    if name is None:
        return []
    words = {} if contact is None else {"description": f"Contact: {plain(contact)}"}
    return [{"name": plain(name), **words, "roles": ["producer"]}]


def _virtual(cloud: Cloud, record: Record, crs: CRS) -> Record:
    """Item of a cloud as readers of virtual point clouds want it."""
    properties = {k: v for k, v in record["properties"].items() if k != "proj:code"}
    code = crs.to_epsg()
    return {
        **record,
        "stac_version": "1.0.0",
        "stac_extensions": [POINT_CLOUD, VIRTUAL_PROJECTION],
        "properties": {
            **properties,
            "datetime": properties["start_datetime"],
            **({"proj:epsg": code} if code is not None else {}),
        },
        "links": [],
        "assets": {"data": {"href": f"./{cloud.href}", "roles": ["data"]}},
    }


def _text(content: Any) -> str:
    return json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False)


def _slug(name: str) -> str:
    kept = "".join(c if c.isalnum() or c in "-_" else "-" for c in name.lower())
    return kept.strip("-") or "survey"


def _cloud_item(name: str, cloud: Cloud, delivery: Delivery) -> Record:
    low, high = cloud.bounds[2], cloud.bounds[5]
    kind = COPC_TYPE if cloud.href.endswith(".copc.laz") else LAZ_TYPE
    made = cloud.href, cloud.box, cloud.crs
    item = _item(name, made, delivery, cloud.span_s, {"type": kind})
    heights_m = [end * cloud.units.vertical_m for end in (low, high)]
    item["bbox"] = _with_heights(item["bbox"], heights_m)
    item["stac_extensions"].append(POINT_CLOUD)
    item["properties"] |= {
        "proj:bbox": _with_heights(cloud.box, (low, high)),
        "pc:count": cloud.points,
        "pc:type": "lidar",
        "pc:encoding": "LASzip",
        "pc:schemas": [{"name": n, "size": size, "type": k} for n, size, k in cloud.dimensions],
        "pc:density": cloud.per_m2,
        "pc:statistics": [
            {"name": axis, "minimum": cloud.bounds[k], "maximum": cloud.bounds[k + 3]}
            for k, axis in enumerate("XYZ")
        ],
    }
    return item


def _raster_item(name: str, href: str, delivery: Delivery) -> Record:
    with opened(delivery.output / href) as source:
        bounds, shape, cell = source.bounds, source.shape, float(source.transform.a)
        *_, cell_m = place_m(source)
        meaning, unit = source.descriptions[0] or href, source.units[0] or ""
        crs = CRS.from_wkt(source.crs.to_wkt()) if source.crs else None
    asset = {"type": COG_TYPE, "title": meaning, **({"unit": unit} if unit else {})}
    item = _item(name, (href, tuple(bounds), crs), delivery, delivery.span_s, asset)
    item["properties"] |= {
        "title": meaning,
        "gsd": cell_m,
        "proj:shape": list(shape),
        "proj:transform": [cell, 0.0, bounds.left, 0.0, -cell, bounds.top],
    }
    return item


def _item(
    name: str,
    made: tuple[str, Box, CRS | None],
    delivery: Delivery,
    span_s: Span | None,
    asset: Record,
) -> Record:
    """What items of clouds and of rasters have in common; ``made``: path, box and CRS of one."""
    href, box, own = made
    crs = delivery.crs_of(own)
    authority, (first, last) = crs.to_authority(), _moments(span_s)
    return {
        "type": "Feature",
        "stac_version": "1.1.0",
        "stac_extensions": [PROJECTION],
        "id": name,
        "geometry": outline(box, crs),
        "bbox": list(box_deg(box, crs)),
        "properties": {
            "datetime": None,
            "start_datetime": first,
            "end_datetime": last,
            "proj:code": ":".join(authority) if authority else None,
            "proj:wkt2": crs.to_wkt("WKT2_2019"),
            "proj:geometry": outline(box),
            "proj:bbox": list(box),
        },
        "links": [_link(rel) for rel in ("root", "parent", "collection")],
        "assets": {"data": {"href": f"../{href}", **asset, "roles": ["data"]}},
        "collection": _slug(delivery.name),
    }


def _with_heights(box: Sequence[float], heights: Sequence[float]) -> list[float]:
    west, south, east, north = box
    return [west, south, heights[0], east, north, heights[1]]
