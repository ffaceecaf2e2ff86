"""Polygons with names, such as a client's tiles: no two have the same name or share an area.

A point belongs to the one that it lies in. Areas own their western and southern edges, so that a
point on a line that two share belongs to one of them. It is looked up in the unit of its file, in
which a client's whole feet are whole.
"""

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray
from pyproj import CRS

from spl_batch.errors import InputError, named
from spl_batch.formats.vector_files import POLYGONS, read_layers

SLIVER_M: Final = 0.001
"""Half the width of an overlap that rounding explains; it belongs to the first area [m]."""

NUDGE: Final = (1e-6, 3e-7)
"""By so much a point is moved east and north before it is looked up, off all edges [m or ft]: more
than rounding of coordinates, and less than any scale of a cloud."""

_FILE_NAME: Final = re.compile(r"(?!.*\.$)\w[\w .+()-]{0,99}(?<! )")
"""Names that every file system takes."""


class NamedArea(NamedTuple):
    """An area."""

    name: str
    shape: shapely.Geometry  #: In the survey's CRS, as metres.


def read_named_areas(path: Path, crs: CRS | None, field: str) -> list[NamedArea]:
    """Polygons of a file, in its order, named by a field.

    Parameters
    ----------
    path : Path
        Any vector format that GDAL reads; every layer with polygons is taken.
    crs : CRS or None
        CRS of the result; none is only good for a file without a CRS.
    field : str
        Column with names that files can have.

    Raises
    ------
    InputError
        If there are none, one has no name for a file or that of another, or two overlap.
    """
    found: list[NamedArea] = []
    for layer in read_layers(path, POLYGONS, crs, fields=True):
        if field.lower() not in layer.fields:
            there = named(sorted(layer.fields), 20) or "none"
            raise InputError(
                str(path),
                f"layer {layer.name} has no field {field!r} with names; there is {there}: set "
                "outputs.client_tiles.name",
            )
        names = map(_name, layer.fields[field.lower()])
        found += map(NamedArea, names, shapely.make_valid(layer.shapes))
    if faults := list(_faults(found, field)):
        raise InputError(str(path), faults)
    return _apart(path, found)


def _name(value: Any) -> str:
    """Text of a field; numbers without a fraction as whole ones."""
    number = isinstance(value, float | np.floating) and float(value).is_integer()
    missing = value is None or value != value  # noqa: PLR0124 - NaN, of a whole number
    return "" if missing else str(int(value) if number else value).strip()


def _faults(areas: Sequence[NamedArea], field: str) -> Iterator[str]:
    if not areas:
        yield "holds no polygons; draw at least one or remove the key"
    names = [one.name for one in areas]
    if wrong := [name for name in names if not _FILE_NAME.fullmatch(name)]:
        shown = named([repr(name) for name in wrong])
        yield f"field {field!r}: {shown} cannot be names of files: use letters, digits, - and _"
    folded = Counter(name.casefold() for name in names)
    if twice := sorted({name for name in names if folded[name.casefold()] > 1}):
        yield f"field {field!r}: {named(twice)} name several polygons: give each another name"


def _apart(path: Path, areas: Sequence[NamedArea]) -> list[NamedArea]:
    """Areas without slivers that earlier ones have; InputError where two overlap."""
    shapes: NDArray[Any] = np.array([one.shape for one in areas], object)
    pairs = shapely.STRtree(shapes).query(shapes, "intersects")
    first, second = pairs[:, pairs[0] < pairs[1]]
    common = shapely.intersection(shapes[first], shapes[second])
    wide = ~shapely.is_empty(shapely.buffer(common, -SLIVER_M))
    if wide.any():
        both = [
            f"{areas[a].name} and {areas[b].name}"
            for a, b in zip(first[wide].tolist(), second[wide].tolist(), strict=True)
        ]
        text = f"polygons overlap: {named(both)}; a point belongs to one tile: cut one of both"
        raise InputError(str(path), text)
    narrow = shapely.area(common) > 0
    for a, b in zip(first[narrow].tolist(), second[narrow].tolist(), strict=True):
        shapes[b] = shapely.difference(shapes[b], shapes[a])
    return [NamedArea(one.name, shape) for one, shape in zip(areas, shapes, strict=True)]


def lies_in(
    shape: shapely.Geometry, x: NDArray[np.float64], y: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Which points an area owns: (n,) bool.

    Parameters
    ----------
    shape : Geometry
        Of a :class:`NamedArea`, prepared.
    x, y : (n,)
        Coordinates, in the unit of the shape.
    """
    east, north = NUDGE
    inside: NDArray[np.bool_] = shapely.contains_xy(shape, x + east, y + north)
    return inside
