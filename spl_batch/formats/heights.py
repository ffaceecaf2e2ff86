"""Heights of a file beside those of a survey: in which unit, above what, and what nothing states.

A horizontal CRS states no unit of heights: these are taken as the survey's where eastings are in
that unit, and nowhere else. A vertical CRS whose datum has no name states the unit alone: a user
may name its datum, in that unit, and without that nothing is transformed from it or to it.
"""

from typing import Final

from pyproj import CRS

from spl_batch.errors import WorkflowError
from spl_batch.formats.crs import (
    NAME,
    above_ellipsoid,
    compound,
    crs_name,
    crs_problems,
    horizontal,
    is_nameless,
    parse_crs,
    same_crs,
    vertical,
)
from spl_batch.formats.units import Units, in_words

NAVD88: Final = "EPSG:6360 states US survey feet, EPSG:8228 feet, EPSG:5703 metres"
"""Codes of heights above one datum, by which deliveries in feet name the unit."""

SOME_HEIGHTS: Final = CRS.from_wkt('VERT_CS["unknown",VERT_DATUM["unknown",2005],UNIT["metre",1]]')
"""Vertical CRS that states a unit alone, here the metre."""


def with_vertical(crs: CRS | None, text: str, key: str) -> CRS:
    """A compound CRS of a horizontal one and the vertical one that a user names.

    ``text``: anything that PROJ takes as a vertical CRS: ``EPSG:5703``.

    Raises
    ------
    WorkflowError
        If it is no vertical CRS, contradicts the files, or there is none to complete.
    """
    named = parse_crs(text, key, heights=True)
    if problems := crs_problems(named, NAME):
        raise WorkflowError(f"{key}: {problems[0]}")
    if crs is None:
        raise WorkflowError(f"{key}: the files have no CRS that it could complete: set survey.crs")
    if len(crs.axis_info) > 2 and not crs.is_compound:
        raise WorkflowError(
            f"{key}: the files state heights above the ellipsoid by {crs_name(crs)}, not "
            f"{crs_name(named)}; leave the key out, or correct the files"
        )
    found = vertical(crs)
    if found is None:
        return compound(crs, named)
    if names_datum(crs):
        if same_heights(found, named):
            return crs
        raise WorkflowError(
            f"{key}: the files state {crs_name(found)}, not {crs_name(named)}; leave the key out, "
            "or correct the files"
        )
    mine, ours = Units.of(found), Units.of(named)
    if mine.vertical_m != ours.vertical_m:
        raise WorkflowError(
            f"{key}: the files' heights are in {in_words(mine.vertical)}, {crs_name(named)} is in "
            f"{in_words(ours.vertical)}: name one in {in_words(mine.vertical)} ({NAVD88}), or "
            "correct the files"
        )
    return compound(crs, named)


def same_heights(a: CRS, b: CRS) -> bool:
    """Whether two vertical CRS have the same unit, and the same datum as far as they name one.

    Files often name the model of a geoid beside the datum that it realises, or a unit alone. What
    has a name, but no datum, is the same as what has that name.
    """
    # PROJ takes two datums without names for one.
    if _datum(a) and (a.equals(b) or (a.to_epsg() is not None and a.to_epsg() == b.to_epsg())):
        return True
    above = _above(a), _above(b)
    alike = above[0] == above[1] or not all(above)
    return alike and Units.of(a).vertical_m == Units.of(b).vertical_m


def _datum(heights: CRS) -> str:
    """Name of a vertical CRS's datum; empty where it has none."""
    name = "" if heights.datum is None else heights.datum.name
    return "" if is_nameless(name) else name


def _above(heights: CRS) -> str:
    """What heights of a vertical CRS are above: its datum, else by its own name; empty without."""
    return _datum(heights) or ("" if is_nameless(heights.name) else heights.name)


def heights_above(crs: CRS) -> str:
    """What heights of a CRS are above, by name; empty where it states their unit at most."""
    heights = vertical(crs)
    deep = "the ellipsoid" if len(crs.axis_info) > 2 else ""
    return deep if heights is None else _above(heights)


def names_datum(crs: CRS) -> bool:
    """Whether PROJ knows what heights are above: the ellipsoid, or a datum with a name."""
    heights = vertical(crs)
    return len(crs.axis_info) > 2 if heights is None else bool(_datum(heights))


