"""Inputs, phases and cost of ``kind: altimetry``."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

from spl_batch.altimetry.filter.peer_filters import PEERS
from spl_batch.altimetry.formats.atl08 import no_atl08
from spl_batch.altimetry.formats.photons import BeamFacts, TrackFile, inspect
from spl_batch.altimetry.settings import TrackWorkflow
from spl_batch.altimetry.tasks.context import Context
from spl_batch.altimetry.tasks.delivery import PASS_PHOTONS
from spl_batch.engine.findings import Finding
from spl_batch.engine.plan.budget import Cost, measured_rates
from spl_batch.engine.plan.input_files import (
    check_keys,
    expand,
    name_below,
    refuse_own,
    source_key,
    stem_names,
)
from spl_batch.engine.plan.worker_memory import WORKER_BASE_BYTES
from spl_batch.engine.tasks.input_changes import stamp
from spl_batch.engine.tasks.ledger import Ledger, Phase
from spl_batch.engine.tasks.task import Task
from spl_batch.errors import InputError, WorkflowError
from spl_batch.lattice.tiles import quanta

RATES_PHOTONS_PER_S: Final[Mapping[str, float]] = MappingProxyType(
    {"index": 2.0e6, "rate": 1.5e6, "signal": 0.2e6, "profile": 1.0e6, "deliver": 0.8e6}
)
"""Photons per second and worker until a store has measured its own; ``benchmarks/altimetry``."""

BYTES_PER_PHOTON: Final = 400
"""Memory of a segment's task by each of its photons, halo included [byte]."""

PEER_BYTES_PER_PHOTON: Final = 2000
"""The same where a published filter holds a whole beam and each photon's neighbours [byte]."""

DISK_BYTES_PER_PHOTON: Final = 45
"""Working store and results [byte]."""

REMEDIES: Final[Mapping[str, str]] = MappingProxyType(
    {"score": "lower work.segment_photons or signal.reach_m"}
)


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

    def segments(self, key: str) -> list[tuple[str, int, int]]:
        """Scored segments of a beam: name, and the span of track of each [quanta]."""
        size = quanta(self.workflow.rate.cell_m)
        scored = self.of("score")
        return [
            (f"{key}/{low}", low * size, high * size)
            for low, high, _ in self.of("rate")[key].facts["segments"]
            if f"{key}/{low}" in scored
        ]


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
    good, bad, warnings = _inspect(paths, workflow)
    sources = []
    for path, file, beams in good:
        name = name_below(path, base)
        sources.append(Source(path, name, source_key(name), file, beams))
    check_keys(sources)
    labels, said = _atl08(found.get("labels", ()), base, sources)
    return Inputs(
        tuple(sorted(sources, key=lambda s: s.name)),
        tuple(bad),
        (*warnings, *said),
        tuple(path for paths in found.values() for path in paths),
        labels,
    )


def _atl08(
    files: Sequence[Path], base: Path, sources: Sequence[Source]
) -> tuple[tuple[Path, ...], tuple[Finding, ...]]:
    """Files that are of ATL08, and what to say of the others."""
    good, said = [], []
    for path in files:
        why = no_atl08(path)
        if why:
            name = f"reference.labels {name_below(path, base)}"
            said.append(Finding("P01", {"kind": "labels", "what": why}, name))
        else:
            good.append(path)
    if good and sources and not any(s.file.layout == "atl03" for s in sources):
        text = "ATL08 is of ATL03's photons alone, and track.photons has none"
        said.append(Finding("P01", {"kind": "labels", "what": text}, "reference.labels"))
    return tuple(good), tuple(said)


def _inspect(
    paths: Sequence[Path], workflow: TrackWorkflow
) -> tuple[list[tuple[Path, TrackFile, tuple[BeamFacts, ...]]], list[InputError], list[Finding]]:
    good, bad, without = [], [], []
    wanted = workflow.track.beams
    for path in paths:
        try:
            file = inspect(path, workflow.track.prf_hz)
        except InputError as error:
            bad.append(error)
            continue
        beams = tuple(b for b in file.beams if not wanted or b.name in wanted)
        if not beams:
            names = ", ".join(b.name for b in file.beams)
            bad.append(InputError(str(path), f"none of track.beams is in it; it has {names}"))
            continue
        if workflow.rate.source == "product":
            without += [f"{path.name} {b.name}" for b in beams if not b.background]
        good.append((path, file, beams))
    return good, bad, [Finding("P01", {"kind": "rate"}, name) for name in without]


def _index(tracks: Tracks) -> Iterator[Task]:
    for source in tracks.inputs.sources:
        args = {
            "source": str(source.key),
            "path": str(source.path),
            "name": source.name,
            "stamp": [source.file.size_bytes, source.file.written_ns],
        }
        yield Task("index_file", str(source.key), args, (), 0)


def _take_in(tracks: Tracks) -> Iterator[Task]:
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


def _rate(tracks: Tracks) -> Iterator[Task]:
    for name, receipt in tracks.of("take_in").items():
        args = {"key": name, "background": receipt.facts["background"]}
        yield Task("rate", name, args, (("take_in", name),), receipt.points)


def _score(tracks: Tracks) -> Iterator[Task]:
    for name, receipt in tracks.of("rate").items():
        for low, high, photons in receipt.facts["segments"]:
            args = {"key": name, "segment": f"{name}/{low}", "cells": [low, high]}
            needs = (("take_in", name), ("rate", name))
            yield Task("score", f"{name}/{low}", args, needs, photons)


