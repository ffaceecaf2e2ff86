"""CRS of a survey and of its heights: the setting's, else that of most points."""

from collections import Counter
from collections.abc import Hashable, Iterable
from dataclasses import replace
from typing import Final, TypeVar

import numpy as np
from pyproj import CRS

from spl_batch.airborne.context import reprojection
from spl_batch.airborne.plan.inputs.file_positions import leave_out_degrees
from spl_batch.airborne.plan.inputs.files import Files
from spl_batch.airborne.products.product_table import MOST_PIXELS
from spl_batch.airborne.settings import SurveySettings
from spl_batch.airborne.settings.workflow import Workflow
from spl_batch.constants import QUANTUM_M
from spl_batch.engine.findings import Finding
from spl_batch.errors import WorkflowError, grouped
from spl_batch.formats.crs import (
    compound,
    crs_name,
    crs_problems,
    horizontal,
    other_crs,
    parse_crs,
    same_crs,
    scale_there,
    stretch_problem,
    vertical,
)
from spl_batch.formats.heights import (
    NAVD88,
    completed,
    heights_above,
    heights_fault,
    states_heights,
    with_heights_of,
    with_vertical,
)
from spl_batch.formats.las.header import WAVEFORM_FORMATS
from spl_batch.formats.las.reader import LasFacts
from spl_batch.formats.reprojection import CELL_KEY, Reprojection
from spl_batch.formats.units import Units, in_words

T = TypeVar("T", bound=Hashable)

AREAS_APART: Final = 0.01
"""Areas and densities that are off by a larger part are reported."""


def survey_crs(workflow: Workflow, files: Files) -> CRS | None:
    """CRS of the survey: the setting, else what most points have; leaves out files that differ.

    With a setting every file without a CRS has that one, whatever its coordinates look like.
    """
    stated = workflow.survey.crs
    given = None if stated is None else parse_crs(stated, "survey.crs")
    files.usable = [_without_wrong_crs(facts, given) for facts in files.usable]
    files.leave_out(
        lambda facts: (
            _crs_problems(facts, facts.crs or given)
            or _crs_problems(facts, given and vertical(given))
        )
    )
    if stated is None:
        leave_out_degrees(files)
    crs = given or _of_most((facts, facts.crs and horizontal(facts.crs)) for facts in files.usable)
    if crs is None:
        return None
    key = None if stated is None else "survey.crs"
    files.leave_out(lambda facts: contradiction(facts, crs, key))
    problems = stretch_problem(crs, Units.of(crs).metres(files.corners))
    files.leave_out(lambda _: problems)
    return horizontal(crs)


def contradiction(facts: LasFacts, given: CRS, key: str | None, whose: str = "the survey's") -> str:
    """Fault of a file whose own CRS is another than one; empty where it is not, or it has none.

    ``key``: of the workflow that names that one, if one does. ``whose``: as of :func:`other_crs`.
    """
    if facts.crs is None or not facts.n_points or same_crs(facts.crs, given):
        return ""
    remedy = (
        "reproject the file, or if its CRS is wrong write the right one into it, "
        "e.g. pdal translate in.laz out.laz --writers.las.a_srs=EPSG:..."
    )
    if key is not None:
        remedy += f", or leave out {key}, which is for files that carry none"
    return f"{other_crs(facts.crs, given, whose)}; {remedy}"


def check_reprojection(workflow: Workflow, crs: CRS | None, files: Files) -> None:
    """Refuse a CRS for outputs that the survey's corners, or waveforms, cannot be brought to.

    A raster cell there, too, that is smaller than a millimetre, larger than a ground cell, or so
    small that rasters have more than :data:`MOST_PIXELS` of them.
    """
    moved = reprojection(workflow.outputs, crs)
    if moved is None:
        return
    if workflow.outputs.cell is not None:
        _check_cell(workflow.outputs.cell, workflow, moved, files)
    ends = [end for facts in files.holding for end in (facts.mins_m, facts.maxs_m)]
    moved.check(np.array(ends) / Units.of(crs).xyz_m)
    waves = [facts for facts in files.usable if facts.point_format in WAVEFORM_FORMATS]
    if waves and moved.moves_points:
        raise WorkflowError(
            f"{moved.key}: {waves[0].path}: directions of waveforms are not converted; leave it out"
        )


def _check_cell(cell: float, workflow: Workflow, moved: Reprojection, files: Files) -> None:
    """Refuse a raster cell elsewhere, in the unit there; parameters as of check_reprojection."""
    smallest, largest = map(moved.in_units, (QUANTUM_M, workflow.ground.cell_m))
    if not smallest <= cell <= largest:
        raise WorkflowError(
            f"{CELL_KEY}: {cell:g} is less than a millimetre or more than ground.cell_m; write "
            f"{smallest:g} to {largest:g}, in the unit of the CRS"
        )
    area_m2 = float(np.ptp(files.corners, axis=0).prod())
    # Of a survey with more raster cells than that rasters show the main part alone.
    whole = area_m2 <= MOST_PIXELS * workflow.products.cell_m**2
    pixels = area_m2 * (moved.in_units(1.0) / cell) ** 2
    if whole and pixels > MOST_PIXELS:
        raise WorkflowError(
            f"{CELL_KEY}: rasters would have {grouped(pixels)} cells of {cell:g}, more than "
            f"{grouped(MOST_PIXELS)}; write a larger one"
        )


