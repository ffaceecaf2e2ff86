"""Coordinate reference systems: from LAS records, and whether they suit this work."""

import re
from collections.abc import Sequence
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import ArrayLike
from pyproj import CRS, Proj
from pyproj.crs import CompoundCRS
from pyproj.exceptions import CRSError, ProjError

from spl_batch.errors import WorkflowError, named
from spl_batch.formats.units import FOOT, METRE, US_FOOT, Units, in_words, metres_in

WKT_KEY: Final = ("LASF_Projection", 2112)
LIBLAS_KEY: Final = ("liblas", 2112)
"""Records of WKT: that of LAS, and that which libLAS and early PDAL wrote beside GeoTIFF keys."""

_NAMELESS: Final = re.compile(r"$|unknown|unnamed|user.defined", re.IGNORECASE)
"""How names begin that GDAL, PROJ and others give to what has none: of a vertical CRS of which keys
have the unit only, of its datum."""

REPROJECT: Final = "reproject the files to"
NAME: Final = "name"
"""What to do about a CRS that does not serve: one that files have, and one that a key names."""

_SHORT: Final = {METRE: "m", FOOT: "ft", US_FOOT: "ftUS"}
"""Units as EPSG's names of CRS have them."""

DEGREES_ACROSS: Final = 5.0
"""Extent from which on coordinates that could be degrees are taken as metres."""

LENGTHS_APART: Final = 0.15
"""Where lengths are off by a larger part, a projection is none of the region; those of countries
are off by up to 0.1 at their rims."""

_TURNED: Final = ("west", "down")
"""Directions of axes that no other computation expects; south is one of each pole's as well."""

_UTM_LATITUDE: Final = 84.0
"""Latitude beyond which UTM has no zones [degrees]."""


def parse_crs(text: str, key: str, *, heights: bool = False) -> CRS:
    """CRS of coordinates that a user names, or of ``heights`` alone.

    ``text``: anything that PROJ takes: ``EPSG:32615``, WKT.

    Raises
    ------
    WorkflowError
        If there is no such CRS, or it is one of the other kind.
    """
    example = "EPSG:5703" if heights else "EPSG:32615"
    try:
        found = CRS.from_user_input(text)
    except CRSError:
        raise WorkflowError(f"{key}: {text!r} is not a known CRS; write e.g. {example}") from None
    alone = found.is_vertical and not found.is_compound
    if heights and not alone:
        raise WorkflowError(f"{key}: {crs_name(found)} is no vertical CRS; write e.g. {example}")
    if alone and not heights:
        raise WorkflowError(
            f"{key}: {crs_name(found)} is a CRS of heights alone; write a horizontal one with it, "
            f"e.g. {example}+5703"
        )
    return found


def projected_crs(text: str | None, key: str, faults: list[str]) -> CRS | None:
    """CRS in metres that a user names; none where none is named, or it has a fault.

    ``faults``: its fault is added to it; for receivers that take metres alone.
    """
    if text is None:
        return None
    try:
        crs = parse_crs(text, key)
    except WorkflowError as error:
        faults.append(str(error))
        return None
    units = Units.of(crs)
    unit = units.vertical if units.horizontal_m == 1.0 else units.horizontal
    other = [f"CRS {crs_name(crs)} is in {in_words(unit)}, not in metres: name one that is"]
    found = crs_problems(crs, NAME) or other * (not units.are_metres)
    faults += [f"{key}: {problem}" for problem in found]
    return crs


@lru_cache(maxsize=64)
def crs_from_wkt(data: bytes) -> CRS | None:
    """CRS of a WKT record, of which a survey has few; none where it is empty."""
    text = data.split(b"\0")[0].decode("utf-8", errors="replace").strip()
    return _with_its_code(CRS.from_wkt(text)) if text else None


def _with_its_code(crs: CRS) -> CRS:
    """A CRS whose projected part has no EPSG code but its own.

    GDAL leaves that of metres beside keys that state feet, and writers copy it; others read the
    code alone.
    """
    flat = horizontal(crs)
    own = flat.to_json_dict().get("id", {}) if flat.is_projected else {}
    if own.get("authority") != "EPSG":
        return crs
    try:
        known = CRS.from_epsg(own["code"])
    except CRSError:
        return crs  # of a newer registry
    if known.equals(flat, ignore_axis_order=True) or not differences(flat, known):
        return crs
    flat, heights = in_unit(flat, Units.of(flat).horizontal), vertical(crs)
    return flat if heights is None else compound(flat, heights)


def is_nameless(name: str) -> bool:
    """Whether a name of a CRS or a datum is empty of meaning."""
    return _NAMELESS.match(name) is not None


def horizontal(crs: CRS) -> CRS:
    """The CRS without its heights: the horizontal part of a compound or 3D one."""
    if crs.is_compound:
        return horizontal(crs.sub_crs_list[0])
    if crs.is_bound and crs.source_crs is not None:
        return horizontal(crs.source_crs)
    return crs.to_2d() if len(crs.axis_info) > 2 and not crs.is_geocentric else crs


