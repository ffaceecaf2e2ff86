"""What headers, and a few points of each file, tell of a survey before it is run.

Tasks read every point and judge by all of them. Before that, plan and run take a second to look at
the first points of a file and at those where its last chunk starts, or at all of a small survey,
and at both ends of each trajectory. Both refuse what shows there that nothing could be done.
"""

from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import groupby
from pathlib import Path
from typing import Final

import numpy as np

from spl_batch.airborne.findings import CODES
from spl_batch.airborne.plan.flightlines import points_of_a_shot
from spl_batch.airborne.plan.inputs.channel_dimension import POINTS_A_BEAMLET, unnamed_channels
from spl_batch.airborne.plan.inputs.linear_mode import Density
from spl_batch.airborne.plan.inputs.survey_inputs import Inputs, Source
from spl_batch.airborne.sensors.sensor import Sensor
from spl_batch.airborne.settings.workflow import Workflow
from spl_batch.engine.findings import Finding
from spl_batch.engine.plan.input_files import name_below
from spl_batch.engine.tasks.input_changes import stamp_if_there
from spl_batch.engine.verbs.receiver import FirstLook
from spl_batch.errors import (
    InputError,
    WorkflowError,
    as_input_fault,
    grouped,
    named,
    told_together,
)
from spl_batch.formats.gps_clock import TimeStandard, clock, time_standard, usable_times
from spl_batch.formats.las.reader import SAMPLE_POINTS, Numbers, iter_points, read_ends
from spl_batch.formats.trajectory.records import ends, read_records
from spl_batch.lattice.tables import PointTable

SAMPLE_FILES: Final = 200
"""Files that are looked into, evenly among more of them [count]: a hundred take half a second."""

WHOLE_POINTS: Final = 250_000
"""Points that all files share at each of their ends [count]: a small survey is read whole."""

WHOLE_BYTES: Final = 100_000_000
"""Bytes of trajectories that are read to the end [byte]: that takes half a second."""

SPREAD: Final = 20
"""Places at which a file is looked at before its channels are refused [count]: where points are in
order of their beamlet, so many hold more than the tenth of the beamlets that are too few."""

FEW_CHANNELS: Final = 10
"""A dimension that holds less than this part of the beamlets' numbers holds something else."""

Span = tuple[float, float]


@dataclass
class _Seen:
    """What was seen of the files."""

    spans: dict[str, Span] = field(default_factory=dict)
    untimed: list[str] = field(default_factory=list)
    unused: list[str] = field(default_factory=list)
    channels: dict[str, tuple[int, ...]] = field(default_factory=dict)
    few: list[str] = field(default_factory=list)
    sources: dict[str, tuple[int, ...]] = field(default_factory=dict)
    points: int = 0
    #: Whether all points of all files were looked at.
    whole: bool = True
    numbers: dict[str, dict[str, Numbers]] = field(default_factory=dict)
    density: Density = field(default_factory=Density)
    unreadable: list[InputError] = field(default_factory=list)


