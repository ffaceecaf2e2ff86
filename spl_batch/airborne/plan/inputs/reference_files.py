"""Files that results are compared with: reference points and checkpoints, as a workflow names them.

A bad file of points compares nothing, and fails alone; checkpoints are read before the work starts.
"""

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from pyproj import CRS

from spl_batch.airborne.plan.inputs.file_positions import extent
from spl_batch.airborne.plan.inputs.files import Files
from spl_batch.airborne.plan.inputs.survey_crs import contradiction
from spl_batch.airborne.settings import ReferenceSettings
from spl_batch.airborne.tasks.reference import read_named
from spl_batch.engine.findings import Finding
from spl_batch.engine.plan.input_files import name_below
from spl_batch.errors import (
    InputError,
    WorkflowError,
    as_input_fault,
    merged_faults,
    named,
)
from spl_batch.formats.checkpoints import Checkpoint
from spl_batch.formats.crs import (
    like_degrees,
    look_like_degrees,
    no_survey_crs,
    other_crs,
    parse_crs,
    same_crs,
)
from spl_batch.formats.files.atomic import real_path
from spl_batch.formats.heights import NAVD88, completed, heights_fault, states_heights
from spl_batch.formats.las.reader import LasFacts
from spl_batch.formats.units import Units, both

KEY: Final = "reference.crs"

_REMEDY: Final = f"name it in {KEY}:"
"""What states the heights of a reference file whose CRS leaves them open."""


def checked_reference(
    paths: Iterable[Path],
    settings: ReferenceSettings | None,
    crs: CRS | None,
    others: Sequence[InputError],
) -> Files:
    """Reference files by their headers, in the survey's CRS, in metres.

    Raises WorkflowError if every file that can be read is in another CRS: then the request is
    wrong, not the files. ``others``: files of the survey that are in another CRS themselves: any of
    them may be the wrong one.
    """
    stated = settings.crs if settings else None
    given = None if stated is None else parse_crs(stated, KEY)
    files = Files(paths)
    damaged = len(files.bad)

    def fault(facts: LasFacts) -> str:
        if facts.crs is None or given is None:
            return _crs_fault(facts, facts.crs or given, crs, others)
        found = completed(facts.crs, given)
        heights = heights_fault(found, given, _REMEDY, KEY) if states_heights(given) else ""
        more = f", or leave out {KEY}" if heights else ""
        return (
            contradiction(facts, given, KEY, KEY)
            or f"{heights}{more}"
            or _crs_fault(facts, found, crs, others)
        )

    files.leave_out(fault)
    if len(files.bad) > damaged and not files.usable:
        faults = (f"reference.points: {text}" for text in merged_faults(files.bad))
        raise WorkflowError("; ".join(faults))
    files.in_metres(Units.of(crs))
    return files


def _crs_fault(
    facts: LasFacts, found: CRS | None, crs: CRS | None, others: Sequence[InputError]
) -> str:
    """Why a file cannot be compared with a survey of this CRS; empty if it can."""
    if found is None and facts.n_points and look_like_degrees(facts.mins_m, facts.maxs_m):
        return like_degrees([facts.mins_m, facts.maxs_m], KEY)
    if found is None:
        return ""
    if crs is None:
        return no_survey_crs(found)
    if same_crs(found, crs):
        return heights_fault(found, crs, _REMEDY)
    remedy = "reproject it"
    if others:
        remedy = (
            f"nor is that of {named([error.path for error in others], 3)}: most points are "
            "in the survey's, reproject what is wrong"
        )
    return f"{other_crs(found, crs)}; {remedy}"


class CheckpointFile(NamedTuple):
    """A file of checkpoints, and what it is called in messages."""

    path: Path
    name: str
    units: Sequence[str]  #: Units that its heights are in, by PROJ's names.


def checked_checkpoints(
    settings: ReferenceSettings | None, base: Path, crs: CRS | None, files: Files
) -> tuple[CheckpointFile | None, list[Finding]]:
    """The file that a workflow names, if it does, and findings on it, before the work starts.

    Raises WorkflowError where it is of no use. ``files``: those of the survey.
    """
    if settings is None or settings.checkpoints is None:
        return None, []
    path = real_path(base / settings.checkpoints)
    try:
        with as_input_fault(path):
            known, remarks, units = read_named(path, crs, settings)
    except InputError as fault:
        raise WorkflowError(f"reference.checkpoints: {fault}") from None
    remarks += _misplaced(known, files, Units.of(crs))
    name = name_below(path, base)
    findings = [Finding("C01", {"kind": "file", "what": text}, name) for text in remarks]
    return CheckpointFile(path, name, units), findings


def _misplaced(points: Sequence[Checkpoint], files: Files, units: Units) -> Iterator[str]:
    """Where all checkpoints lie and where the survey does: a wrong CRS, or unit, shows at once.

    Headers' boxes hold far noise too, which makes them larger: nothing is named wrongly for that. A
    wrong unit that it hides is named beside the terrain, once there is one.
    """
    places = np.array([(point.x_m, point.y_m, point.z_m) for point in points]).reshape(-1, 3)
    ends = [(facts.mins_m, facts.maxs_m) for facts in files.holding]
    low, high = np.array(ends).transpose(1, 0, 2)
    inside = (places[:, None] >= low) & (places[:, None] <= high)
    within = inside[..., 0] & inside[..., 1]
    if len(points) and not within.any():
        mine, survey = (extent(some, units) for some in (places[:, :2], files.corners))
        yield (
            f"none of {len(points)} checkpoints lies within the survey: they lie within {mine}, "
            f"its points within {survey}; name their CRS in reference.checkpoints_crs if it is "
            "another"
        )
    elif len(points) and not (within & inside[..., 2]).any():
        z = places[np.any(within, axis=1), 2]
        mine, survey = (
            " to ".join(both(end, units.of_heights) for end in (np.min(some), np.max(some)))
            for some in (z, np.array([low, high])[..., 2])
        )
        yield (
            f"none of {len(z)} checkpoints has a height that points have there: {mine}, those of "
            f"points {survey}; if they are in another unit or above another datum, name it, "
            f"reference.checkpoints_crs: EPSG:...+5703 ({NAVD88})"
        )
