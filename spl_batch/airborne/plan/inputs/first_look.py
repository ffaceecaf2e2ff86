"""What headers, and a few points of each file, tell of a survey before it is run.

A run reads every point and judges by all of them. A plan has a second: it looks at the first
points of a file and at those where its last chunk starts, and at both ends of each trajectory.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.plan.flightlines import points_of_a_shot
from spl_batch.airborne.plan.inputs.channel_dimension import POINTS_A_BEAMLET, unnamed_channels
from spl_batch.airborne.plan.inputs.survey_inputs import Inputs, Source
from spl_batch.airborne.sensors.sensor import Sensor
from spl_batch.airborne.settings.workflow import Workflow
from spl_batch.engine.plan.input_files import name_below
from spl_batch.errors import InputError, named
from spl_batch.formats.gps_clock import clock, time_standard, usable_times
from spl_batch.formats.las.number_dimensions import Numbers
from spl_batch.formats.las.reader import SAMPLE_POINTS, Ends, read_ends
from spl_batch.formats.trajectory.ends import ends

SAMPLE_FILES: Final = 200
"""Files that are looked into, evenly among more of them [count]: a hundred take half a second."""

FEW_CHANNELS: Final = 10
"""A dimension that holds less than this part of the beamlets' numbers holds something else."""

Span = tuple[float, float]


@dataclass
class _Seen:
    """What was seen of the files."""

    spans: dict[str, Span] = field(default_factory=dict)
    untimed: list[str] = field(default_factory=list)
    channels: dict[str, str] = field(default_factory=dict)
    numbers: dict[str, dict[str, Numbers]] = field(default_factory=dict)
    faults: list[str] = field(default_factory=list)


def first_look(
    inputs: Inputs, workflow: Workflow, base: Path
) -> tuple[tuple[str, ...], tuple[str, ...], bool]:
    """What is wrong with inputs, and what is odd, as far as their ends tell.

    Returns
    -------
    faults, warnings : tuple of str
        One sentence for all files that share it: file, value, remedy.
    refused : bool
        Whether a run stops at them: it has no times, or no trajectory, to filter by.
    """
    if workflow.filter.method == "none" and not workflow.afterpulse.enabled:
        return (), (), False
    formats = [s for s in inputs.sources if s.facts.n_points and not s.facts.has_gps_time]
    timed = [s for s in inputs.sources if s.facts.n_points and s.facts.has_gps_time]
    some = np.unique(np.linspace(0, len(timed) - 1, min(len(timed), SAMPLE_FILES)).astype(int))
    seen = _Seen()
    for k in some.tolist():
        _look_into(timed[k], workflow, seen)
    faults, warnings = _without_time(formats, seen.untimed, all_of_them=not timed)
    warnings += _few_channels(seen.channels, workflow)
    warnings += unnamed_channels(seen.numbers, workflow.sensor)
    apart, missed = _apart(seen.spans, inputs.trajectory, base)
    refused = bool(faults or apart)
    return (*seen.faults, *faults, *apart), (*warnings, *missed), refused


def holds_few(channels: int, points: int, sensor: Sensor) -> bool:
    """Whether a dimension has too few different values to be that of the beamlets."""
    enough = points >= POINTS_A_BEAMLET * sensor.beamlets and sensor.beamlets > FEW_CHANNELS
    return enough and FEW_CHANNELS * channels <= sensor.beamlets


def _look_into(source: Source, workflow: Workflow, seen: _Seen) -> None:
    try:
        found = read_ends(source.path, workflow.survey.channel_dimension, SAMPLE_POINTS)
    except InputError as error:
        seen.faults.append(str(error))
        return
    time = found.gps_time[usable_times(found.gps_time)]
    if len(time) and (len(time) <= points_of_a_shot(workflow) or np.any(time != time[0])):
        seen.spans[source.name] = float(time.min()), float(time.max())
    else:
        seen.untimed.append(source.name)
    if workflow.survey.channel_dimension is not None:
        _look_at_channels(source.name, found, workflow.sensor, seen)
    else:
        seen.numbers[source.name] = found.numbers


