"""Tasks of the index and of the time domain: files, trajectory, flightlines, stretches.

Each function turns what is finished into the next tasks, and looks only at receipts of earlier
steps. What failed there is left out: its points stay unlabelled, the rest goes on.
"""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from spl_batch.airborne.filter.published import OF_SHOTS
from spl_batch.airborne.plan.flightlines import Flightline
from spl_batch.airborne.plan.inputs.survey_inputs import source_args
from spl_batch.airborne.plan.survey_ledger import Survey
from spl_batch.airborne.tasks.index import POSITIONS_S, part_name, part_range, parts_of
from spl_batch.constants import QUANTA_PER_M
from spl_batch.engine.plan.input_files import source_key
from spl_batch.engine.tasks.input_changes import stamp_if_there
from spl_batch.engine.tasks.task import Need, Task

FEW_POINTS: Final = 0.001
"""Share of all points up to which the times of a flightline may be wrong ones."""


def trajectory_file(survey: Survey) -> Iterator[Task]:
    """Trajectory files, each by itself: before hours of work rest on them."""
    for path in survey.inputs.trajectory if survey.filtering else ():
        args = {"path": str(path), "stamp": stamp_if_there(path)}
        yield Task("trajectory_file", _file_task(path), args)


def _file_task(path: Path) -> str:
    """Name of the task that looks through a trajectory file."""
    return str(source_key(str(path)))


def index_part(survey: Survey) -> Iterator[Task]:
    """Parts of input files, each to be read."""
    for source in survey.inputs.sources:
        n_points, stamp = source.facts.n_points, stamp_if_there(source.path)
        for part in range(parts_of(n_points)):
            args = {**source_args(source), "stamp": stamp, "part": part}
            start, stop = part_range(n_points, part)
            yield Task("index_part", f"{source.key}/{part}", args, (), stop - start)


def index_file(survey: Survey) -> Iterator[Task]:
    """Input files, each joined of its parts."""
    done = survey.of("index_part")
    for source in survey.inputs.sources:
        parts = [f"{source.key}/{part}" for part in range(parts_of(source.facts.n_points))]
        if not all(part in done for part in parts):
            continue
        facts = [done[part].facts for part in parts]
        now = stamp_if_there(source.path)
        # A file that has changed since some part of it was read is not the one that it was, and
        # none that can be joined of parts.
        then = [fact["stamp"] for fact in facts if fact["stamp"] != now]
        args = {
            **source_args(source),
            "name": source.name,
            "stamp": then[0] if then else now,
            "parts": len(parts),
            "faults": {str(k): one["faults"] for k, one in enumerate(facts) if "faults" in one},
        }
        needs = tuple(("index_part", part) for part in parts)
        yield Task("index_file", str(source.key), args, needs)


def trajectory(survey: Survey) -> Iterator[Task]:
    """One task that joins the trajectory's files."""
    lines = survey.flightlines
    checked = survey.of("trajectory_file")
    sound = [path for path in survey.inputs.trajectory if _file_task(path) in checked]
    if not sound or not lines:
        return
    args = {
        "paths": [str(path) for path in sound],
        "stamps": [stamp_if_there(path) for path in sound],
        "time_span_s": _time_of_most(lines),
        "bounds_m": [end / QUANTA_PER_M for end in survey.bounds],
    }
    needs = tuple(("trajectory_file", _file_task(path)) for path in sound)
    yield Task("trajectory", "all", args, needs)


def _time_of_most(lines: Sequence[Flightline]) -> list[float]:
    """First and last time of all flightlines but those of next to no points [s].

    A few wrong times are no time of the survey's, and would leave open in which week a trajectory
    was flown.
    """
    points = [line.points for line in lines]
    few = min(FEW_POINTS * sum(points), max(points) / 2)  # of thousands none has that share
    most = [line for line in lines if line.points > few]
    return [min(line.first_s for line in most), max(line.last_s for line in most)]


def sights(survey: Survey) -> Iterator[Task]:
    """Stretches whose lines of sight are to show the sensor's path, without a trajectory."""
    if not survey.inputs.trajectory:
        yield from _of_stretches("sights", survey)


def observe(survey: Survey) -> Iterator[Task]:
    """Stretches, once their beams are known."""
    yield from _of_stretches("observe", survey)


