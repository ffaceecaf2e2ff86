"""STAC 1.1: a collection with an item for each cloud and raster, and a virtual point cloud.

Sources: STAC 1.1.0; extensions point cloud 1.0.0 and projection 2.0.0, by pystac; the VPC
specification of PDAL wrench, a GeoJSON file of the clouds' items whose readers take STAC 1.0.0 with
projection 1.1.0 alone. All links are relative, so that the folder can be moved.
"""

import hashlib
import json
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import pystac
from pyproj import CRS
from pystac.extensions.pointcloud import (
    PhenomenologyType,
    PointcloudExtension,
    Schema,
    SchemaType,
    Statistic,
)
from pystac.extensions.projection import ProjectionExtension

from spl_batch.airborne.catalogue.delivered_files import (
    STAC,
    VIRTUAL,
    Box,
    Cloud,
    Delivery,
    Publisher,
    RasterFile,
    box_deg,
    outline,
    outline_deg,
    plain_name,
)
from spl_batch.errors import plain
from spl_batch.formats.files.atomic import write_bytes

LONGEST_ID: Final = 200
"""Of an item: file systems allow names of 255 bytes [byte]."""

COG_TYPE: Final = "image/tiff; application=geotiff; profile=cloud-optimized"
LAZ_TYPE: Final = "application/vnd.laszip"
COPC_TYPE: Final = "application/vnd.laszip+copc"
SOFTWARE: Final = "spl-batch"

VIRTUAL_EXTENSIONS: Final = (
    "https://stac-extensions.github.io/pointcloud/v1.0.0/schema.json",
    "https://stac-extensions.github.io/projection/v1.1.0/schema.json",
)


def _item_ids(hrefs: Sequence[str]) -> dict[str, str]:
    """A name for the item of each file, which is a file's name as well.

    Names that are too long for that, or would be those of two files, end in a hash.
    """
    plain = {href: plain_name(href) for href in hrefs}
    taken = Counter(name.casefold() for name in plain.values())
    return {
        href: name
        if taken[name.casefold()] == 1 and len(name.encode()) <= LONGEST_ID
        else _short_id(name, href)
        for href, name in plain.items()
    }


def _short_id(name: str, href: str) -> str:
    start = name.encode()[: LONGEST_ID - 17].decode(errors="ignore")
    return f"{start}-{hashlib.blake2b(href.encode(), digest_size=8).hexdigest()}"


def write_stac(output: Path, delivery: Delivery) -> list[Path]:
    """Write ``stac/collection.json``, ``stac/items.json``, the items and ``survey.vpc``."""
    clouds = [*delivery.clouds, *delivery.reprojected]
    ids = _item_ids([one.href for one in clouds] + [one.href for one in delivery.rasters])
    items = [_cloud_item(ids[one.href], one, delivery) for one in clouds]
    items += [_raster_item(ids[one.href], one, delivery) for one in delivery.rasters]
    boxes = [list(item.bbox or ()) for item in items]
    flat = [box if len(box) == 4 else [*box[:2], *box[3:5]] for box in boxes]
    whole = [
        min(b[0] for b in flat), min(b[1] for b in flat),
        max(b[2] for b in flat), max(b[3] for b in flat),
    ]  # fmt: skip
    collection = pystac.Collection(
        id=_slug(delivery.name),
        title=delivery.name,
        description=f"Classified clouds and rasters of the lidar survey {delivery.name}.",
        extent=pystac.Extent(
            pystac.SpatialExtent([whole]), pystac.TemporalExtent([list(delivery.span)])
        ),
        license=_licence(delivery.publisher),
        providers=[
            *_producer(delivery.publisher),
            pystac.Provider(SOFTWARE, roles=[pystac.ProviderRole.PROCESSOR]),
        ],
    )
    folder = output / STAC
    for item in items:
        item.collection_id = collection.id
        item.links = [
            pystac.Link("root", "./collection.json", "application/json"),
            pystac.Link("parent", "./collection.json", "application/json"),
            pystac.Link("collection", "./collection.json", "application/json"),
        ]
        collection.links.append(pystac.Link("item", f"./{item.id}.json", "application/geo+json"))
    collection.links = [link for link in collection.links if link.rel != "root"]
    collection.links.insert(0, pystac.Link("root", "./collection.json", "application/json"))
    if (licence := delivery.publisher.licence) and _is_url(licence):
        collection.links.append(pystac.Link("license", licence))
    # Links are as they stand: nothing is to be resolved, or made absolute.
    records = [item.to_dict(include_self_link=False, transform_hrefs=False) for item in items]
    written = {folder / f"{record['id']}.json": _text(record) for record in records}
    features = ",\n".join(written.values())
    of_collection = collection.to_dict(include_self_link=False, transform_hrefs=False)
    texts = {
        folder / "collection.json": _text(of_collection),
        folder / "items.json": f'{{"type": "FeatureCollection", "features": [\n{features}\n]}}',
        **written,
    }
    # One layer shows each point once: clouds in another CRS are left out.
    virtual = [_virtual(*one, delivery.crs) for one in zip(delivery.clouds, records, strict=False)]
    texts[output / VIRTUAL] = _text({"type": "FeatureCollection", "features": virtual})
    for path, text in texts.items():
        # Thousands of items, and a receipt that knows their sizes: a disk's time for each is saved.
        write_bytes(path, f"{text}\n".encode(), durable=False)
    return list(texts)


