"""Which files a workflow names, and what is wrong with all of them at once; headers only."""

import difflib
import os
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pyproj import CRS

from spl_batch.airborne.context import reprojection, tiles_follow
from spl_batch.airborne.plan.inputs.companion_files import (
    CheckpointFile,
    checked_checkpoints,
    checked_reference,
    read_shapes,
    shape_files,
)
from spl_batch.airborne.plan.inputs.file_positions import (
    degrees_as_metres,
    far_positions,
    in_other_unit,
    saved_again,
)
from spl_batch.airborne.plan.inputs.files import Files
from spl_batch.airborne.plan.inputs.survey_crs import (
    check_reprojection,
    crs_findings,
    survey_crs,
    with_heights,
)
from spl_batch.airborne.settings.workflow import Workflow
from spl_batch.constants import QUANTUM_M
from spl_batch.engine.findings import Finding
from spl_batch.engine.plan.input_files import check_keys, expand, refuse_own, source_key
from spl_batch.errors import InputError, WorkflowError, merged_faults, named
from spl_batch.formats.files.atomic import checksum
from spl_batch.formats.geoid import Geoid, grid_file
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
    reference: Files  #: Files of reference points.
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
    reference = workflow.reference
    references = expand(reference.points if reference else None, base, "reference.points", faults)
    expand(reference.checkpoints if reference else None, base, "reference.checkpoints", faults)
    for key, name in shape_files(workflow).items():
        expand(name, base, key, faults)
    refuse_own(paths, output, "survey.flightlines", faults)
    if faults:
        raise WorkflowError("; ".join(faults))
    files = Files(paths, base)
    files.leave_out(_too_many_points)
    _leave_out_channelless(files, workflow.survey.channel_dimension)
    sound = len(files.bad)
    crs = with_heights(survey_crs(workflow, files), workflow.survey, files)
    elsewhere = files.bad[sound:]
    if not files.holding:
        files.leave_out(lambda _: NO_POINTS)
        lost = _unusable(trajectory, workflow, crs, files)
        return Inputs((), tuple(files.bad), trajectory, Files(), crs, (), no_trajectory=lost)
    if workflow.survey.vertical_crs is not None:
        crs = with_vertical(crs, workflow.survey.vertical_crs, "survey.vertical_crs")
    files.in_metres(Units.of(crs))
    shapes = read_shapes(workflow, base, crs, files)
    geoid, beside = workflow.outputs.geoid, shapes.checksums
    if geoid is not None:
        Geoid(geoid.grid, base / geoid.grid, crs).crs_above(geoid.crs)
        grid = grid_file(geoid.grid, base / geoid.grid)
        beside += [] if grid is None else [("outputs.geoid.grid", checksum(grid))]
    check_reprojection(workflow, crs, files)
    _refuse_unfit(workflow, crs, files)
    warnings = [Finding("I06", {"what": text}) for text in workflow.remarks()]
    warnings += [*shapes.findings, *_without_time(workflow, files)]
    warnings += [
        Finding("I01", {"kind": "header", "what": text}, files.name(facts))
        for facts in files.usable
        for text in (*facts.warnings, *facts.rounding)
    ]
    warnings += [*degrees_as_metres(files), *far_positions(files), *saved_again(files)]
    checkpoints, remarks = checked_checkpoints(reference, base, crs, files)
    warnings += [*remarks, *crs_findings(crs, workflow.survey, files)]
    names = _delivered_names([facts.path for facts in files.usable], base)
    sources = [
        Source(facts.path, files.name(facts), name, source_key(name), facts)
        for facts, name in zip(files.usable, names, strict=True)
    ]
    check_keys(sources)
    return Inputs(
        tuple(sorted(sources, key=lambda s: s.name)),
        tuple(files.bad),
        trajectory,
        checked_reference(references, reference, crs, elsewhere),
        crs,
        tuple(warnings),
        tuple(beside),
        checkpoints,
        _unusable(trajectory, workflow, crs, files),
        tuple(shapes.areas),
    )


def _too_many_points(facts: LasFacts) -> str:
    """Fault of a file with more points than their numbers reach; empty for others."""
    text = f"{facts.n_points} points; split files over {MAX_POINTS}"
    return text if facts.n_points > MAX_POINTS else ""


