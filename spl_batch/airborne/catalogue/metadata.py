"""ISO 19115 metadata of a delivery, as ISO 19139 XML by a template.

The accuracy is that at checkpoints, where there are any.
"""

from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, Final, NamedTuple

from jinja2 import Environment, PackageLoader, StrictUndefined, Template
from pyproj import CRS

from spl_batch import __version__
from spl_batch.airborne.accuracy.checkpoint_errors import (
    ENOUGH,
    IN_FORCE,
    STANDARD,
    CheckpointError,
    at_checkpoints,
)
from spl_batch.airborne.catalogue.delivered_files import Delivery
from spl_batch.formats.crs import vertical
from spl_batch.formats.files.atomic import write_bytes

NAME: Final = "metadata.xml"
"""File below the output. Who answers for the data fills in the contact."""

KINDS: Final = (("open", "Non-vegetated (NVA)"), ("vegetated", "Vegetated (VVA)"))
"""Surfaces of checkpoints, and what the accuracy there is called."""


class Accuracy(NamedTuple):
    """Vertical accuracy at checkpoints of one kind."""

    name: str
    how: str  #: What it was found by.
    value_m: str


def write_metadata(
    output: Path,
    delivery: Delivery,
    checkpoints: Sequence[Mapping[str, Any]],
    flightlines: int,
    steps: Sequence[str],
) -> Path:
    """Write ``metadata.xml``.

    Parameters
    ----------
    checkpoints : sequence of mapping
        ``id, surface, error_m, accuracy_m`` of each.
    flightlines : int
        How many there are [count].
    steps : sequence of str
        What was done to the points, a sentence each.
    """
    boxes = [cloud.box_m for cloud in delivery.clouds]
    boxes += [raster.box_m for raster in delivery.rasters]
    whole = (
        min(b[0] for b in boxes), min(b[1] for b in boxes),
        max(b[2] for b in boxes), max(b[3] for b in boxes),
    )  # fmt: skip
    heights = [[cloud.bounds_m[k] for cloud in delivery.clouds] for k in (2, 5)]
    datum = vertical(delivery.crs)
    text = _template().render(
        name=delivery.name,
        span=delivery.span,
        systems=[*_systems(delivery.crs)],
        vertical_code=None if datum is None else datum.to_epsg(),
        clouds=len(delivery.clouds),
        points=sum(cloud.points for cloud in delivery.clouds),
        rasters=len(delivery.rasters),
        resolutions=[f"{m:g}" for m in sorted({raster.cell_m for raster in delivery.rasters})],
        flightlines=flightlines,
        box=[f"{value:.7f}" for value in delivery.box_deg(whole)],
        heights=[f"{min(heights[0]):.3f}", f"{max(heights[1]):.3f}"] if heights[0] else None,
        accuracies=[*_accuracies(checkpoints)],
        steps=steps,
        software=f"spl-batch {__version__}",
    )
    path = output / NAME
    write_bytes(path, f"{text}\n".encode())
    return path


@cache
def _template() -> Template:
    environment = Environment(
        loader=PackageLoader(__package__, "."), autoescape=True, undefined=StrictUndefined,
        trim_blocks=True,
    )  # fmt: skip
    return environment.get_template("metadata.xml.j2")


def _systems(crs: CRS) -> Iterator[tuple[str, str]]:
    """Code and authority of a CRS, or of the parts of one that has no code; else its name."""
    known = crs.to_authority()
    if known:
        yield known[1], known[0]
    elif crs.is_compound:
        for part in crs.sub_crs_list:
            yield from _systems(part)
    else:
        yield crs.name, ""


def _accuracies(checkpoints: Sequence[Mapping[str, Any]]) -> Iterator[Accuracy]:
    for surface, name in KINDS:
        found = at_checkpoints(
            [
                CheckpointError(one["id"], one["error_m"], one["accuracy_m"])
                for one in checkpoints
                if one["surface"] == surface and one["error_m"] is not None
            ]
        )
        if found.rmse_v1_m is None:
            continue
        how = f"Terrain model against {found.n} {surface} checkpoints; {STANDARD}, {IN_FORCE}"
        few = "" if found.n >= ENOUGH else f"; {ENOUGH} are needed for a statement"
        if found.rmse_v_m is None:
            what, value = "fit, RMSE_V1", found.rmse_v1_m
            few += "; the checkpoints' own accuracy is not known"
        else:
            what, value = "RMSE_V", found.rmse_v_m
        yield Accuracy(f"{name} vertical accuracy, {what}", f"{how}{few}.", f"{value:.4f}")