def _is_url(licence: str) -> bool:
    return "://" in licence


def _licence(publisher: Publisher) -> str:
    """What STAC takes; a URL is a link beside it."""
    known = publisher.licence is not None and not _is_url(publisher.licence)
    return str(publisher.licence) if known else "other"


def _producer(publisher: Publisher) -> list[pystac.Provider]:
    """Who delivers, as far as it is known."""
    name = publisher.organisation or publisher.contact
    if name is None:
        return []
    contact = None if publisher.contact is None else f"Contact: {plain(publisher.contact)}"
    return [pystac.Provider(plain(name), contact, [pystac.ProviderRole.PRODUCER])]


def _virtual(cloud: Cloud, record: dict[str, Any], crs: CRS) -> dict[str, Any]:
    """Item of a cloud as readers of virtual point clouds want it."""
    properties = {k: v for k, v in record["properties"].items() if k != "proj:code"}
    code = crs.to_epsg()
    return {
        **record,
        "stac_version": "1.0.0",
        "stac_extensions": list(VIRTUAL_EXTENSIONS),
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


def _cloud_item(name: str, cloud: Cloud, delivery: Delivery) -> pystac.Item:
    crs = delivery.crs_of(cloud)
    west, south, east, north = box_deg(cloud.box, crs)
    ends = cloud.bounds[2], cloud.bounds[5]
    low_m, high_m = (end * cloud.units.vertical_m for end in ends)
    item = pystac.Item(
        id=name,
        geometry=outline_deg(cloud.box, crs),
        bbox=[west, south, low_m, east, north, high_m],
        datetime=None,
        properties={},
        start_datetime=cloud.span.first,
        end_datetime=cloud.span.last,
    )
    kind = COPC_TYPE if cloud.href.endswith(".copc.laz") else LAZ_TYPE
    item.add_asset("data", pystac.Asset(f"../{cloud.href}", media_type=kind, roles=["data"]))
    _project(item, crs, cloud.box, ends)
    PointcloudExtension.ext(item, add_if_missing=True).apply(
        count=cloud.points,
        type=PhenomenologyType.LIDAR,
        encoding="LASzip",
        schemas=[Schema.create(n, size, SchemaType(kind)) for n, size, kind in cloud.dimensions],
        density=cloud.per_m2,
        statistics=[
            # create() writes null for what is not given, which the extension's schema refuses.
            Statistic({"name": axis, "minimum": cloud.bounds[k], "maximum": cloud.bounds[k + 3]})
            for k, axis in enumerate("XYZ")
        ],
    )
    return item


def _raster_item(name: str, raster: RasterFile, delivery: Delivery) -> pystac.Item:
    crs = delivery.crs_of(raster)
    item = pystac.Item(
        id=name,
        geometry=outline_deg(raster.box, crs),
        bbox=list(box_deg(raster.box, crs)),
        datetime=None,
        properties={"title": raster.meaning, "gsd": raster.cell_m},
        start_datetime=delivery.span.first,
        end_datetime=delivery.span.last,
    )
    asset = pystac.Asset(
        f"../{raster.href}", title=raster.meaning, media_type=COG_TYPE, roles=["data"]
    )
    if raster.unit:
        asset.extra_fields["unit"] = raster.unit
    item.add_asset("data", asset)
    _project(item, crs, raster.box)
    west, _, _, north = raster.box
    found = ProjectionExtension.ext(item)
    found.shape = list(raster.shape)
    found.transform = [raster.cell, 0.0, west, 0.0, -raster.cell, north]
    return item


def _project(
    item: pystac.Item,
    crs: CRS,
    box: Box,
    heights: tuple[float, float] | None = None,
) -> None:
    authority = crs.to_authority()
    west, south, east, north = box
    bounds = [west, south, east, north]
    if heights is not None:
        bounds = [west, south, heights[0], east, north, heights[1]]
    ProjectionExtension.ext(item, add_if_missing=True).apply(
        code=":".join(authority) if authority else None,
        wkt2=crs.to_wkt("WKT2_2019"),
        geometry=outline(box),
        bbox=bounds,
    )