def vertical(crs: CRS) -> CRS | None:
    """The part of a compound CRS that heights refer to; None where it names none.

    A grid of a geoid that is bound to it, as older writers have it, makes no other heights of them.
    """
    parts = crs.sub_crs_list if crs.is_compound else []
    found = next((part for part in parts if part.is_vertical), None)
    return found.source_crs if found is not None and found.is_bound else found


def compound(crs: CRS, heights: CRS) -> CRS:
    """The horizontal part of a CRS, with a vertical one."""
    flat = horizontal(crs)
    return CompoundCRS(f"{flat.name} + {heights.name}", [flat, heights])


def in_unit(crs: CRS, name: str) -> CRS:
    """A CRS with the same datum, projection and origin whose axes, heights too, are in a unit.

    It is EPSG's where that has one, as EPSG:6587 beside EPSG:6588.

    Parameters
    ----------
    crs : CRS
        Projected, local, vertical, or a compound of such; one bound to another loses that.
    name : str
        Unit of lengths by PROJ's name, which PROJ knows.
    """
    heights = vertical(crs)
    if heights is not None:
        return compound(in_unit(horizontal(crs), name), in_unit(heights, name))
    bound = crs.source_crs if crs.is_bound else None
    content = (bound or crs).to_json_dict()
    content.pop("id", None)
    for axis in content["coordinate_system"]["axis"]:
        axis["unit"] = {"type": "LinearUnit", "name": name, "conversion_factor": metres_in(name)}
    if not is_nameless(crs.name) and not crs.is_engineering:
        for short in _SHORT.values():
            content["name"] = content["name"].removesuffix(f" ({short})")
        content["name"] += "" if name == METRE else f" ({_SHORT.get(name, name)})"
    made = CRS.from_json_dict(content)
    twin = made.to_epsg()
    known = made if twin is None else CRS.from_epsg(twin)
    return known if known.equals(made, ignore_axis_order=True) else made


def no_survey_crs(found: CRS) -> str:
    """Fault of a file with a CRS beside a survey without one."""
    return f"is in {crs_name(found)}, the survey has no CRS: name it in survey.crs"


def above_ellipsoid(crs: CRS, unit: str) -> CRS:
    """The horizontal part of a CRS with heights above its ellipsoid, in a unit by PROJ's name."""
    content = horizontal(crs).to_3d().to_json_dict()
    content.pop("id", None)
    length = {"type": "LinearUnit", "name": unit, "conversion_factor": metres_in(unit)}
    content["coordinate_system"]["axis"][2]["unit"] = length
    return CRS.from_json_dict(content)


def same_crs(a: CRS, b: CRS) -> bool:
    """Whether two CRS agree in the horizontal, whatever their names and axis orders."""
    first, second = horizontal(a), horizontal(b)
    if first.equals(second, ignore_axis_order=True):
        return True
    code = first.to_epsg()
    return code is not None and code == second.to_epsg()


def other_crs(found: CRS, survey: CRS, whose: str = "the survey's") -> str:
    """Sentence about a CRS that is not the survey's, or another's: ``reference.crs``."""
    text = f"CRS {found.name!r} is not {whose} {survey.name!r}"
    if found.name == survey.name:
        text = f"CRS {found.name!r} has other parameters than {whose} of that name"
    return f"{text} ({apart})" if (apart := differences(found, survey)) else text


def differences(a: CRS, b: CRS) -> str:
    """In which parameters two projections differ, with the values of both, the first three."""
    one, other = _parameters(a), _parameters(b)
    apart = [key for key in one if key in other and one[key][0] != other[key][0]]
    apart = [key for key in apart if key != "datum"] or apart  # of which names are many
    return named([f"{key} {one[key][1]} against {other[key][1]}" for key in apart], 3)


def _parameters(crs: CRS) -> dict[str, tuple[str, str]]:
    """Parts of a projected CRS by name: as they are compared, and in words."""
    flat, unit = horizontal(crs), Units.of(crs).horizontal
    found = {"unit": (unit, unit)}
    operation = flat.coordinate_operation
    if operation is not None and flat.is_projected:
        found["method"] = (operation.method_code or operation.method_name, operation.method_name)
        for one in operation.params:
            if isinstance(one.value, str):
                continue  # the name of a grid
            value = f"{one.value * one.unit_conversion_factor:.9g}"
            found[one.name] = (value, f"{one.value:.10g} {one.unit_name}")
    if flat.datum is not None:
        found["datum"] = (flat.datum.name, flat.datum.name)
    return found


def crs_name(crs: CRS) -> str:
    """Name and, where there is one, EPSG code."""
    code = crs.to_epsg()
    return f"{crs.name!r}" if code is None else f"{crs.name!r} (EPSG:{code})"