def _of_most(found: Iterable[tuple[LasFacts, T | None]]) -> T | None:
    """CRS, or unit, that most points have; None where no file names one."""
    votes: Counter[T] = Counter()
    for facts, named in found:
        if named is not None and facts.n_points:
            votes[named] += facts.n_points
    return votes.most_common(1)[0][0] if votes else None


def with_heights(crs: CRS | None, settings: SurveySettings, files: Files) -> CRS | None:
    """The survey's CRS with its vertical one, if there is any; leaves out files of other heights.

    It is that of the setting ``survey.crs``, else that of most points in the unit that most have:
    a few files that state metres do not make metres of feet that others leave to their eastings.
    Files that name a datum decide on it for those that state a unit alone.
    """
    if crs is None:
        return None
    stated = None if settings.crs is None else parse_crs(settings.crs, "survey.crs")
    named = stated if stated is not None and states_heights(stated) else None
    if settings.vertical_crs is not None:
        stated = with_vertical(crs, settings.vertical_crs, "survey.vertical_crs")
    own = [(f, completed(f.crs, stated)) for f in files.usable if f.crs is not None]
    if named is None:
        unit_m = _of_most((facts, Units.of(found).vertical_m) for facts, found in own)
        stating = [
            (facts, found)
            for facts, found in own
            if states_heights(found) and Units.of(found).vertical_m == unit_m
        ]
        naming = [(facts, found) for facts, found in stating if heights_above(found)]
        named = _of_most((facts, vertical(found) or found) for facts, found in naming or stating)
    whole = crs if named is None else with_heights_of(crs, named)

    def differ(facts: LasFacts) -> str:
        if facts.crs is None or not facts.n_points:
            return ""
        return heights_fault(completed(facts.crs, stated), whole, "name it in survey.crs:")

    files.leave_out(differ)
    return whole


def crs_findings(crs: CRS | None, settings: SurveySettings, files: Files) -> list[Finding]:
    """A survey without a CRS or with a local one, and files whose places or heights have none.

    ``settings``: their CRS stand for what files lack. ``files``: with boxes in metres.
    """
    if crs is None:
        return [Finding("I08", {"kind": "none"})]
    units, unstated = Units.of(crs), vertical(crs) is None and len(crs.axis_info) < 3
    values = {"kind": "unit", "unit": in_words(units.vertical), "codes": NAVD88}
    of_heights = [Finding("I08", values)]
    found = of_heights if unstated and not units.are_metres else []
    stated = None if settings.crs is None else parse_crs(settings.crs, "survey.crs")
    if stated is None:
        others = {"kind": "others", "crs": crs_name(crs), "unit": in_words(units.horizontal)}
        silent = [facts for facts in files.holding if facts.crs is None]
        found += [Finding("I08", others, files.name(facts)) for facts in silent]
    if horizontal(crs).is_engineering:
        return [*found, Finding("I08", {"kind": "local", "crs": crs_name(crs)})]
    lengths, areas = scale_there(crs, files.corners)
    if max(abs(lengths - 1.0), abs(areas - 1.0)) > AREAS_APART:
        scale = {"kind": "scale", "crs": crs_name(crs), "lengths": lengths, "areas": areas}
        found.append(Finding("I05", scale))
    if settings.vertical_crs is not None or (stated is not None and states_heights(stated)):
        return found
    return [*found, *_without_heights(crs, files)]


def _without_heights(crs: CRS, files: Files) -> list[Finding]:
    """Files that do not name what heights are above, or their unit, beside others that do."""
    states = heights_above if heights_above(crs) else states_heights
    some = [(facts, facts.crs) for facts in files.holding if facts.crs is not None]
    lacking = [files.name(facts) for facts, found in some if not states(found)]
    if not states(crs) or len(lacking) == len(some):
        return []
    heights = vertical(crs)
    above = f"above the ellipsoid by {crs_name(crs)}" if heights is None else crs_name(heights)
    return [Finding("I08", {"kind": "vertical", "crs": above}, name) for name in lacking]


def _without_wrong_crs(facts: LasFacts, given: CRS | None) -> LasFacts:
    """Header with the user's CRS, if there is one, for a local or a geocentric one.

    A geocentric record over projected coordinates is a mistake of the writer's, and a local one
    names no place; one in another unit still states it.
    """
    if given is None or facts.crs is None:
        return facts
    local = horizontal(facts.crs).is_engineering
    if not local and not facts.crs.is_geocentric:
        return facts
    if local and (_other_unit(facts.crs, given) or _crs_problems(facts, facts.crs)):
        return facts
    kind = "local" if local else "geocentric"
    text = f"its CRS record is {kind}; survey.crs {given.name!r} is taken instead"
    heights = vertical(facts.crs)
    crs = None if heights is None else compound(given, heights)
    return replace(facts, crs=crs, warnings=(*facts.warnings, text))


def _other_unit(found: CRS, given: CRS) -> bool:
    """Whether a CRS states another unit than one, of places or of heights."""
    mine, ours = Units.of(found), Units.of(given)
    heights = vertical(found) is not None and mine.vertical_m != ours.vertical_m
    return heights or mine.horizontal_m != ours.horizontal_m


def _crs_problems(facts: LasFacts, crs: CRS | None) -> list[str]:
    if crs is None or not facts.n_points:
        return []
    return crs_problems(crs)
