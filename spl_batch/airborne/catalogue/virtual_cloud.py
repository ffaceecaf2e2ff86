"""Virtual point cloud: all clouds as one layer, in the form that PDAL wrench and QGIS read.

Source: the VPC specification of PDAL wrench: a GeoJSON file of STAC items. Readers take STAC 1.0.0
alone, with point cloud 1.0.0 and projection 1.1.0, want ``proj:wkt2``, ``proj:geometry`` and a
``proj:bbox`` of six numbers, and take the first asset of an item for the cloud.
"""

import json
from pathlib import Path
from typing import Any, Final

from spl_batch.airborne.catalogue.delivered_files import Cloud, Delivery, outline
from spl_batch.formats.files.atomic import write_bytes

NAME: Final = "survey.vpc"
"""File below the output."""

EXTENSIONS: Final = (
    "https://stac-extensions.github.io/pointcloud/v1.0.0/schema.json",
    "https://stac-extensions.github.io/projection/v1.1.0/schema.json",
)


def write_vpc(output: Path, delivery: Delivery) -> Path:
    """Write ``survey.vpc``."""
    content = {
        "type": "FeatureCollection",
        "features": [_feature(cloud, delivery) for cloud in delivery.clouds],
    }
    path = output / NAME
    text = json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False)
    write_bytes(path, f"{text}\n".encode())
    return path


def _feature(cloud: Cloud, delivery: Delivery) -> dict[str, Any]:
    west, south, east, north = delivery.box_deg(cloud.box_m)
    low_m, high_m = cloud.bounds_m[2], cloud.bounds_m[5]
    code = delivery.crs.to_epsg()
    return {
        "type": "Feature",
        "stac_version": "1.0.0",
        "stac_extensions": list(EXTENSIONS),
        "id": cloud.name,
        "geometry": delivery.outline_deg(cloud.box_m),
        "bbox": [west, south, low_m, east, north, high_m],
        "properties": {
            "datetime": cloud.span.first.isoformat().replace("+00:00", "Z"),
            "pc:count": cloud.points,
            "pc:encoding": "LASzip",
            "pc:type": "lidar",
            "pc:density": cloud.per_m2,
            "pc:schemas": [
                {"name": name, "size": size, "type": kind} for name, size, kind in cloud.dimensions
            ],
            **({"proj:epsg": code} if code is not None else {}),
            "proj:wkt2": delivery.crs.to_wkt("WKT2_2019"),
            "proj:geometry": outline(cloud.box_m),
            "proj:bbox": list(cloud.bounds_m),
        },
        "links": [],
        "assets": {"data": {"href": f"./{cloud.href}", "roles": ["data"]}},
    }
