"""Transformations between CRS: the best one that PROJ knows, or none.

Shapes alone may keep their degrees where PROJ lacks the grids of that one: polygons of agencies are
in NAD83 beside surveys in a later realisation of it, and EPSG states how accurate that is.
"""

import warnings
from functools import lru_cache
from typing import Final

from pyproj import CRS, Transformer
from pyproj.exceptions import ProjError
from pyproj.transformer import TransformerGroup

from spl_batch.formats.crs import crs_name, horizontal

_WGS84: Final = CRS.from_epsg(4326)


def _group(source: CRS, target: CRS) -> TransformerGroup:
    """Every transformation that PROJ knows, the best first."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that a grid is missing, without its name
        return TransformerGroup(source, target, always_xy=True, allow_ballpark=False)


@lru_cache(maxsize=64)
def lacks(source: CRS, target: CRS) -> str:
    """What PROJ lacks for the best transformation, and how to get it; empty where it has all.

    A command for each grid: of several ``--file`` pyproj takes the last.
    """
    try:
        group = _group(source, target)
    except ProjError:
        return "knows none"
    if group.best_available:
        return ""
    best = group.unavailable_operations[:1]
    missing = [grid.short_name for one in best for grid in one.grids if not grid.available]
    commands = " && ".join(f"pyproj sync --file {name}" for name in missing)
    return f"lacks what `{commands}` fetches" if missing else "knows none"


@lru_cache(maxsize=64)
def best_transformer(source: CRS, target: CRS) -> Transformer:
    """Transformation in the order easting, northing, by the best operation that PROJ knows.

    Without a grid PROJ takes the next best one, metres off, and keeps silent. A run has few pairs
    of CRS, and each takes PROJ 20 to 50 ms.

    Raises
    ------
    ProjError
        If there is none, or PROJ lacks its grid; it names the grid.
    """
    if lacking := lacks(source, target):
        raise ProjError(f"the best transformation: PROJ {lacking}")
    return Transformer.from_crs(
        source, target, always_xy=True, only_best=True, allow_ballpark=False
    )


def shape_transformers(source: CRS, target: CRS) -> list[Transformer]:
    """Transformations, one after the other: the best, or those of :func:`kept_degrees`.

    Raises
    ------
    ProjError
        As :func:`best_transformer` does, where degrees are not kept either.
    """
    first, last = horizontal(source), horizontal(target)
    degrees = _geographic(first), _geographic(last)
    if degrees[0] is None or degrees[1] is None or not kept_degrees(source, target):
        return [best_transformer(first, last)]
    return [best_transformer(first, degrees[0]), best_transformer(degrees[1], last)]


@lru_cache(maxsize=64)
def kept_degrees(source: CRS, target: CRS) -> str:
    """That shapes keep their degrees from one datum to another, for want of a grid; else empty.

    So they do where EPSG has a transformation of both datums to WGS 84 that changes nothing, as of
    NAD83 and its realisations: there they come as they would from a file in EPSG:4326.
    """
    first, last = horizontal(source), horizontal(target)
    lacking = lacks(first, last)
    ends = [crs for crs in map(_geographic, (first, last)) if crs is not None]
    if not lacking or len(ends) < 2:
        return ""
    steps = [one for crs in ends for one in _group(crs, _WGS84).transformers[:1]]
    if len(steps) < 2 or not all(one.definition.startswith("proj=noop") for one in steps):
        return ""
    return (
        f"longitudes and latitudes of {crs_name(ends[0])} are taken as those of "
        f"{crs_name(ends[1])}, accurate to {sum(one.accuracy for one in steps):.0f} m by EPSG, as "
        f"PROJ {lacking}"
    )


def _geographic(crs: CRS) -> CRS | None:
    """Longitude and latitude of a CRS; None of a local one."""
    return None if crs.geodetic_crs is None else crs.geodetic_crs.to_2d()
