"""The file of checkpoints that a workflow names: read before the work, so faults come first."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from pyproj import CRS

from spl_batch.airborne.settings import ReferenceSettings
from spl_batch.airborne.tasks.checkpoints import read_named
from spl_batch.engine.findings import Finding
from spl_batch.engine.plan.input_files import name_below
from spl_batch.errors import InputError, WorkflowError, as_input_fault, grouped
from spl_batch.formats.checkpoints import Checkpoint
from spl_batch.formats.files.atomic import real_path
from spl_batch.formats.las.reader import LasFacts


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
        told.append(_elsewhere(known, boxes))
    return [Finding("C01", {"kind": "file", "what": text}, file.name) for text in told]


def _inside(point: Checkpoint, low_m: Sequence[float], high_m: Sequence[float]) -> bool:
    return low_m[0] <= point.x_m <= high_m[0] and low_m[1] <= point.y_m <= high_m[1]


def _elsewhere(
    points: Sequence[Checkpoint], boxes: Sequence[tuple[Sequence[float], Sequence[float]]]
) -> str:
    """Where all checkpoints lie and where the survey does: a wrong CRS shows at once."""
    low, high = zip(*boxes, strict=True)
    survey = [[*(one[axis] for one in low), *(one[axis] for one in high)] for axis in (0, 1)]
    mine = [[point.x_m for point in points], [point.y_m for point in points]]
    return (
        f"none of {len(points)} checkpoints lies within the survey: they lie within {_box(mine)}, "
        f"its points within {_box(survey)}; name their CRS in reference.checkpoints_crs if it is "
        "another"
    )


def _box(sides: Sequence[Sequence[float]]) -> str:
    east, north = (f"{grouped(min(side))} to {grouped(max(side))}" for side in sides)
    return f"{east} E, {north} N"
