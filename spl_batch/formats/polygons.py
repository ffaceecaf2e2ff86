"""Areas of interest and water: polygons of any vector format, in the survey's CRS."""

from pathlib import Path
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray
from pyproj import CRS, Transformer
from pyproj.exceptions import CRSError, ProjError

from spl_batch.constants import QUANTA_PER_M
from spl_batch.errors import InputError
from spl_batch.formats.crs import crs_name, horizontal, same_crs
from spl_batch.formats.gdal_files import refuse_referring
from spl_batch.formats.vector_layers import POLYGONS, read_layers


def read_polygons(path: Path, crs: CRS | None) -> shapely.Geometry:
    """All polygons of a file as one valid geometry: prepared for :func:`contains`.

    Parameters
    ----------
    path : Path
        Any vector format that GDAL reads; every layer is taken.
    crs : CRS or None
        CRS of the result; none is only good for a file without a CRS.

    Raises
    ------
    InputError
        As :func:`check_polygons`.
    """
    area = shapely.union_all(check_polygons(path, crs))
    shapely.prepare(area)
    return area


def check_polygons(path: Path, crs: CRS | None) -> NDArray[Any]:
    """Read all polygons of a file, and refuse one that a run could not use.

    Returns
    -------
    (n,) ndarray of Geometry
        Each valid, in ``crs``; they may overlap.

    Raises
    ------
    InputError
        If the file is missing, no vector file, has no polygons or no CRS, or one that is damaged.
    """
    if not path.exists():
        raise InputError(str(path), "no such file; check the path")
    refuse_referring(path)
    parts = [
        in_crs(path, shapely.force_2d(layer.shapes), layer.crs, crs)
        for layer in read_layers(path, POLYGONS)
    ]
    shapes = shapely.make_valid(np.concatenate(parts)) if parts else np.empty(0, object)
    if not shapely.area(shapes).any():
        raise InputError(str(path), "holds no polygons; draw at least one or remove the key")
    return shapes


def in_crs(
    path: Path, shapes: NDArray[Any], own: str | None, crs: CRS | None, *, heights: bool = False
) -> NDArray[Any]:
    """Shapes of a file in another CRS.

    Parameters
    ----------
    shapes : (n,) ndarray of Geometry
        What it holds.
    heights : bool
        Whether heights are kept, as they are.

    Raises
    ------
    InputError
        If one of both has no CRS, or they cannot be transformed.
    """
    if own is None and crs is None:
        return shapes
    if own is None:
        raise InputError(str(path), "has no CRS; write one into it, e.g. with ogr2ogr -a_srs")
    try:
        source = CRS.from_user_input(own)
    except CRSError:
        raise InputError(str(path), f"its CRS {own!r} is not known; write another") from None
    if crs is None:
        raise InputError(
            str(path), f"is in {crs_name(source)}, the survey has no CRS: name it in survey.crs"
        )
    if same_crs(source, crs):
        return shapes
    transformer = Transformer.from_crs(horizontal(source), horizontal(crs), always_xy=True)

    def move(xyz: NDArray[np.float64]) -> NDArray[np.float64]:
        xy = transformer.transform(xyz[:, 0], xyz[:, 1], errcheck=True)
        return np.column_stack([*xy, xyz[:, 2:]])

    try:
        moved: NDArray[Any] = shapely.transform(shapes, move, include_z=heights)
    except ProjError:
        raise InputError(
            str(path),
            f"cannot be transformed from {crs_name(source)} to {crs_name(crs)}; check the order of "
            "its axes",
        ) from None
    return moved


def contains(
    geometry: shapely.Geometry, x: NDArray[np.int64], y: NDArray[np.int64]
) -> NDArray[np.bool_]:
    """Which points lie inside a geometry: (n,) bool, points on the boundary are outside.

    Parameters
    ----------
    geometry : Geometry
        From :func:`read_polygons`.
    x, y : (n,) int64
        Coordinates [quanta].
    """
    west, south, east, north = shapely.bounds(geometry) * QUANTA_PER_M
    # Most points lie far from a small lake; this says so quickly.
    near = np.flatnonzero((x >= west) & (x <= east) & (y >= south) & (y <= north))
    mask = np.zeros(len(x), np.bool_)
    mask[near] = shapely.contains_xy(geometry, x[near] / QUANTA_PER_M, y[near] / QUANTA_PER_M)
    return mask