def _look_at_channels(name: str, found: Ends, sensor: Sensor, seen: _Seen) -> None:
    values: NDArray[np.int64] = np.unique(found.channel.astype(np.int64))
    if holds_few(len(values), len(found.channel), sensor):
        seen.channels[name] = ", ".join(map(str, values.tolist()))


def _without_time(
    formats: Sequence[Source], untimed: Sequence[str], *, all_of_them: bool
) -> tuple[list[str], list[str]]:
    """Faults where no file has times, else warnings."""
    otherwise = "or set filter.method: none and afterpulse.enabled: false for ground and surfaces"
    said = []
    if formats:
        kinds = ", ".join(map(str, sorted({source.facts.point_format for source in formats})))
        names = named([source.name for source in formats], 3)
        remedy = f"write point format 1, 3 or 6 to 10 with times, {otherwise}"
        said.append((f"{names}: point format {kinds} has no gps_time", remedy))
    if untimed:
        text = (
            f"{named(untimed, 3)}: the first and last points have no usable gps_time (not finite, "
            "or the same for all)"
        )
        said.append((text, f"give the files their times, {otherwise}"))
    if formats and all_of_them:
        return [f"{text}, so there are no shots to filter by; {best}" for text, best in said], []
    return [], [f"{text}, and such points are delivered unfiltered; {best}" for text, best in said]


def _few_channels(channels: dict[str, str], workflow: Workflow) -> list[str]:
    alike: dict[str, list[str]] = {}
    for name, values in channels.items():
        alike.setdefault(values, []).append(name)
    sensor, key = workflow.sensor, workflow.survey.channel_dimension
    return [
        f"survey.channel_dimension: {key} holds only {values} in the first and last points of "
        f"{named(names, 3)}, and {sensor.name} has {sensor.beamlets} beamlets; name the dimension "
        "that holds their numbers, or leave the key out: a shot is one beamlet then; a run stops "
        "if all points are like these"
        for values, names in alike.items()
    ]


def _apart(
    spans: dict[str, Span], trajectory: Sequence[Path], base: Path
) -> tuple[list[str], list[str]]:
    """Trajectories that cannot be read are a fault; files whose ends lie beside all are odd."""
    faults: list[str] = []
    known: list[Span] = []
    for path in trajectory:
        try:
            span = ends(path)
        except InputError as error:
            faults.append(f"survey.trajectory: {error}")
            continue
        if span is None:
            return faults, []
        known.append(span)
    if not known or not spans or faults:
        return faults, []
    names = named([name_below(path, base) for path in trajectory], 3)
    try:
        known = in_time_of(list(spans.values()), known)
    except ValueError as error:
        return [f"survey.trajectory: {names}: {error}"], []
    far = {name: gap for name, span in spans.items() if (gap := gap_s(span, known)) > 0}
    if not far:
        return [], []
    low, high = (choose(spans[name][k] for name in far) for k, choose in enumerate((min, max)))
    none = len(far) == len(spans)
    follows = "no point could be filtered" if none else "such points stay unfiltered"
    text = (
        f"{named(list(far), 3)}: gps_time of the first and last points, {low:.0f} to {high:.0f} s, "
        f"is {min(far.values()):.1f} s or more outside {names}, {min(known)[0]:.0f} to "
        f"{max(end for _, end in known):.0f} s: {follows}; name the trajectory of this "
        "flight, or none"
    )
    return ([text], []) if none else ([], [text])


def in_time_of(points: Sequence[Span], known: Sequence[Span]) -> list[Span]:
    """Spans of trajectories in the time standard of the points."""
    whole, own = (
        (min(low for low, _ in spans), max(high for _, high in spans)) for spans in (points, known)
    )
    convert = clock(time_standard(np.array(own)), own, whole, time_standard(np.array(whole)))
    if convert is None:
        return list(known)
    return [(float(low), float(high)) for low, high in (convert(np.array(k)) for k in known)]


def gap_s(span: Span, known: Sequence[Span]) -> float:
    """Time between a span and the nearest of others; 0 where it meets one [s]."""
    return max(min(max(low - span[1], span[0] - high) for low, high in known), 0.0)
