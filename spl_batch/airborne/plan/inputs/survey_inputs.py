"""Which files a workflow names, and what is wrong with all of them at once; headers only."""

import difflib
import os
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pyproj import CRS

from spl_batch.airborne.plan.inputs.file_positions import (
    boxes_of,
    degrees_as_metres,
    far_positions,
    in_other_unit,
    inspected,
    saved_again,
    usable,
)
from spl_batch.airborne.plan.inputs.reference_files import (
    CheckpointFile,
    ReferenceFiles,
    checked_reference,
    looked_into,
    named_file,
)
from spl_batch.airborne.plan.inputs.shape_files import (
    checksums,
    kept_degrees,
    read_shapes,
    refuse_uncut,
    shape_files,
)
from spl_batch.airborne.plan.inputs.survey_crs import (
    check_reprojection,
    crs_findings,
    survey_crs,
    with_heights,
)
from spl_batch.airborne.settings.workflow import Workflow
from spl_batch.engine.findings import Finding
from spl_batch.engine.plan.input_files import (
    CHECK,
    check_keys,
    expand,
    name_below,
    refuse_own,
    source_key,
)
from spl_batch.engine.settings.mistaken_file import url_fault
from spl_batch.errors import (
    InputError,
    WorkflowError,
    merged_faults,
    named,
    shared,
)
from spl_batch.formats.geoid import Geoid
from spl_batch.formats.heights import with_vertical
from spl_batch.formats.las.convert import copied_format
from spl_batch.formats.las.copc import copc_fault
from spl_batch.formats.las.reader import LasFacts
from spl_batch.formats.named_areas import NamedArea
from spl_batch.formats.trajectory.records import SBET_SUFFIXES, first_records
from spl_batch.formats.units import Units
from spl_batch.lattice.tables import COLUMNS

NO_POINTS = "the file holds no points; name files that hold some, or copy it again"
"""What is wrong with a file where no other has points."""

MAX_POINTS = int(np.iinfo(COLUMNS["index"].dtype).max)
"""Points that one file may hold [count]."""


@dataclass(frozen=True, slots=True)
class Source:
    """An input file that can be used."""

    path: Path  #: Where it lies.
    name: str  #: What it is called in messages: relative to the workflow where it can be.
    delivered: str  #: Name of its classified twin below ``laz/``.
    #: What it is called in the store: depends on the name alone, so that another file in the survey
    #: renames nothing.
    key: int
    facts: LasFacts


@dataclass(frozen=True, slots=True)
class Inputs:
    """Everything that a workflow names, checked."""

    sources: tuple[Source, ...]  #: Point files that can be used, by name.
    bad: tuple[InputError, ...]  #: Point files that cannot.
    trajectory: tuple[Path, ...]  #: Files that exist.
    reference: ReferenceFiles  #: Files of reference points.
    crs: CRS | None
    warnings: tuple[Finding, ...]  #: What a user should know before the work starts.
    #: Key and checksum of each file of shapes, or of all that it is made of, and of the geoid's.
    beside: tuple[tuple[str, str], ...] = ()
    checkpoints: CheckpointFile | None = None  #: Checkpoints of a field survey.
    no_trajectory: tuple[InputError, ...] = ()  #: Files of ``trajectory`` that cannot be read.
    areas: tuple[NamedArea, ...] = ()  #: Tiles that a client names.

    def checksums(self, *keys: str) -> list[tuple[str, str]]:
        """Key and checksum of the files that some keys name, where they do."""
        return [one for one in self.beside if one[0] in keys]