def first_look(inputs: Inputs, workflow: Workflow, base: Path) -> FirstLook:
    """What is wrong with inputs, and what is odd, as far as their ends tell.

    Raises
    ------
    WorkflowError
        If nothing could be filtered: no file can be read or has times, the dimension that is named
        holds no beamlet numbers, or the trajectory is of no file's time. One line: fault, remedy.
    """
    held = [source for source in inputs.sources if source.facts.n_points]
    some = np.unique(np.linspace(0, len(held) - 1, min(len(held), SAMPLE_FILES)).astype(int))
    seen = _Seen(whole=len(some) == len(held))
    for k in some.tolist():
        _look_into(held[k], workflow, max(SAMPLE_POINTS, WHOLE_POINTS // len(some)), seen)
    if len(seen.unreadable) == len(held):
        reasons = told_together([*inputs.bad, *seen.unreadable])
        raise WorkflowError("no input is usable: " + "; ".join(reasons))
    if len(seen.unused) == len(held):
        raise WorkflowError(no_use(seen.unused))
    paths = {error.path for error in seen.unreadable}
    lost = [source.facts.n_points for source in held if str(source.path) in paths]
    found = FirstLook(
        tuple(told_together(seen.unreadable)),
        unreadable=len(lost),
        unreadable_points=sum(lost),
        late=tuple(told_together(inputs.reference.bad)),
        warnings=tuple(Finding("I01", {"kind": "withheld"}, name) for name in seen.unused),
    )
    if workflow.filter.method == "none" and not workflow.afterpulse.enabled:
        return found
    formats = [source for source in held if not source.facts.has_gps_time]
    faults, warnings = _without_time(formats, seen, all_of_them=len(formats) == len(held))
    faults += _no_channels(held, seen, workflow)
    spans, unread, left_out = _ends(inputs.trajectory)
    apart, missed = _apart(seen.spans, spans, inputs.trajectory, base)
    if unread and (apart or len(unread) == len(inputs.trajectory)):
        apart = [*(f"survey.trajectory: {text}" for text in told_together(unread)), *apart]
    if faults or apart:
        reasons = told_together([*inputs.bad, *seen.unreadable])
        raise WorkflowError("; ".join((*reasons, *faults, *apart)))
    warnings += _few_channels(seen, workflow)
    warnings += [Finding("T02", {"kind": "file", "what": text}) for text in left_out]
    warnings += unnamed_channels(seen.numbers, workflow.sensor) or _linear_mode(seen, workflow)
    rows = (*_flightlines(seen, workflow), *_missing(inputs, workflow))
    told = (*found.faults, *told_together(unread))
    return found._replace(faults=told, warnings=(*found.warnings, *warnings, *missed), rows=rows)


def _flightlines(seen: _Seen, workflow: Workflow) -> Iterator[tuple[str, str]]:
    """How files share flightlines, where they are not a flightline each."""
    held = list(seen.sources.values())
    ids = {source for some in held for source in some}
    several = sum(len(some) > 1 for some in held)
    pieces = sum(map(len, held)) - len(ids)
    if ids == {0} and len(held) > 1:
        pause = f"{workflow.survey.gap_s:g} s"
        yield (
            "flightlines",
            f"point_source_id is 0 in all files: a run tells them by pauses of {pause}",
        )
    elif several or pieces:
        whose = f"{grouped(several)} of {grouped(len(held))} files hold several"
        if len(held) == 1:
            whose = "the file holds several"
        text = f"at least {grouped(len(ids))}, by point_source_id; {whose}"
        yield "flightlines", f"{text}: a run puts the parts of each together"


def _missing(inputs: Inputs, workflow: Workflow) -> Iterator[tuple[str, str]]:
    """What the survey has not, and what a run takes instead."""
    if not inputs.trajectory:
        text = (
            "none: beams come from where lines of sight meet, lean by scan_angle, or are vertical"
        )
        yield "trajectory", text
    if workflow.survey.channel_dimension is None and workflow.sensor.beamlets > 1:
        text = "not numbered, as survey.channel_dimension is not set: a shot counts as one beamlet"
        yield "beamlets", text


def _linear_mode(seen: _Seen, workflow: Workflow) -> tuple[Finding, ...]:
    """That the filter may be wrong for the clouds, unless somebody has named the instrument."""
    signs = seen.density.signs
    if not signs or "sensor" in workflow.survey.model_fields_set:
        return ()
    return (Finding("I04", {"kind": "linear", "signs": signs}),)


def holds_few(channels: int, points: int, sensor: Sensor) -> bool:
    """Whether a dimension has too few different values to be that of the beamlets."""
    enough = points >= POINTS_A_BEAMLET * sensor.beamlets and sensor.beamlets > FEW_CHANNELS
    return enough and FEW_CHANNELS * channels <= sensor.beamlets


def no_use(names: Sequence[str]) -> str:
    """That none of these files, which are all, has a point to work with, and what helps."""
    fault = CODES["I01"].sentence("withheld")
    return f"{named(names)}: {fault}; clear the flag or the class of those that are valid"


def too_few(values: Iterable[int], where: str, workflow: Workflow) -> str:
    """That the dimension that is named holds too few values, and what helps.

    Parameters
    ----------
    values : iterable of int
        What it holds.
    where : str
        Points that were looked at, in words.
    workflow : Workflow
        The settings.
    """
    key, sensor = workflow.survey.channel_dimension, workflow.sensor
    return (
        f"survey.channel_dimension: {key} holds only {', '.join(map(str, sorted(values)))} in "
        f"{where}, and {sensor.name} has {sensor.beamlets} beamlets; name the dimension that holds "
        "their numbers, or leave the key out: a shot is one beamlet then"
    )


def in_files(points: int, files: Sequence[str]) -> str:
    """So many points of these files, as :func:`too_few` has it."""
    return f"{grouped(points)} points ({named(files, 3)})"


def _look_into(source: Source, workflow: Workflow, count: int, seen: _Seen) -> None:
    try:
        found = read_ends(source.path, workflow.survey.channel_dimension, count)
    except InputError as error:
        seen.unreadable.append(error)
        return
    if not found.used and len(found.channel) == source.facts.n_points:
        seen.unused.append(source.name)
    if not source.facts.has_gps_time:
        return
    seen.sources[source.name] = found.sources
    seen.points += len(found.channel)
    seen.whole &= len(found.channel) == source.facts.n_points
    time = found.gps_time[usable_times(found.gps_time)]
    if len(time) and (len(time) <= points_of_a_shot(workflow) or np.any(time != time[0])):
        seen.spans[source.name] = float(time.min()), float(time.max())
    else:
        seen.untimed.append(source.name)
    if workflow.survey.channel_dimension is None:
        seen.numbers[source.name] = found.numbers
        seen.density.add(source.facts, found.gps_time)
        return
    values = tuple(np.unique(found.channel.astype(np.int64)).tolist())
    seen.channels[source.name] = values
    if holds_few(len(values), len(found.channel), workflow.sensor):
        seen.few.append(source.name)


def _without_time(
    formats: Sequence[Source], seen: _Seen, *, all_of_them: bool
) -> tuple[list[str], list[Finding]]:
    """Faults where no file has times, else warnings."""
    otherwise = "or set filter.method: none and afterpulse.enabled: false for ground and surfaces"
    if not (all_of_them or (seen.whole and seen.untimed and not seen.spans)):
        kind = "file" if seen.whole else "ends"
        return [], [
            *(
                Finding("I02", {"kind": "format", "format": s.facts.point_format}, s.name)
                for s in formats
            ),
            *(Finding("I02", {"kind": kind}, name) for name in seen.untimed),
        ]
    faults = []
    if formats:
        kinds = ", ".join(map(str, sorted({source.facts.point_format for source in formats})))
        names = named([source.name for source in formats], 3)
        remedy = f"write point format 1, 3 or 6 to 10 with times, {otherwise}"
        faults.append((f"{names}: point format {kinds} has no gps_time", remedy))
    if seen.untimed:
        whom = "no point has a" if seen.whole else "the first and last points have no"
        text = f"{named(seen.untimed, 3)}: {whom} usable gps_time (not finite, or the same for all)"
        faults.append((text, f"give the files their times, {otherwise}"))
    return [f"{text}, so there are no shots to filter by; {best}" for text, best in faults], []


def _no_channels(held: Sequence[Source], seen: _Seen, workflow: Workflow) -> list[str]:
    """A fault where no file's channels are beamlets, at more places than its ends."""
    values = {value for some in seen.channels.values() for value in some}
    if not values or not holds_few(len(values), seen.points, workflow.sensor):
        return []
    most = max((s for s in held if s.name in seen.channels), key=lambda s: s.facts.n_points)
    if not seen.whole:
        try:
            for table in _spread(most, workflow):
                values |= set(np.unique(table["channel"]).tolist())
                seen.points += len(table)
        except InputError:
            return []  # the task that reads the file tells of it, and of what other files hold
    if not holds_few(len(values), seen.points, workflow.sensor):
        return []
    return [too_few(values, in_files(seen.points, [*seen.channels]), workflow)]


def _spread(source: Source, workflow: Workflow) -> Iterator[PointTable]:
    """Points from evenly spaced places of a file."""
    last = source.facts.n_points - SAMPLE_POINTS
    for start in np.linspace(0, max(last, 0), SPREAD).astype(int).tolist():
        yield from iter_points(
            source.path,
            channel_dimension=workflow.survey.channel_dimension,
            source=source.key,
            start=start,
            stop=start + SAMPLE_POINTS,
        )


def _few_channels(seen: _Seen, workflow: Workflow) -> Iterator[Finding]:
    """Which files have fewer channels than others, as far as their ends show."""
    for name in seen.few:
        numbers = sorted(seen.channels[name])
        values = {
            "kind": "few", "dimension": workflow.survey.channel_dimension, "numbers": numbers,
            "sensor": workflow.sensor.name, "beamlets": workflow.sensor.beamlets,
        }  # fmt: skip
        yield Finding("I04", values, name, badness=-len(numbers))


def _ends(trajectory: Sequence[Path]) -> tuple[list[Span | None], list[InputError], list[str]]:
    """First and last times of the trajectories that can be read, and what is wrong with others.

    What is left out of them comes last.
    """
    found: list[Span | None] = []
    faults: list[InputError] = []
    left, told = WHOLE_BYTES, list[str]()
    for path in trajectory:
        left -= stamp_if_there(path)[0]
        try:
            found.append(ends(path))
            if left >= 0:
                with as_input_fault(path):
                    deque(read_records(path, told.append), maxlen=0)
        except InputError as error:
            faults.append(error)
    return found, faults, told


def _apart(
    spans: dict[str, Span], ends_s: Sequence[Span | None], trajectory: Sequence[Path], base: Path
) -> tuple[list[str], list[Finding]]:
    """Faults where no file's ends lie in the time of a trajectory, else what is odd."""
    known = [span for span in ends_s if span is not None]
    if not known or not spans or len(known) < len(ends_s):
        return [], []
    names = named([name_below(path, base) for path in trajectory], 3)
    try:
        known = in_time_of(list(spans.values()), known)
    except ValueError as error:
        # A single wrong time may be among the first and last ones; the index knows all of them.
        text = f"{error}, if the first and last times are right"
        return [], [Finding("T02", {"kind": "file", "what": text}, names)]
    far = {name: gap for name, span in spans.items() if (gap := gap_s(span, known)) > 0}
    if not far:
        return [], []
    low, high = (choose(spans[name][k] for name in far) for k, choose in enumerate((min, max)))
    if len(far) < len(spans):
        return [], [
            Finding(
                "T02",
                {
                    "kind": "ends", "low_s": spans[name][0], "high_s": spans[name][1],
                    "gap_s": gap, "trajectory": names,
                },
                name,
                badness=gap,
            )
            for name, gap in far.items()
        ]  # fmt: skip
    text = (
        f"{named(list(far), 3)}: gps_time of the first and last points, {grouped(low)} to "
        f"{grouped(high)} s, is {grouped(min(far.values()), 1)} s or more outside {names}, "
        f"{grouped(min(known)[0])} to {grouped(max(end for _, end in known))} s: "
        "no point could be filtered; name the trajectory of this flight, or none"
    )
    return [f"survey.trajectory: {text}"], []


def in_time_of(points: Sequence[Span], known: Sequence[Span]) -> list[Span]:
    """Spans of trajectories, in whatever standards, in that of the points; sorted by standard."""
    whole = _whole(points)
    found: list[Span] = []
    for standard, spans in groupby(sorted(known, key=_standard), key=_standard):
        own = list(spans)
        convert = clock(standard, _whole(own), whole, _standard(whole))
        moved = own if convert is None else [convert(np.array(span)) for span in own]
        found += [(float(low), float(high)) for low, high in moved]
    return found


def _whole(spans: Sequence[Span]) -> Span:
    return min(low for low, _ in spans), max(high for _, high in spans)


def _standard(span: Span) -> TimeStandard:
    return time_standard(np.array(span))


def gap_s(span: Span, known: Sequence[Span]) -> float:
    """Time between a span and the nearest of others; 0 where it meets one [s]."""
    return max(min(max(low - span[1], span[0] - high) for low, high in known), 0.0)
