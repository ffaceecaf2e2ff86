"""Vector files that GDAL reads: layers of shapes, polygons of areas of interest and water.

GDAL gives nothing in place of a geometry that it cannot decode, without a warning. A lake that
is lost so would be land, so a damaged shape is refused by its number. GDAL distinguishes formats by
their first bytes, whatever a file is called, and some hold no content but the names of other files,
of services, or of commands that make it: these are refused.
"""

import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray
from pyproj import CRS
from pyproj.exceptions import CRSError, ProjError

from spl_batch.constants import QUANTA_PER_M
from spl_batch.errors import InputError, as_input_fault, named
from spl_batch.formats.crs import no_survey_crs, same_crs
from spl_batch.formats.heights import heights_fault
from spl_batch.formats.las.header import open_input
from spl_batch.formats.transformations import kept_degrees, shape_transformers
from spl_batch.formats.units import Units

COORDINATE_MAX: Final = 1e9
"""No projection has coordinates beyond, in metres, feet or degrees."""

POLYGONS: Final = (shapely.GeometryType.POLYGON, shapely.GeometryType.MULTIPOLYGON)
POINTS: Final = (shapely.GeometryType.POINT, shapely.GeometryType.MULTIPOINT)
LINES: Final = (shapely.GeometryType.LINESTRING, shapely.GeometryType.MULTILINESTRING)

_REFERRING: Final = (b"<ogr", b"<vrtdataset", b"wfs_capabilities", b"gdal_streamed_alg", b"<gdal")
"""Words at the start of a file whose content lies elsewhere, in lower case."""

_HEAD_BYTES: Final = 1 << 16
"""Start of a file that is looked at; GDAL looks at no more to know such formats [byte]."""

_REMEDY: Final = "write a CRS that does into it, e.g. with ogr2ogr -a_srs"
"""What states the unit of heights in a file of shapes; a code follows."""

Geometries = NDArray[Any]


class Layer(NamedTuple):
    """A layer that holds shapes."""

    name: str
    kind: str  #: Type of geometry that it declares.
    fids: NDArray[Any]  #: Numbers of its features.
    shapes: Geometries  #: None where there is no geometry that can be decoded.
    fields: dict[str, NDArray[Any]]  #: Columns by name in lower case, if they were asked for.
    crs: str | None


def refuse_referring(path: Path, *, raster: bool = False) -> None:
    """Refuse a file that names others in place of content; folders are none.

    ``raster``: whether it is to hold cells, which no XML or JSON does.

    Raises
    ------
    InputError
        If it is one, or cannot be opened.
    """
    if path.is_dir():
        return
    with open_input(path) as file:
        head = file.read(_HEAD_BYTES).lower()
    text = raster and head.removeprefix(b"\xef\xbb\xbf").lstrip()[:1] in {b"<", b"{"}
    if text or any(word in head for word in _REFERRING):
        what = "cells" if raster else "shapes"
        remedy = "GeoTIFF (gdal_translate)" if raster else "GeoPackage (ogr2ogr)"
        raise InputError(
            str(path),
            f"holds no {what} but names where GDAL finds some, in another file, a service or a"
            f" pipeline: write what it names to a {remedy}",
        )


def all_layers(path: Path, *, fields: bool) -> Iterator[Layer]:
    """Layers of a file that hold shapes, whatever these are; InputError where it cannot be read."""
    import pyogrio  # noqa: PLC0415 - 28 MiB of every worker, and few read such files

    refuse_referring(path)
    with _as_one_line(path):
        names = [(name, kind) for name, kind in pyogrio.list_layers(path) if kind is not None]
    for name, kind in names:
        with _as_one_line(path):
            meta, fids, wkb, columns = pyogrio.raw.read(
                path, layer=name, columns=None if fields else [], return_fids=True
            )
            shapes = shapely.from_wkb([] if wkb is None else wkb, on_invalid="ignore")
        pairs = zip(meta["fields"], columns, strict=True)
        values = {str(field).lower(): column for field, column in pairs}
        yield Layer(name, kind, fids, shapes, values, meta["crs"])