def gather_inputs(workflow: Workflow, base: Path, output: Path) -> Inputs:
    """Find and check every file of a workflow.

    Raises
    ------
    WorkflowError
        If the request as a whole is wrong; one line with every fault.
    """
    faults: list[str] = []
    paths = expand(workflow.survey.flightlines, base, "survey.flightlines", faults)
    trajectory = expand(workflow.survey.trajectory, base, "survey.trajectory", faults)
    reference_names = workflow.reference.points if workflow.reference else None
    reference = expand(reference_names, base, "reference.points", faults)
    checkpoints = named_file(workflow.reference, base)
    others = shape_files(workflow)
    if workflow.reference and workflow.reference.checkpoints is not None:
        others["reference.checkpoints"] = workflow.reference.checkpoints
    faults += _missing(others, base)
    refuse_own(paths, output, "survey.flightlines", faults)
    if faults:
        raise WorkflowError("; ".join(faults))
    good, bad = _inspect(paths)
    good, without_channel = _with_channel(good, workflow.survey.channel_dimension)
    crs, good, mismatched = survey_crs(workflow, good)
    crs, good, lowered = with_heights(crs, workflow.survey, good)
    mismatched += lowered
    bad += [*without_channel, *mismatched]
    if not any(facts.n_points for facts in good):
        bad += [InputError(str(facts.path), NO_POINTS) for facts in good]
        faults_of = _unusable(trajectory, workflow, crs, ())
        nothing = ReferenceFiles()
        return Inputs((), tuple(bad), trajectory, nothing, crs, (), no_trajectory=faults_of)
    if workflow.survey.vertical_crs is not None:
        crs = with_vertical(crs, workflow.survey.vertical_crs, "survey.vertical_crs")
    good = [facts.in_metres(Units.of(crs)) for facts in good]
    areas, apart = read_shapes(workflow, base, crs, good)
    refuse_uncut(workflow, base, crs, good)
    geoid = workflow.outputs.geoid
    if geoid is not None:
        Geoid(geoid.grid, base / geoid.grid, crs).crs_above(geoid.crs)
    check_reprojection(workflow, crs, good)
    _refuse_no_copc(workflow, good, base)
    untimed = _without_time(workflow, good, base)
    warnings = [*(Finding("I06", {"what": text}) for text in workflow.remarks()), *apart, *untimed]
    warnings += [
        Finding("I01", {"kind": "header", "what": text}, name_below(facts.path, base))
        for facts in good
        for text in (*facts.warnings, *facts.rounding)
    ]
    placed = [(name_below(facts.path, base), facts) for facts in good]
    warnings += [*degrees_as_metres(placed), *far_positions(placed), *saved_again(placed)]
    warnings += kept_degrees(workflow, base, crs)
    checkpoints, remarks = looked_into(checkpoints, crs, workflow.reference, good)
    warnings += remarks
    warnings += crs_findings(crs, workflow.survey, placed)
    names = _delivered_names([f.path for f in good], base)
    sources = tuple(
        Source(f.path, name_below(f.path, base), name, source_key(name), f)
        for f, name in zip(good, names, strict=True)
    )
    check_keys(sources)
    return Inputs(
        tuple(sorted(sources, key=lambda s: s.name)),
        tuple(bad),
        trajectory,
        checked_reference(reference, workflow.reference, crs, mismatched),
        crs,
        tuple(warnings),
        tuple(checksums(workflow, base, crs)),
        checkpoints,
        _unusable(trajectory, workflow, crs, good),
        areas,
    )


def _missing(named: Mapping[str, str], base: Path) -> Iterator[str]:
    """A sentence for each file that cannot be there, by its key."""
    for key, name in named.items():
        if fault := url_fault(name):
            yield f"{key}: {name}: {fault}"
        elif not (base / name).exists():
            yield f"{key}: {base / name} does not exist; {CHECK}"


def _refuse_no_copc(workflow: Workflow, files: Sequence[LasFacts], base: Path) -> None:
    """Refuse octrees where they are asked for and a cloud can be none."""
    if not workflow.outputs.copc:
        return
    unfit = (
        (name_below(facts.path, base), fault)
        for facts in files
        if (fault := copc_fault(copied_format(facts.point_format), facts.scales)) is not None
    )
    faults = list(shared(unfit))
    if faults:
        raise WorkflowError("outputs.copc: " + "; ".join(faults))


