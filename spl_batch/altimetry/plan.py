"""Inputs, steps and cost of ``kind: altimetry``."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

from spl_batch.altimetry.formats.atl08 import no_atl08
from spl_batch.altimetry.formats.photons import BeamFacts, TrackFile, inspect
from spl_batch.altimetry.settings import TrackWorkflow
from spl_batch.altimetry.steps import STEPS
from spl_batch.altimetry.tasks.context import Context
from spl_batch.altimetry.tasks.delivery import PASS_PHOTONS
from spl_batch.altimetry.tasks.index import look_through
from spl_batch.altimetry.tasks.labels import segments_of
from spl_batch.engine.findings import Finding
from spl_batch.engine.plan.budget import Cost, measured_rates
from spl_batch.engine.plan.input_files import expand, name_below, refuse_own, stem_names, usable
from spl_batch.engine.plan.worker_memory import WORKER_BASE_BYTES
from spl_batch.engine.tasks.input_changes import stamp
from spl_batch.engine.tasks.ledger import Ledger
from spl_batch.engine.tasks.task import Task
from spl_batch.engine.verbs.receiver import FirstLook
from spl_batch.errors import InputError, WorkflowError, merged_faults

RATES_PHOTONS_PER_S: Final[Mapping[str, float]] = MappingProxyType(
    {"index": 2.0e6, "signal": 0.1e6, "profile": 1.0e6, "deliver": 0.8e6}
)
"""Photons per second and worker until a store has measured its own; ``benchmarks/altimetry``."""

_LABEL: Final = STEPS["label"]

DISK_BYTES_PER_PHOTON: Final = 45
"""Working store and results [byte]."""


@dataclass(frozen=True, slots=True)
class Source:
    """A photon file that can be used; ``key`` is what tasks and the store call it."""

    path: Path
    name: str
    key: int
    file: TrackFile
    beams: tuple[BeamFacts, ...]


@dataclass(frozen=True, slots=True)
class Inputs:
    """Everything that a workflow names, checked."""

    sources: tuple[Source, ...]
    bad: tuple[InputError, ...]
    warnings: tuple[Finding, ...]
    reference: tuple[Path, ...]
    labels: tuple[Path, ...]  #: Those of the reference that are files of ATL08.


@dataclass
class Tracks(Ledger[Inputs, TrackWorkflow]):
    """What a run on photon profiles knows so far."""

    @cached_property
    def delivered(self) -> dict[int, str]:
        """What the results of each file are called, by its key."""
        return stem_names(self.inputs.sources)

    def beams(self) -> Iterator[tuple[Source, BeamFacts, str]]:
        """Every beam of every file, and what the store calls it."""
        for source in self.inputs.sources:
            for beam in source.beams:
                yield source, beam, f"{source.key}/{beam.name}"

    @property
    def expected_segments(self) -> int:
        """Segments that all beams make as their headers have it [count]."""
        most = self.workflow.work.segment_photons
        return sum(-(-beam.photons // most) for _, beam, _ in self.beams())


def gather_inputs(workflow: TrackWorkflow, base: Path, output: Path) -> Inputs:
    """Find and check every file of a workflow, from headers alone.

    Raises
    ------
    WorkflowError
        If the request as a whole is wrong; one line with every fault.
    """
    faults: list[str] = []
    paths = expand(workflow.track.photons, base, "track.photons", faults)
    reference = workflow.reference
    found: dict[str, Sequence[Path]] = {}
    for key in ("points", "dtm", "labels"):
        name = getattr(reference, key) if reference is not None else None
        found[key] = expand(name, base, f"reference.{key}", faults)
        if key != "labels" and len(found[key]) > 1:
            faults.append(f"reference.{key}: {name} matches several files; name one")
    if reference is not None and reference.points and reference.dtm:
        faults.append("reference: points and dtm are both given; name one of them")
    refuse_own(paths, output, "track.photons", faults)
    if faults:
        raise WorkflowError("; ".join(faults))

    def look(path: Path, name: str, key: int) -> Source:
        file, wanted = inspect(path), workflow.track.beams
        beams = tuple(b for b in file.beams if not wanted or b.name in wanted)
        if not beams:
            names = ", ".join(b.name for b in file.beams)
            raise InputError(str(path), f"none of track.beams is in it; it has {names}")
        return Source(path, name, key, file, beams)

    sources, bad = usable(paths, base, look)
    labels, warnings = _atl08(found.get("labels", ()), base, sources)
    return Inputs(
        sources,
        tuple(bad),
        warnings,
        tuple(path for paths in found.values() for path in paths),
        labels,
    )


def _atl08(
    files: Sequence[Path], base: Path, sources: Sequence[Source]
) -> tuple[tuple[Path, ...], tuple[Finding, ...]]:
    """Files that are of ATL08, and the faults of the others."""
    good, warnings = [], []
    for path in files:
        why = no_atl08(path)
        if why:
            name = f"reference.labels {name_below(path, base)}"
            warnings.append(Finding("P01", {"kind": why}, name))
        else:
            good.append(path)
    if good and sources and not any(s.file.layout == "atl03" for s in sources):
        warnings.append(Finding("P01", {"kind": "no atl03"}, "reference.labels"))
    return tuple(good), tuple(warnings)


def index_file(tracks: Tracks) -> Iterator[Task]:
    """Photon files, each to be looked through."""
    for source in tracks.inputs.sources:
        args = {
            "source": str(source.key),
            "path": str(source.path),
            "name": source.name,
            "stamp": [source.file.size_bytes, source.file.written_ns],
        }
        yield Task("index_file", str(source.key), args, (), 0)


def take_in(tracks: Tracks) -> Iterator[Task]:
    """Beams, each to be read."""
    indexed = tracks.of("index_file")
    for source, beam, key in tracks.beams():
        if str(source.key) in indexed:
            needs = (("index_file", str(source.key)),)
            yield Task("take_in", key, _beam_args(source, beam, key), needs, beam.photons)


def _beam_args(source: Source, beam: BeamFacts, key: str) -> dict[str, Any]:
    return {
        "key": key,
        "source": str(source.key),
        "path": str(source.path),
        "layout": source.file.layout,
        "beam": beam.name,
    }


def label(tracks: Tracks) -> Iterator[Task]:
    """Segments of track whose photons are labelled."""
    for name, receipt in tracks.of("take_in").items():
        for low, high, photons in receipt.facts["segments"]:
            args = {"key": name, "segment": f"{name}/{low}", "span": [low, high]}
            yield Task("label", f"{name}/{low}", args, (("take_in", name),), photons)


def _labelled(
    tracks: Tracks, kind: str, after: str = "profile"
) -> Iterator[tuple[Source, BeamFacts, Task]]:
    """Beams that an earlier step has finished, each with a task that needs it and the labels."""
    taken, labels = tracks.of("take_in"), tracks.of("label")
    for source, beam, key in tracks.beams():
        if key in tracks.of(after):
            segments = segments_of(key, taken, labels)
            needs = ((after, key), *(("label", name) for name, _, _ in segments))
            n = taken[key].points
            args = {**_beam_args(source, beam, key), "segments": segments, "points": n}
            yield source, beam, Task(kind, key, args, needs, n)


def profile(tracks: Tracks) -> Iterator[Task]:
    """Beams of whose signal a profile is made."""
    for _, _, task in _labelled(tracks, "profile", after="take_in"):
        yield task


def compare(tracks: Tracks) -> Iterator[Task]:
    """Beams that are compared with a reference, where there is one."""
    if tracks.workflow.reference is None:
        return
    stamps = [[str(path), *stamp(path)] for path in tracks.inputs.reference]
    for source, beam, task in _labelled(tracks, "compare"):
        labels = tracks.inputs.labels if source.file.layout == "atl03" else ()
        args = {
            **task.args,
            "name": f"{source.name}: {beam.name}",
            "reference": stamps,
            "labels": [str(path) for path in labels],
        }
        yield replace(task, args=args)


def deliver_beam(tracks: Tracks) -> Iterator[Task]:
    """Beams to be delivered."""
    for source, beam, task in _labelled(tracks, "deliver_beam"):
        args = {**task.args, "delivered": f"{tracks.delivered[source.key]}/{beam.name}"}
        yield replace(task, args=args)


def deliver_file(tracks: Tracks) -> Iterator[Task]:
    """Copies of HDF5 files with labels, where they are asked for."""
    if not tracks.workflow.outputs.hdf5:
        return
    beams: dict[int, list[Task]] = {}
    for source, beam, task in _labelled(tracks, "deliver_file"):
        args = {**task.args, "group": beam.group}
        beams.setdefault(source.key, []).append(replace(task, args=args))
    for source in tracks.inputs.sources:
        of_file = beams.get(source.key, [])
        if source.file.layout == "csv" or not of_file:
            continue
        args = {
            "source": str(source.key),
            "path": str(source.path),
            "delivered": f"{tracks.delivered[source.key]}{source.path.suffix}",
            "beams": [task.args for task in of_file],
        }
        needs = tuple(need for task in of_file for need in task.needs)
        points = sum(task.points for task in of_file)
        yield Task("deliver_file", str(source.key), args, needs, points)


def estimate(tracks: Tracks, context: Context | None = None) -> Cost:
    """Cost of a run, by headers; ``context``: where measured rates may lie."""
    workflow = tracks.workflow
    photons = [beam.photons for _, beam, _ in tracks.beams()]
    longest = max(photons, default=0)
    held = max(min(longest, workflow.work.segment_photons), PASS_PHOTONS // 10)
    rates, measured = measured_rates(RATES_PHOTONS_PER_S, context)
    files = len(tracks.inputs.sources)
    return Cost(
        points=sum(photons),
        tasks=2 * files + 4 * len(photons) + tracks.expected_segments,
        disk_bytes=sum(photons) * DISK_BYTES_PER_PHOTON
        + sum(s.file.size_bytes for s in tracks.inputs.sources),
        memory_bytes=WORKER_BASE_BYTES + held * _LABEL.bytes_per_point,
        heaviest="the longest segment of track",
        remedy=_LABEL.remedy,
        stages_s={stage: sum(photons) / rate for stage, rate in rates.items()},
        workers=tracks.workers,
        measured=measured,
    )


WHOLE_BYTES: Final = 100_000_000
"""Bytes of tables that are read to the end [byte]: a few seconds."""


def first_look(inputs: Inputs, cell_m: float) -> FirstLook:
    """Photons that cannot be used though their file's header can: tables of up to 100 MB in all.

    Raises
    ------
    WorkflowError
        If no file is left.
    """
    room, bad, lost = WHOLE_BYTES, list(inputs.bad), []
    for source in inputs.sources:
        room -= source.file.size_bytes if source.file.layout == "csv" else 0
        if source.file.layout != "csv" or room < 0:
            continue
        try:
            look_through(source.path, source.file.layout, source.beams[0].name, cell_m)
        except InputError as error:
            lost.append(source)
            bad.append(error)
    if inputs.sources and len(lost) == len(inputs.sources):
        raise WorkflowError("no input is usable: " + "; ".join(merged_faults(bad)))
    return FirstLook(
        tuple(merged_faults(bad[len(inputs.bad) :])),
        unreadable=len(lost),
        unreadable_points=sum(beam.photons for source in lost for beam in source.beams),
    )