def _of_stretches(kind: str, survey: Survey) -> Iterator[Task]:
    """Tasks of all stretches, whether they hold points or not."""
    for line in survey.flightlines:
        stretches, needs = list(line.stretches()), _line_needs(survey, line)
        for name, k in stretches:
            args = _stretch_args(survey, line, name, k)
            yield Task(kind, name, args, needs, line.points // len(stretches))


def _with_points(kind: str, survey: Survey, line: Flightline) -> list[tuple[str, int]]:
    """Names and numbers of the stretches in which a step has found points."""
    done = survey.of(kind)
    return [(n, k) for n, k in line.stretches() if n in done and done[n].facts["points"]]


def sensor_path(survey: Survey) -> Iterator[Task]:
    """Flightlines whose sensor's path is looked for, without a trajectory."""
    if not survey.inputs.trajectory:
        yield from _of_lines("sensor_path", "sights", survey)


def fit_line(survey: Survey) -> Iterator[Task]:
    """Flightlines whose noise and afterpulses are fitted."""
    yield from _of_lines("fit_line", "observe", survey)


def _of_lines(kind: str, of: str, survey: Survey) -> Iterator[Task]:
    """Tasks of the flightlines in some of whose stretches an earlier step has found points."""
    for line in survey.flightlines:
        names = [name for name, _ in _with_points(of, survey, line)]
        if names:
            args = {
                **_line_args(survey, line),
                "stretches": names,
                "points": line.points,
                "span_s": [line.first_s, line.last_s],
                "stretch_s": line.stretch_shots / line.clock.prf_hz,
                "prf_basis": line.prf_basis,
            }
            yield Task(kind, line.name, args, tuple((of, name) for name in names))


def scatter(survey: Survey) -> Iterator[Task]:
    """Stretches that are shared among tiles."""
    filtering = survey.workflow.filter
    # Only filters of single shots read what shots hold: the others share the points as they are.
    method = filtering.method
    of_shots = {method: getattr(filtering, method).model_dump()} if method in OF_SHOTS else None
    for line in survey.flightlines:
        if line.name not in survey.of("fit_line"):
            continue
        for name, k in _with_points("observe", survey, line):
            args = {
                **_stretch_args(survey, line, name, k),
                "timeless": False,
                "of_shots": of_shots,
                "polygons": survey.inputs.checksums("aoi", "water"),
            }
            needs = (*_line_needs(survey, line), ("observe", name), ("fit_line", line.name))
            yield Task("scatter", name, args, needs, survey.of("observe")[name].points)
    if not survey.filtering:
        yield from _ranges(survey)


def _ranges(survey: Survey) -> Iterator[Task]:
    """Parts of the files, where nothing filters, to be shared among tiles."""
    # Their flightline follows from id and time.
    again = [[*line.as_pass] for line in survey.flown if line.number != line.psid]
    for source in survey.inputs.sources:
        key, points = str(source.key), source.facts.n_points
        for part in range(parts_of(points) if key in survey.of("index_file") else 0):
            name = f"file_{key}/{part}"
            args = {
                "stretch": name,
                "kept": part_name(key, part),
                "timeless": True,
                "passes": again,
                "polygons": survey.inputs.checksums("aoi", "water"),
            }
            start, stop = part_range(points, part)
            yield Task("scatter", name, args, (("index_file", key),), stop - start)


def _line_args(survey: Survey, line: Flightline) -> dict[str, object]:
    beams: dict[str, Any] = {"basis": "vertical", "heading_rad": None}
    if survey.of("trajectory"):
        beams["basis"] = "trajectory"
    elif line.name in survey.of("sensor_path"):
        facts = survey.of("sensor_path")[line.name].facts
        beams = {name: facts[name] for name in beams}
    return {
        "line": line.name,
        "psid": line.psid,
        "number": line.number,
        "t0_s": line.clock.t0_s,
        "prf_hz": line.clock.prf_hz,
        "beamlets": survey.beamlets,
        **beams,
    }


def _stretch_args(survey: Survey, line: Flightline, name: str, k: int) -> dict[str, object]:
    """Where the points of a stretch are, and what is known of its flightline."""
    window = line.window_s(k)
    low_s, high_s = max(window[0], line.first_s), min(window[1], line.last_s)
    return {
        **_line_args(survey, line),
        "stretch": name,
        "sources": survey.parts_between(line.psid, low_s, high_s),
        "shots": [k * line.stretch_shots, (k + 1) * line.stretch_shots],
        "window_s": list(window),
        "span_s": [line.first_s, line.last_s],
        "positions": _near(survey.positions, low_s, high_s),
    }


def _line_needs(survey: Survey, line: Flightline) -> tuple[Need, ...]:
    """Tasks that have read the files of a flightline, and the one that found its sensor's path."""
    files = (("index_file", key) for key in line.sources)
    path = (("sensor_path", line.name),) if line.name in survey.of("sensor_path") else ()
    return (*files, *path)


def _near(positions: Mapping[str, str], low_s: float, high_s: float) -> list[str]:
    """Hashes of the positions that beams of a span of time are interpolated from.

    And of those beside: gaps that are interpolated over are shorter, and leap seconds fewer.
    """
    first = int((low_s - POSITIONS_S) // POSITIONS_S)
    last = int((high_s + POSITIONS_S) // POSITIONS_S)
    return [positions.get(str(span), "") for span in range(first, last + 1)]