def read_layers(
    path: Path,
    kinds: Sequence[int],
    crs: CRS | None,
    *,
    fields: bool = False,
    heights: bool = False,
) -> Iterator[Layer]:
    """Layers that hold shapes of some kinds, and of each only these, in metres.

    Parameters
    ----------
    path : Path
        Any vector format that GDAL reads.
    kinds : sequence of int
        Types of geometry that are wanted. Layers of others are left out, and points; lines and
        collections among polygons, unless wanted, are faults: they may be meant as areas.
    crs : CRS or None
        CRS on whose axes shapes are wanted; none is only good for a file without a CRS.
    fields, heights : bool
        Whether columns are read, and whether vertices keep their heights, in that CRS's unit.

    Raises
    ------
    InputError
        If the file cannot be read, or a shape is missing, damaged or nowhere on Earth; if one of
        the two has no CRS, or shapes cannot be transformed; if heights that are kept are in another
        unit or above another datum, or nothing states their unit.
    """
    for layer in all_layers(path, fields=fields):
        chosen = np.isin(shapely.get_type_id(layer.shapes), kinds) & ~shapely.is_empty(layer.shapes)
        faults = [
            f"feature {named(layer.fids[bad].tolist(), 3)}: {what}"
            for what, bad in _faults(layer, chosen, kinds).items()
            if bad.any()
        ]
        if faults:
            text = f"layer {layer.name}: {'; '.join(faults)}: mend or delete it, or copy it again"
            raise InputError(str(path), text)
        if chosen.any():
            shapes = layer.shapes[chosen] if heights else shapely.force_2d(layer.shapes[chosen])
            shapes = _in_crs(path, shapes, layer.crs, crs, heights=heights)
            columns = {name: column[chosen] for name, column in layer.fields.items()}
            yield layer._replace(fids=layer.fids[chosen], shapes=shapes, fields=columns)


def _faults(
    layer: Layer, chosen: NDArray[np.bool_], kinds: Sequence[int]
) -> dict[str, NDArray[np.bool_]]:
    """What may be wrong with shapes of a layer, and with which; ``chosen``: those wanted."""
    types = shapely.get_type_id(layer.shapes)
    xy, owner = shapely.get_coordinates(layer.shapes, return_index=True)
    # A comparison with NaN is false.
    nowhere = owner[~(np.abs(xy) <= COORDINATE_MAX).all(axis=1)]
    # A layer of polygons by its declaration holds nothing else; one of no declared kind may hold
    # what is wanted, and points.
    declared = "Polygon" in layer.kind
    strange = ~np.isin(types, POLYGONS if declared else (*kinds, *POINTS))
    strange &= (types >= 0) & ~shapely.is_empty(layer.shapes)
    strange &= declared or np.isin(types[chosen], POLYGONS).any()
    return {
        "has no geometry that can be decoded": (types < 0) & ("Point" not in layer.kind),
        "is no polygon, in a layer of polygons": strange,
        "has a coordinate that is no number, or beyond 1e9": chosen
        & np.isin(np.arange(len(types)), nowhere),
    }


@contextmanager
def _as_one_line(path: Path) -> Iterator[None]:
    """Turn errors of GDAL, SQLite and shapely for a damaged file into one line.

    Their warnings are no lines for a screen: each shape is looked at.
    """
    with warnings.catch_warnings(), as_input_fault(path, "cannot be read as shapes"):
        warnings.simplefilter("ignore", RuntimeWarning)
        yield


