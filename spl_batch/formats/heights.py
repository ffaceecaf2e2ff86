"""Heights of a file beside those of a survey: in which unit, above what, and what nothing tells.

A horizontal CRS states no unit of heights: these are taken as the survey's where eastings are in
that unit, and nowhere else.
"""

from typing import Final

from pyproj import CRS

from spl_batch.formats.crs import compound, crs_name, horizontal, same_crs, same_heights, vertical
from spl_batch.formats.units import Units, in_words

NAVD88: Final = "EPSG:6360 states US survey feet, EPSG:8228 feet, EPSG:5703 metres"
"""Codes of heights above one datum, by which deliveries in feet name the unit."""


def other_heights(found: CRS, survey: CRS) -> str:
    """What heights of a CRS are, where they are not the survey's; empty where they may be."""
    if not (states_heights(found) and states_heights(survey)):
        return ""
    one, other = vertical(found), vertical(survey)
    above = [_above_ellipsoid(crs) for crs in (found, survey)]
    if all(above) or (one is not None and other is not None and same_heights(one, other)):
        return ""
    mine, ours = (
        f"above the ellipsoid by {crs_name(crs)}" if high else crs_name(vertical(crs) or crs)
        for crs, high in zip((found, survey), above, strict=True)
    )
    return f"heights are {mine}, the survey's {ours}"


def with_heights_of(crs: CRS, stating: CRS) -> CRS:
    """A horizontal CRS with heights of a vertical one, or of another of the same places.

    Heights above the ellipsoid have no CRS of their own: then it is that other one itself.
    """
    heights = stating if len(stating.axis_info) == 1 else vertical(stating)
    return stating if heights is None else compound(crs, heights)


def _above_ellipsoid(crs: CRS) -> bool:
    """Whether heights that a CRS states are above the ellipsoid, as GDAL's vertical CRS say too."""
    datum = vertical(crs)
    return datum is None or "ellipsoid" in datum.name.lower()


def states_heights(crs: CRS) -> bool:
    """Whether a CRS says what heights are above, or their unit."""
    return vertical(crs) is not None or len(crs.axis_info) > 2


def completed(found: CRS, stated: CRS | None) -> CRS:
    """CRS of a file, with the heights that a user states for it where it names none itself."""
    if stated is None or not states_heights(stated) or states_heights(found):
        return found
    return stated if same_crs(found, stated) else found


def heights_ratio(found: CRS, survey: CRS) -> float | None:
    """Units of the survey's heights in one of those of a CRS.

    Heights without a unit of their own are the survey's where eastings are in that unit, and
    beside degrees where it is the metre; elsewhere nothing tells, and it is None.
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


def heights_fault(found: CRS, survey: CRS, remedy: str) -> str:
    """Why heights of a file cannot be taken as the survey's, its remedy; empty where they can.

    ``remedy``: as of :func:`unknown_unit`.
    """
    ratio = heights_ratio(found, survey)
    if ratio is None:
        return unknown_unit(found, survey, remedy)
    if ratio != 1.0:
        unit, ours = (in_words(Units.of(crs).vertical) for crs in (found, survey))
        return (
            f"its heights are in {unit} by {crs_name(found)}, the survey's in {ours}: transform it,"
            " its heights as well"
        )
    others = other_heights(found, survey)
    return f"its {others}: transform it" if others else ""