def _unusable(
    trajectory: Sequence[Path], workflow: Workflow, crs: CRS | None, files: Sequence[LasFacts]
) -> tuple[InputError, ...]:
    """Why files of a trajectory are none, by their first records; not all of them.

    Those that are in another unit than the survey's count where no other is left.
    """
    faults: list[InputError] = []
    elsewhere: list[InputError] = []
    named_crs = crs is None or workflow.survey.trajectory_crs is not None
    survey = boxes_of(files) if files else None
    for path in trajectory:
        try:
            first = first_records(path)
        except InputError as fault:
            faults.append(fault)
            continue
        if first is None or survey is None:
            continue
        unnamed = not named_crs and path.suffix.lower() not in SBET_SUFFIXES
        if unnamed and (text := in_other_unit(first, crs, survey)):
            elsewhere.append(InputError(str(path), text))
    if trajectory and len(faults) + len(elsewhere) == len(trajectory):
        raise WorkflowError(f"survey.trajectory: {'; '.join(merged_faults([*faults, *elsewhere]))}")
    return tuple(faults)


def _without_time(workflow: Workflow, files: Sequence[LasFacts], base: Path) -> list[Finding]:
    """Files whose point format has no gps_time although the chain needs it."""
    lacking = [facts for facts in files if not facts.has_gps_time]
    if not lacking or not workflow.filtering:
        return []
    if len(lacking) == len(files):
        raise WorkflowError(
            f"{named([name_below(facts.path, base) for facts in files], 3)}: the point format has "
            "no gps_time, so there are no shots to filter by; write point format 1, 3 or 6 to 10 "
            "with times, or set filter.method: none and afterpulse.enabled: false for ground and "
            "surfaces"
        )
    return [
        Finding("I02", {"kind": "format", "format": one.point_format}, name_below(one.path, base))
        for one in lacking
    ]


def source_args(source: Source) -> dict[str, str]:
    """A file as the arguments of a task name it."""
    return {"source": str(source.key), "path": str(source.path)}


def _inspect(paths: Iterable[Path]) -> tuple[list[LasFacts], list[InputError]]:
    known, bad = inspected(paths)
    text = "{} points; split files over {}".format
    good, large = usable(
        known, lambda f: text(f.n_points, MAX_POINTS) if f.n_points > MAX_POINTS else None
    )
    return good, bad + large


def _with_channel(
    files: Sequence[LasFacts], dimension: str | None
) -> tuple[list[LasFacts], list[InputError]]:
    """Files that have the dimension with the beamlet number, and those that lack it.

    Where all lack it the key is wrong, not the files.
    """
    lacking = [facts for facts in files if dimension not in facts.dimensions]
    if dimension is None or not lacking:
        return list(files), []
    if len(lacking) == len(files):
        there = list(dict.fromkeys(name for facts in files for name in facts.dimensions))
        near = difflib.get_close_matches(dimension, there, n=1, cutoff=0.7)
        remedy = f"the nearest is {near[0]!r}" if near else f"there are {', '.join(there)}"
        paths = named([facts.path for facts in files], 3)
        raise WorkflowError(
            f"survey.channel_dimension: no dimension {dimension!r} in {paths}; {remedy}"
        )
    text = (
        f"no dimension {dimension!r} (survey.channel_dimension), which other files have; "
        "add it, or process the file apart"
    )
    return usable(files, lambda facts: None if dimension in facts.dimensions else text)


def _delivered_names(paths: Sequence[Path], base: Path) -> list[str]:
    """Relative names of the outputs: from the workflow's folder, else from a common one."""
    root = base
    if not all(path.is_relative_to(base) for path in paths):
        root = Path(os.path.commonpath([path.parent for path in paths]))
    relative = [path.relative_to(root).as_posix() for path in paths]
    stems = [name.rsplit(".", 1)[0].removesuffix(".copc") for name in relative]
    twice = {stem for stem, n in Counter(stems).items() if n > 1}
    return [
        f"{name if stem in twice else stem}.laz" for name, stem in zip(relative, stems, strict=True)
    ]
