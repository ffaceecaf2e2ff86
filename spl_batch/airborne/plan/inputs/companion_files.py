"""Files beside a survey's own: shapes, reference points and checkpoints, as a workflow names them.

Shapes (polygons, breaklines, tiles of a client) and checkpoints are read before the work starts. A
bad file of reference points compares nothing, and fails alone.
"""

import glob
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS

from spl_batch.airborne.plan.inputs.file_positions import ASTRAY, beside, extent
from spl_batch.airborne.plan.inputs.files import Files
from spl_batch.airborne.plan.inputs.survey_crs import contradiction
from spl_batch.airborne.settings import ReferenceSettings
from spl_batch.airborne.settings.workflow import Workflow
from spl_batch.airborne.tasks.reference import read_named
from spl_batch.engine.findings import Finding
from spl_batch.engine.plan.input_files import name_below
from spl_batch.errors import InputError, WorkflowError, as_input_fault, merged_faults, named
from spl_batch.formats.breaklines import read_breaklines
from spl_batch.formats.checkpoints import Checkpoint
from spl_batch.formats.crs import (
    like_degrees,
    look_like_degrees,
    no_survey_crs,
    other_crs,
    parse_crs,
    same_crs,
)
from spl_batch.formats.files.atomic import checksum, real_path
from spl_batch.formats.heights import NAVD88, completed, heights_fault, states_heights
from spl_batch.formats.las.reader import LasFacts
from spl_batch.formats.named_areas import NamedArea, read_named_areas
from spl_batch.formats.units import Units, both
from spl_batch.formats.vector_files import check_polygons, shapes_keep_degrees

TILES_KEY: Final = "outputs.client_tiles.polygons"
"""Key of the file with a client's tiles."""


class Shapes(NamedTuple):
    """What the files of shapes hold."""

    areas: list[NamedArea]  #: Tiles that a client names.
    #: Key of each file, and what it holds: checksums of its parts, and in which other way than the
    #: best its shapes come to the survey's CRS. Once PROJ has the grid for that, work is done anew.
    checksums: list[tuple[str, str]]
    findings: list[Finding]


def shape_files(workflow: Workflow) -> dict[str, str]:
    """Names of the files of shapes by their keys."""
    tiles = workflow.outputs.client_tiles
    given = {key: getattr(workflow, key) for key in ("aoi", "water", "breaklines")}
    given[TILES_KEY] = None if tiles is None else tiles.polygons
    return {key: name for key, name in given.items() if name is not None}


def read_shapes(workflow: Workflow, base: Path, crs: CRS | None, files: Files) -> Shapes:
    """Read every polygon and breakline once: whatever is wrong is reported here, of all files.

    A client's tiles, or an area of interest, beyond the points would hold none, or mark all of them
    as outside, and are a fault; water there has no effect, and is a warning.
    """
    faults: list[str] = []
    found = Shapes([], [], [])
    for key, name in shape_files(workflow).items():
        path = base / name
        try:
            with as_input_fault(path):
                shapes = _shapes(key, path, crs, workflow, found.areas)
                ways = shapes_keep_degrees(path, crs)
        except InputError as fault:
            faults.append(f"{key}: {fault}")
            continue
        # A shapefile's corners, table and CRS lie in files of the same stem.
        parts = path.parent.glob(f"{glob.escape(path.stem)}.*")
        whole = sorted(parts) if path.suffix.lower() == ".shp" else [path]
        found.checksums.append((key, " ".join([*map(checksum, whole), *ways])))
        for way in ways:
            found.findings.append(Finding("I05", {"kind": "grid", "key": key, "what": way}, name))
        apart = beside(shapes, files.boxes, Units.of(crs))
        if apart and key in {"aoi", TILES_KEY}:
            faults.append(f"{key}: {path}: {ASTRAY.format(**apart)}")
        elif apart:
            values = {
                "kind": "shapes", "key": key, "shapes": apart["shapes"], "points": apart["points"]
            }  # fmt: skip
            found.findings.append(Finding("I05", values, name))
    if faults:
        raise WorkflowError("; ".join(faults))
    return found


def _shapes(
    key: str, path: Path, crs: CRS | None, workflow: Workflow, areas: list[NamedArea]
) -> NDArray[Any]:
    """Shapes of a file, (n,); ``areas``: gets those that a client names."""
    tiles = workflow.outputs.client_tiles
    if key == TILES_KEY and tiles is not None:
        areas += read_named_areas(path, crs, tiles.name)
        return np.array([one.shape for one in areas])
    if key == "breaklines":
        return np.array([water.area for water in read_breaklines(path, crs)])
    return check_polygons(path, crs)


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