def _select(tracks: Tracks) -> Iterator[Task]:
    for name, receipt in tracks.of("rate").items():
        segments = tracks.segments(name)
        needs = (("rate", name), *(("score", s) for s, _, _ in segments))
        yield Task("select", name, {"key": name, "segments": segments}, needs, receipt.points)


def _profile(tracks: Tracks) -> Iterator[Task]:
    layouts = {key: source.file.layout for source, _, key in tracks.beams()}
    for name, receipt in tracks.of("select").items():
        segments = tracks.segments(name)
        needs = (
            ("select", name),
            ("take_in", name),
            *(("score", s) for s, _, _ in segments),
        )
        args = {
            "key": name,
            "layout": layouts[name],
            "segments": segments,
            "points": receipt.points,
        }
        yield Task("profile", name, args, needs, receipt.points)


def _compare(tracks: Tracks) -> Iterator[Task]:
    if tracks.workflow.reference is None:
        return
    stamps = [[str(path), *stamp(path)] for path in tracks.inputs.reference]
    for source, beam, key in tracks.beams():
        if key not in tracks.of("profile"):
            continue
        segments = tracks.segments(key)
        needs = (
            ("profile", key),
            ("select", key),
            *(("score", s) for s, _, _ in segments),
        )
        labels = tracks.inputs.labels if source.file.layout == "atl03" else ()
        args = {
            **_beam_args(source, beam, key),
            "segments": segments,
            "reference": stamps,
            "labels": [str(path) for path in labels],
        }
        yield Task("compare", key, args, needs, tracks.of("profile")[key].points)


def _delivery(tracks: Tracks, source: Source, beam: BeamFacts, key: str) -> dict[str, Any]:
    return {
        "key": key,
        "delivered": f"{tracks.delivered[source.key]}/{beam.name}",
        "segments": [s for s, _, _ in tracks.segments(key)],
        "points": tracks.of("take_in")[key].points,
    }


def _delivery_needs(args: Mapping[str, Any]) -> tuple[tuple[str, str], ...]:
    key = args["key"]
    return (("select", key), ("profile", key), *(("score", s) for s in args["segments"]))


def _deliver_beam(tracks: Tracks) -> Iterator[Task]:
    for source, beam, key in tracks.beams():
        if key in tracks.of("profile"):
            args = _delivery(tracks, source, beam, key)
            yield Task("deliver_beam", key, args, _delivery_needs(args), args["points"])


def _deliver_file(tracks: Tracks) -> Iterator[Task]:
    if not tracks.workflow.outputs.hdf5:
        return
    for source in tracks.inputs.sources:
        beams = [
            (beam, f"{source.key}/{beam.name}")
            for beam in source.beams
            if f"{source.key}/{beam.name}" in tracks.of("profile")
        ]
        if source.file.layout == "csv" or not beams:
            continue
        listed = [{**_delivery(tracks, source, b, k), "group": b.group} for b, k in beams]
        args = {
            "source": str(source.key),
            "path": str(source.path),
            "delivered": f"{tracks.delivered[source.key]}{source.path.suffix}",
            "beams": listed,
        }
        needs = tuple(need for beam in listed for need in _delivery_needs(beam))
        points = sum(beam["points"] for beam in listed)
        yield Task("deliver_file", str(source.key), args, needs, points)


PHASES: Final = (
    Phase("index_file", _index),
    Phase("take_in", _take_in),
    Phase("rate", _rate),
    Phase("score", _score),
    Phase("select", _select),
    Phase("profile", _profile),
    Phase("compare", _compare),
    Phase("deliver_beam", _deliver_beam),
    Phase("deliver_file", _deliver_file),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class TrackCost(Cost):
    """What a run on photon profiles is expected to cost; beams and segments are counted."""

    beams: int
    segments: int


def estimate(tracks: Tracks, context: Context | None = None) -> TrackCost:
    """Cost of a run, from what headers say.

    Parameters
    ----------
    context : Context, optional
        Where measured rates may lie.
    """
    workflow = tracks.workflow
    photons = [beam.photons for _, beam, _ in tracks.beams()]
    segments = sum(-(-n // workflow.work.segment_photons) for n in photons)
    longest = max(photons, default=0)
    if workflow.signal.method in PEERS:
        held = longest * PEER_BYTES_PER_PHOTON // BYTES_PER_PHOTON
    else:
        held = max(min(longest, workflow.work.segment_photons), PASS_PHOTONS // 10)
    rates, measured = measured_rates(RATES_PHOTONS_PER_S, context)
    files = len(tracks.inputs.sources)
    return TrackCost(
        points=sum(photons),
        beams=len(photons),
        segments=segments,
        tasks=2 * files + 6 * len(photons) + segments,
        disk_bytes=sum(photons) * DISK_BYTES_PER_PHOTON
        + sum(s.file.size_bytes for s in tracks.inputs.sources),
        memory_bytes=WORKER_BASE_BYTES + held * BYTES_PER_PHOTON,
        heaviest="the longest segment of track",
        remedy=REMEDIES["score"],
        stages_s={stage: sum(photons) / rate for stage, rate in rates.items()},
        workers=tracks.workers,
        measured=measured,
    )
