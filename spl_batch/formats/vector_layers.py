"""Layers of shapes in a vector file, each shape looked at: a damaged one is refused by its number.

GDAL gives nothing in place of a geometry that it cannot decode, and says nothing of it. A lake that
is lost so would be land, and a file of which nothing is left would blank a survey.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray

from spl_batch.errors import InputError, named
from spl_batch.formats.gdal_files import read_as

COORDINATE_MAX: Final = 1e9
"""No projection has coordinates beyond, in metres, feet or degrees."""

POLYGONS: Final = (shapely.GeometryType.POLYGON, shapely.GeometryType.MULTIPOLYGON)
POINTS: Final = (shapely.GeometryType.POINT, shapely.GeometryType.MULTIPOINT)
LINES: Final = (shapely.GeometryType.LINESTRING, shapely.GeometryType.MULTILINESTRING)

Geometries = NDArray[Any]
Mask = NDArray[np.bool_]


class Layer(NamedTuple):
    """Shapes of one layer, of the kinds that were asked for."""

    name: str
    shapes: Geometries  #: None is missing, and none is empty.
    fields: dict[str, NDArray[Any]]  #: Columns that were asked for, by name in lower case.
    crs: str | None


def read_layers(path: Path, kinds: Sequence[int], *, fields: bool = False) -> Iterator[Layer]:
    """Layers that hold such shapes, each read whole.

    Parameters
    ----------
    kinds : sequence of int
        Types of geometry that are wanted. Layers of others are left out, and points; lines and
        collections among polygons, unless wanted, are faults: they may be meant as areas.
    fields : bool
        Whether columns are read.

    Raises
    ------
    InputError
        If the file cannot be read, or a shape is missing, damaged or nowhere on Earth.
    """
    for name, kind in _layers(path):
        meta, fids, shapes, columns = _read(path, name, fields=fields)
        chosen = np.isin(shapely.get_type_id(shapes), kinds) & ~shapely.is_empty(shapes)
        faults = _faults(kind, shapes, chosen, kinds)
        if told := [f"feature {named(fids[bad].tolist(), 3)}: {x}" for x, bad in faults]:
            text = f"layer {name}: {'; '.join(told)}: mend or delete it, or copy the file again"
            raise InputError(str(path), text)
        if chosen.any():
            pairs = zip(meta["fields"], columns, strict=True)
            values = {str(field).lower(): column[chosen] for field, column in pairs}
            yield Layer(name, shapes[chosen], values, meta["crs"])


def _layers(path: Path) -> list[tuple[str, str]]:
    """Names and kinds of the layers that hold shapes."""
    import pyogrio  # noqa: PLC0415 - 28 MiB of every worker, and few read such files

    with read_as("shapes", path):
        return [(name, kind) for name, kind in pyogrio.list_layers(path) if kind is not None]


def _read(path: Path, layer: str, *, fields: bool) -> tuple[Any, Any, Geometries, Any]:
    """What GDAL knows of a layer, its features' numbers, their shapes and their columns."""
    import pyogrio  # noqa: PLC0415 - 28 MiB of every worker, and few read such files

    with read_as("shapes", path):
        meta, fids, wkb, columns = pyogrio.raw.read(
            path, layer=layer, columns=None if fields else [], return_fids=True
        )
        shapes = shapely.from_wkb([] if wkb is None else wkb, on_invalid="ignore")
    return meta, fids, shapes, columns


def _faults(
    kind: str, shapes: Geometries, chosen: Mask, kinds: Sequence[int]
) -> Iterator[tuple[str, Mask]]:
    """What is wrong with shapes of a layer, and with which; ``chosen``: those that are wanted."""
    types = shapely.get_type_id(shapes)
    xy, owner = shapely.get_coordinates(shapes, return_index=True)
    # A comparison with NaN is false.
    nowhere = owner[~(np.abs(xy) <= COORDINATE_MAX).all(axis=1)]
    there = (types >= 0) & ~shapely.is_empty(shapes)
    # A layer of polygons by its declaration holds nothing else; one of no declared kind may hold
    # what is wanted, and points.
    declared = "Polygon" in kind
    fitting = POLYGONS if declared else (*kinds, *POINTS)
    strange = there & ~np.isin(types, fitting)
    strange &= declared or np.isin(types[chosen], POLYGONS).any()
    faults = {
        "has no geometry that can be decoded": shapely.is_missing(shapes) & ("Point" not in kind),
        "is no polygon, in a layer of polygons": strange,
        "has a coordinate that is no number, or beyond 1e9": chosen
        & np.isin(np.arange(len(shapes)), nowhere),
    }
    return ((what, bad) for what, bad in faults.items() if bad.any())