def _refuse_unfit(workflow: Workflow, crs: CRS | None, files: Files) -> None:
    """Refuse octrees, and tiles of a client, that clouds cannot be written as."""
    outputs, tiles = workflow.outputs, workflow.outputs.client_tiles
    asked = [("outputs.copc", "copc", True)] if outputs.copc else []
    if tiles is not None:
        # Clouds in another unit have one scale, whatever the input's.
        kept = tiles.format == "copc" and not tiles_follow(outputs, reprojection(outputs, crs))
        asked.append(("outputs.client_tiles", tiles.format, kept))
    for key, written, kept in asked:
        unfit = [
            facts
            for facts in files.usable
            if copc_fault(
                copied_format(facts.point_format), facts.scales if kept else (QUANTUM_M,) * 3
            )
        ]
        if unfit:
            kinds = {
                f"{one.point_format} with scales {', '.join(f'{s:g}' for s in one.scales)}"
                for one in unfit
            }
            raise WorkflowError(
                f"{key}: {named([files.name(facts) for facts in unfit], 3)}: point format "
                f"{' or '.join(sorted(kinds))} cannot be written as {written}: that takes formats "
                "without waveforms, and octrees one scale; leave the key out, or write them "
                "otherwise"
            )


def _unusable(
    trajectory: Sequence[Path], workflow: Workflow, crs: CRS | None, files: Files
) -> tuple[InputError, ...]:
    """Why files of a trajectory are none, by their first records; not all of them.

    Those that are in another unit than the survey's count where no other is left.
    """
    faults: list[InputError] = []
    elsewhere: list[InputError] = []
    named_crs = crs is None or workflow.survey.trajectory_crs is not None
    for path in trajectory:
        try:
            first = first_records(path)
        except InputError as fault:
            faults.append(fault)
            continue
        if first is None or not files.holding:
            continue
        unnamed = not named_crs and path.suffix.lower() not in SBET_SUFFIXES
        if unnamed and (text := in_other_unit(first, crs, files.boxes)):
            elsewhere.append(InputError(str(path), text))
    if trajectory and len(faults) + len(elsewhere) == len(trajectory):
        raise WorkflowError(f"survey.trajectory: {'; '.join(merged_faults([*faults, *elsewhere]))}")
    return tuple(faults)


def _without_time(workflow: Workflow, files: Files) -> list[Finding]:
    """Files whose point format has no gps_time although the chain needs it."""
    lacking = [facts for facts in files.usable if not facts.has_gps_time]
    if not lacking or not workflow.filtering:
        return []
    if len(lacking) == len(files.usable):
        raise WorkflowError(
            f"{named([files.name(facts) for facts in lacking], 3)}: the point format has "
            "no gps_time, so there are no shots to filter by; write point format 1, 3 or 6 to 10 "
            "with times, or set filter.method: none and afterpulse.enabled: false for ground and "
            "surfaces"
        )
    return [
        Finding("I02", {"kind": "format", "format": one.point_format}, files.name(one))
        for one in lacking
    ]


def source_args(source: Source) -> dict[str, str]:
    """A file as the arguments of a task name it."""
    return {"source": str(source.key), "path": str(source.path)}


def _leave_out_channelless(files: Files, dimension: str | None) -> None:
    """Leave out files that lack the dimension with the beamlet number.

    Where all lack it the key is wrong, not the files.
    """
    lacking = [facts for facts in files.usable if dimension not in facts.dimensions]
    if dimension is None or not lacking:
        return
    if len(lacking) == len(files.usable):
        there = list(dict.fromkeys(name for facts in lacking for name in facts.dimensions))
        near = difflib.get_close_matches(dimension, there, n=1, cutoff=0.7)
        remedy = f"the nearest is {near[0]!r}" if near else f"there are {', '.join(there)}"
        paths = named([facts.path for facts in lacking], 3)
        raise WorkflowError(
            f"survey.channel_dimension: no dimension {dimension!r} in {paths}; {remedy}"
        )
    text = (
        f"no dimension {dimension!r} (survey.channel_dimension), which other files have; "
        "add it, or process the file apart"
    )
    files.leave_out(lambda facts: None if dimension in facts.dimensions else text)


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
