"""ISO 19115 metadata of a delivery, as ISO 19139 XML by a template."""

from pathlib import Path
from typing import Final

from jinja2 import Environment, PackageLoader, StrictUndefined

from spl_batch import __version__
from spl_batch.airborne.catalogue.delivered_files import Delivery
from spl_batch.formats.files.atomic import write_bytes

NAME: Final = "metadata.xml"
"""File below the output. Who answers for the data fills in the contact."""


def write_metadata(output: Path, delivery: Delivery) -> Path:
    """Write ``metadata.xml``."""
    boxes = [cloud.box_m for cloud in delivery.clouds]
    boxes += [raster.box_m for raster in delivery.rasters]
    whole = (
        min(b[0] for b in boxes), min(b[1] for b in boxes),
        max(b[2] for b in boxes), max(b[3] for b in boxes),
    )  # fmt: skip
    authority = delivery.crs.to_authority()
    environment = Environment(
        loader=PackageLoader(__package__, "."), autoescape=True, undefined=StrictUndefined
    )
    text = environment.get_template("metadata.xml.j2").render(
        name=delivery.name,
        span=delivery.span,
        crs_code=":".join(authority) if authority else "",
        crs_name=delivery.crs.name,
        clouds=len(delivery.clouds),
        points=sum(cloud.points for cloud in delivery.clouds),
        rasters=len(delivery.rasters),
        box=[f"{value:.7f}" for value in delivery.box_deg(whole)],
        software=f"spl-batch {__version__}",
    )
    path = output / NAME
    write_bytes(path, f"{text}\n".encode())
    return path