def other_heights(found: CRS, survey: CRS, whose: str = "the survey's") -> str:
    """What heights of a CRS are, where they are not the survey's; empty where they may be.

    ``whose``: in place of the survey's, as of :func:`~spl_batch.formats.crs.other_crs`.
    """
    if not (heights_above(found) and heights_above(survey)):
        return ""
    one, other = vertical(found), vertical(survey)
    above = [is_above_ellipsoid(crs) for crs in (found, survey)]
    if all(above) or (one is not None and other is not None and same_heights(one, other)):
        return ""
    mine, ours = (
        f"above the ellipsoid by {crs_name(crs)}" if high else crs_name(vertical(crs) or crs)
        for crs, high in zip((found, survey), above, strict=True)
    )
    return f"heights are {mine}, {whose} {ours}"


def with_heights_of(crs: CRS, stating: CRS) -> CRS:
    """A horizontal CRS with heights of a vertical one, or of another that states some.

    Heights above the ellipsoid have no CRS of their own: then it has a third axis.
    """
    heights = stating if len(stating.axis_info) == 1 else vertical(stating)
    if heights is not None:
        return compound(crs, heights)
    own = same_crs(crs, stating)
    return stating if own else above_ellipsoid(crs, Units.of(stating).vertical)


def is_above_ellipsoid(crs: CRS) -> bool:
    """Whether heights of a CRS are above the ellipsoid, as those of GDAL's vertical CRS may be."""
    return "ellipsoid" in heights_above(crs).lower()


def states_heights(crs: CRS) -> bool:
    """Whether a CRS states what heights are above, or their unit."""
    return vertical(crs) is not None or len(crs.axis_info) > 2


def completed(found: CRS, stated: CRS | None) -> CRS:
    """CRS of a file, with the heights that a user states for it where it names none itself."""
    if stated is None or not states_heights(stated) or not same_crs(found, stated):
        return found
    in_unit = Units.of(found).vertical_m == Units.of(stated).vertical_m
    return found if names_datum(found) or (states_heights(found) and not in_unit) else stated


def heights_ratio(found: CRS, survey: CRS) -> float | None:
    """Units of the survey's heights in one of those of a CRS.

    Heights without a unit of their own are the survey's where eastings are in that unit, and
    beside degrees where it is the metre; elsewhere nothing states it, and it is None.
    """
    mine, ours = Units.of(found).vertical_m, Units.of(survey).vertical_m
    return mine / ours if states_heights(found) or mine == ours else None


def unknown_unit(found: CRS, survey: CRS, remedy: str) -> str:
    """Fault of a file of which :func:`heights_ratio` is not known.

    ``remedy``: what states the unit; a CRS that does follows: ``name it in reference.crs:``.
    """
    unit = "degrees" if found.is_geographic else in_words(Units.of(found).horizontal)
    return (
        f"its CRS {crs_name(found)} is in {unit} and states no unit of heights, the survey's "
        f"heights are in {in_words(Units.of(survey).vertical)}: {remedy} "
        f"EPSG:{horizontal(found).to_epsg() or '...'}+6360 for US survey feet, +8228 for feet, "
        "+5703 for metres"
    )


def heights_fault(found: CRS, survey: CRS, remedy: str, whose: str = "the survey's") -> str:
    """Why heights of a file cannot be taken as the survey's, its remedy; empty where they can.

    ``remedy``: as of :func:`unknown_unit`. ``whose``: as of :func:`other_heights`.
    """
    ratio = heights_ratio(found, survey)
    if ratio is None:
        return unknown_unit(found, survey, remedy)
    if ratio != 1.0:
        unit, ours = (in_words(Units.of(crs).vertical) for crs in (found, survey))
        return (
            f"its heights are in {unit} by {crs_name(found)}, {whose} in {ours}: transform it,"
            " its heights as well"
        )
    others = other_heights(found, survey, whose)
    if not others:
        return ""
    nameless = names_datum(survey) and not names_datum(found)
    same = f"; its datum has no name, if it is the survey's {remedy} EPSG:...+..."
    return f"its {others}: transform it{same if nameless else ''}"