def crs_problems(crs: CRS, remedy: str = REPROJECT) -> list[str]:
    """Why coordinates in a CRS cannot be worked with: a sentence for each problem, its remedy.

    ``remedy``: :data:`REPROJECT` of a CRS that files have, :data:`NAME` of one that a key names.
    """
    flat = horizontal(crs)
    if crs.is_geocentric or flat.is_geographic:
        kind = "geocentric" if crs.is_geocentric else "geographic (degrees)"
        fault = f"CRS {crs_name(crs)} is {kind}, coordinates must be projected: "
        written = crs.is_geocentric and remedy == REPROJECT
        more = "; if they are projected, name survey.crs" if written else ""
        return [f"{fault}{remedy} a projected CRS, e.g. UTM of the region{more}"]
    units = Units.of(crs)
    faults = [
        f"CRS {crs_name(crs)} is in {unit}, which is no unit of metres or feet: {remedy} one that "
        "is in them"
        for unit in dict.fromkeys((units.horizontal, units.vertical))
        if not 0.0 < (metres_in(unit) or 0.0) <= 1.0
    ]
    if _is_world_mercator(flat):
        faults.append(_stretches(crs, "1/cos(latitude)", remedy))
    turned = [f"{a.name} {a.direction}" for a in crs.axis_info if a.direction in _TURNED]
    if turned:
        faults.append(
            f"CRS {crs_name(crs)} counts {' and '.join(turned)}: {remedy} one that counts east, "
            "north and up"
        )
    return faults


def _stretches(crs: CRS, by: str, remedy: str) -> str:
    return (
        f"CRS {crs_name(crs)} stretches lengths by {by}, so that areas and densities would be"
        f" wrong: {remedy} one of the region, e.g. UTM"
    )


def stretch_problem(crs: CRS, points_m: ArrayLike, remedy: str = REPROJECT) -> list[str]:
    """Why a projection is not for these points, (n, 2) [m]; none where it is.

    ``remedy``: as of :func:`crs_problems`.
    """
    lengths, _ = scale_there(crs, points_m)
    apart = abs(lengths - 1.0) > LENGTHS_APART
    return [_stretches(crs, f"{lengths:.2f}", remedy)] if apart else []


def scale_there(crs: CRS, points_m: ArrayLike) -> tuple[float, float]:
    """Scale of lengths, which is farthest from 1, and of areas, at the truest of some points.

    ``points_m``: (n, 2), corners of a survey, of which one may lie astray [m]. Both scales are 1
    where no projection is known, and beyond its reach.
    """
    flat, found = horizontal(crs), []
    if not flat.is_projected:
        return 1.0, 1.0
    for x, y in np.asarray(points_m, np.float64).reshape(-1, 2) / Units.of(crs).horizontal_m:
        try:
            projection = Proj(flat)
            there = projection.get_factors(*projection(x, y, inverse=True, errcheck=True))
        except (ProjError, CRSError):
            continue  # beyond its reach, or no projection that PROJ knows
        both = (there.tissot_semiminor, there.tissot_semimajor)
        found.append((max(both, key=lambda scale: abs(scale - 1.0)), there.areal_scale))
    known = [scales for scales in found if np.isfinite(scales).all()]
    return min(known, key=lambda scales: abs(scales[0] - 1.0), default=(1.0, 1.0))


def _is_world_mercator(flat: CRS) -> bool:
    """Whether it is Web Mercator or another Mercator projection that is true at the equator."""
    operation = flat.coordinate_operation
    if operation is None or not operation.method_name.startswith(("Popular Vis", "Mercator (")):
        return False
    true_at = {parameter.name: parameter.value for parameter in operation.params}
    parallel = true_at.get("Latitude of 1st standard parallel", 0.0)
    return parallel == 0.0 and true_at.get("Scale factor at natural origin", 1.0) == 1.0


def look_like_degrees(
    mins: Sequence[float], maxs: Sequence[float], within: Sequence[Sequence[float]] = ()
) -> bool:
    """Whether a bounding box without a CRS is one of longitudes and latitudes.

    Parameters
    ----------
    mins, maxs : (2 or 3,) float
        Ends of the box, in whatever unit.
    within : sequence of (2,) float
        Corners of other boxes of the same survey: small tiles of a large one in local metres
        would look like degrees each for itself.
    """
    fits = all(-half <= low and high <= most for half, most, low, high in zip(
        (180.0, 90.0), (360.0, 90.0), mins, maxs, strict=False
    ))  # fmt: skip
    corners = np.array([mins[:2], maxs[:2], *within], np.float64)
    return fits and bool((np.ptp(corners, axis=0) < DEGREES_ACROSS).all())


def like_degrees(corners: Sequence[Sequence[float]], key: str) -> str:
    """Fault of files of which :func:`look_like_degrees` is true, and its remedy.

    ``corners``: of their boxes. ``key``: of the workflow that names their CRS.
    """
    longitude, latitude = np.mean([corner[:2] for corner in corners], axis=0).tolist()
    zone = int((longitude + 180.0) % 360.0 // 6.0) + 1
    code = (32_600 if latitude >= 0 else 32_700) + zone
    example = f", e.g. EPSG:{code}" if abs(latitude) < _UTM_LATITUDE else ""
    return (
        "no CRS is known and the coordinates look like degrees: if they are, reproject the files "
        f"to a CRS in metres{example}; if they are metres, name their CRS, --set {key}=EPSG:..."
    )
