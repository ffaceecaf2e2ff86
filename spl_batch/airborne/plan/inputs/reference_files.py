"""Files that results are compared with: reference points and checkpoints, as a workflow names them.

A bad file of points compares nothing, and fails alone; checkpoints are read before the work starts.
"""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

from pyproj import CRS

from spl_batch.airborne.plan.inputs.file_positions import extent, inspected, usable
from spl_batch.airborne.settings import ReferenceSettings
from spl_batch.airborne.tasks.checkpoints import read_named
from spl_batch.engine.findings import Finding
from spl_batch.engine.plan.input_files import name_below
from spl_batch.errors import (
    InputError,
    WorkflowError,
    as_input_fault,
    named,
    told_together,
)
from spl_batch.formats.checkpoints import Checkpoint
from spl_batch.formats.crs import (
    like_degrees,
    look_like_degrees,
    other_crs,
    parse_crs,
    same_crs,
    vertical,
)
from spl_batch.formats.files.atomic import real_path
from spl_batch.formats.las.reader import LasFacts
from spl_batch.formats.units import Units


class ReferenceFiles(NamedTuple):
    """Files of reference points."""

    usable: tuple[LasFacts, ...] = ()
    bad: tuple[InputError, ...] = ()


def checked_reference(
    paths: Iterable[Path],
    settings: ReferenceSettings | None,
    crs: CRS | None,
    others: Sequence[InputError],
) -> ReferenceFiles:
    """Facts of reference files in the survey's CRS, in metres, and what is wrong with the rest.

    Raises WorkflowError if every file that can be read is in another CRS: then the request is
    wrong, not the files. ``others``: files of the survey that are in another CRS themselves: any of
    them may be the wrong one.
    """
    stated = settings.crs if settings else None
    given = None if stated is None else parse_crs(stated, "reference.crs")
    known, damaged = inspected(paths)
    good, elsewhere = usable(known, lambda f: _crs_fault(f, f.crs or given, crs, others))
    if elsewhere and not good:
        told = (f"reference.points: {text}" for text in told_together([*damaged, *elsewhere]))
        raise WorkflowError("; ".join(told))
    in_metres = (facts.in_metres(Units.of(crs)) for facts in good)
    return ReferenceFiles(tuple(in_metres), (*damaged, *elsewhere))


def _crs_fault(
    facts: LasFacts, found: CRS | None, crs: CRS | None, others: Sequence[InputError]
) -> str:
    """Why a file cannot be compared with a survey of this CRS; empty if it can."""
    if found is None and facts.n_points and look_like_degrees(facts.mins_m, facts.maxs_m):
        return like_degrees([facts.mins_m, facts.maxs_m], "reference.crs")
    if crs is None or found is None:
        return ""
    if same_crs(found, crs):
        mine, ours = Units.of(found).vertical, Units.of(crs).vertical
        stated = vertical(found) is not None and mine != ours
        return f"its heights are in {mine}, the survey's in {ours}; reproject it" * stated
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


def named_file(settings: ReferenceSettings | None, base: Path) -> CheckpointFile | None:
    """The file that a workflow names; None where it names none."""
    if settings is None or settings.checkpoints is None:
        return None
    path = real_path(base / settings.checkpoints)
    return CheckpointFile(path, name_below(path, base))


def looked_into(
    file: CheckpointFile | None,
    crs: CRS | None,
    settings: ReferenceSettings | None,
    files: Sequence[LasFacts],
) -> list[Finding]:
    """Findings on the file before the work starts; raises WorkflowError where it is of no use.

    ``files``: those of the survey; without any nothing is read.
    """
    if file is None or not files:
        return []
    try:
        with as_input_fault(file.path):
            known, told = read_named(file.path, crs, settings)
    except InputError as fault:
        raise WorkflowError(f"reference.checkpoints: {fault}") from None
    boxes = [(facts.mins_m, facts.maxs_m) for facts in files if facts.n_points]
    within = [any(_inside(point, *box) for box in boxes) for point in known]
    if known and not any(within):
        told.append(_elsewhere(known, boxes, Units.of(crs)))
    return [Finding("C01", {"kind": "file", "what": text}, file.name) for text in told]


def _inside(point: Checkpoint, low_m: Sequence[float], high_m: Sequence[float]) -> bool:
    return low_m[0] <= point.x_m <= high_m[0] and low_m[1] <= point.y_m <= high_m[1]


def _elsewhere(
    points: Sequence[Checkpoint],
    boxes: Sequence[tuple[Sequence[float], Sequence[float]]],
    units: Units,
) -> str:
    """Where all checkpoints lie and where the survey does: a wrong CRS shows at once."""
    mine = extent([(point.x_m, point.y_m) for point in points], units)
    survey = extent([corner[:2] for box in boxes for corner in box], units)
    return (
        f"none of {len(points)} checkpoints lies within the survey: they lie within {mine}, "
        f"its points within {survey}; name their CRS in reference.checkpoints_crs if it is another"
    )