def _in_crs(
    path: Path, shapes: Geometries, own: str | None, crs: CRS | None, *, heights: bool
) -> Geometries:
    """Shapes of a file in a CRS of its ``own`` on the axes of another one, in metres."""
    if own is None and crs is None:
        return shapes
    if own is None:
        raise InputError(str(path), "has no CRS; write one into it, e.g. with ogr2ogr -a_srs")
    try:
        source = CRS.from_user_input(own)
    except CRSError:
        raise InputError(str(path), f"its CRS {own!r} is not known; write another") from None
    if crs is None:
        raise InputError(str(path), no_survey_crs(source))
    if heights and (fault := heights_fault(source, crs, _REMEDY)):
        raise InputError(str(path), fault)
    units, known = Units.of(crs), same_crs(source, crs)
    if known and units.are_metres:
        return shapes

    def move(xyz: NDArray[np.float64]) -> NDArray[np.float64]:
        x, y = xyz[:, 0], xyz[:, 1]
        for step in [] if known else shape_transformers(source, crs):
            x, y = step.transform(x, y, errcheck=True)
        return units.metres(np.column_stack([x, y, xyz[:, 2:]]))

    try:
        moved: Geometries = shapely.transform(shapes, move, include_z=heights)
    except ProjError as error:
        raise InputError(
            str(path),
            f"cannot be transformed from {source.name} to {crs.name} ({error}): check the order of "
            "its axes, or write it in the survey's CRS",
        ) from None
    return moved


def shapes_keep_degrees(path: Path, crs: CRS | None) -> list[str]:
    """A sentence for each CRS of a file whose shapes keep their degrees for want of a grid."""
    import pyogrio  # noqa: PLC0415 - 28 MiB of every worker, and few read such files

    if crs is None:
        return []
    with _as_one_line(path):
        kinds = [(name, kind) for name, kind in pyogrio.list_layers(path) if kind is not None]
        shapes = [name for name, kind in kinds if "Point" not in kind]
        stated = {pyogrio.read_info(path, layer=name)["crs"] for name in shapes} - {None}
        own = [CRS.from_user_input(text) for text in sorted(stated)]
    return [way for one in own if (way := kept_degrees(one, crs))]


def check_polygons(path: Path, crs: CRS | None) -> Geometries:
    """Read all polygons of a file, and refuse one that a run could not use.

    Parameters
    ----------
    path : Path
        Any vector format that GDAL reads; every layer is taken.
    crs : CRS or None
        CRS whose axes the result has; none is only good for a file without a CRS.

    Returns
    -------
    (n,) ndarray of Geometry
        Each valid, in metres; they may overlap.

    Raises
    ------
    InputError
        If the file is missing, no vector file, has no polygons or no CRS, or one that is damaged.
    """
    parts = [layer.shapes for layer in read_layers(path, POLYGONS, crs)]
    shapes: Geometries = shapely.make_valid(np.concatenate([np.empty(0, object), *parts]))
    if not shapely.area(shapes).any():
        raise InputError(str(path), "holds no polygons; draw at least one or remove the key")
    return shapes


def read_polygons(path: Path, crs: CRS | None) -> shapely.Geometry:
    """All polygons of :func:`check_polygons` as one geometry, prepared for :func:`contains`."""
    area = shapely.union_all(check_polygons(path, crs))
    shapely.prepare(area)
    return area


def contains(
    geometry: shapely.Geometry, x: NDArray[np.number[Any]], y: NDArray[np.number[Any]]
) -> NDArray[np.bool_]:
    """Which points lie inside a geometry: (n,) bool, points on the boundary are outside.

    Parameters
    ----------
    geometry : Geometry
        From :func:`read_polygons`.
    x, y : (n,) number
        Coordinates [quanta].
    """
    west, south, east, north = shapely.bounds(geometry) * QUANTA_PER_M
    # Most points lie far from a small lake; this shows it quickly.
    near = np.flatnonzero((x >= west) & (x <= east) & (y >= south) & (y <= north))
    mask = np.zeros(len(x), np.bool_)
    mask[near] = shapely.contains_xy(geometry, x[near] / QUANTA_PER_M, y[near] / QUANTA_PER_M)
    return mask
