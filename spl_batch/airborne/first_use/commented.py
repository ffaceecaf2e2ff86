"""A workflow for the files of a folder: what was found is written, what was not is a comment."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from spl_batch.airborne.first_use.clouds import (
    SENSOR,
    CloudLook,
    channel_guess,
    guesses,
    look_at,
)
from spl_batch.airborne.plan.inputs.survey_inputs import NO_POINTS
from spl_batch.airborne.sensors.sensor import load_preset
from spl_batch.constants import CLASS_GROUND
from spl_batch.engine.settings.mistaken_file import url_fault
from spl_batch.engine.verbs.beginning import (
    Beginning,
    files_below,
    headed,
    key_lines,
    patterns,
    wrapped,
)
from spl_batch.errors import InputError, WorkflowError, counted, grouped, named, plain
from spl_batch.formats import checkpoints
from spl_batch.formats.files.atomic import real_path
from spl_batch.formats.las.reader import is_delivered
from spl_batch.formats.trajectory.records import (
    PARQUET_SUFFIXES,
    SBET_RECORD,
    SBET_SUFFIXES,
    has_records,
)

CLOUDS: Final = frozenset({".las", ".laz"})

EMPTY: Final = -1
"""Rank of a cloud without points."""

_KEPT: Final = ("filter: {method: none}", "afterpulse: {enabled: false}")
"""Lines of a workflow by which every point stays."""


@dataclass
class _Folder:
    """What was found in a folder; each file below it once."""

    path: Path
    lines: list[CloudLook] = field(default_factory=list)  #: Clouds that seem to be flightlines.
    #: Other clouds: of which points are ground; the rest.
    references: list[CloudLook] = field(default_factory=list)
    others: list[CloudLook] = field(default_factory=list)
    results: list[Path] = field(default_factory=list)  #: Clouds that a run delivered.
    bad: list[InputError] = field(default_factory=list)  #: Clouds that cannot be read.
    trajectories: list[Path] = field(default_factory=list)
    checkpoints: list[Path] = field(default_factory=list)

    def named(self, paths: Sequence[Path]) -> str:
        """What the workflow calls some files."""
        return named([path.relative_to(self.path).as_posix() for path in paths], 3)


def begin(place: Path) -> Beginning | None:
    """A workflow for the clouds below a folder; None where there are none.

    Raises
    ------
    WorkflowError
        If there is no such folder, or no cloud in it can be used.
    """
    if not place.is_dir():
        raise WorkflowError(f"{place}: {_no_folder(place)}")
    folder, files = _Folder(place), files_below(place)
    _sort_clouds([file for file in files if file.suffix.lower() in CLOUDS], folder)
    for file in files:
        if file.suffix.lower() in {".csv", ".txt", *PARQUET_SUFFIXES, *SBET_SUFFIXES}:
            _sort_table(file, folder)
    if not folder.lines and folder.bad:
        raise WorkflowError(f"{place}: no cloud can be used: {folder.bad[0]}")
    if not folder.lines and folder.results:
        raise WorkflowError(
            f"{place}: holds clouds that a run delivered alone, such as "
            f"{folder.named(folder.results[:1])}; name the folder of the raw flightlines"
        )
    return _draft(folder) if folder.lines else None


def _no_folder(path: Path) -> str:
    """Why a path is no folder, and which command takes it."""
    if fault := url_fault(path):
        return fault
    if not path.exists():
        return "no such folder; name the folder that holds the files"
    if path.suffix.lower() in CLOUDS:
        return (
            "this is one file: `spl-batch denoise` takes it without a workflow, "
            f"`spl-batch init {path.parent}` all files of its folder"
        )
    return f"is a file; name the folder that holds it: `spl-batch init {path.parent}`"


def _sort_clouds(files: Sequence[Path], found: _Folder) -> None:
    """Flightlines are what is most like a raw survey: with beamlet numbers, else with times."""
    looks = []
    for file in files:
        try:
            look = look_at(file)
        except InputError as error:
            found.bad.append(error)
            continue
        if is_delivered(file):
            found.results.append(file)
        else:
            looks.append(look)
    ranks = [_rank(look) for look in looks]
    for look, rank in zip(looks, ranks, strict=True):
        if rank == EMPTY:
            found.bad.append(InputError(str(look.facts.path), NO_POINTS))
        elif rank == max(ranks):
            found.lines.append(look)
        elif CLASS_GROUND in look.ends.classes:
            found.references.append(look)
        else:
            found.others.append(look)


def _rank(look: CloudLook) -> int:
    """How much a cloud is like a raw flightline."""
    if not look.facts.n_points:
        return EMPTY
    numbered = channel_guess([look], load_preset(SENSOR)).value is not None
    return 2 * numbered + look.timed


def _sort_table(file: Path, found: _Folder) -> None:
    """A table is a trajectory by its columns, or holds checkpoints."""
    if file.suffix.lower() in SBET_SUFFIXES and file.stat().st_size % SBET_RECORD.itemsize:
        return  # many programs call a log so
    try:
        if has_records(file):
            found.trajectories.append(file)
    except InputError:
        if file.suffix.lower() == ".csv" and _has_checkpoints(file):
            found.checkpoints.append(file)


def _has_checkpoints(file: Path) -> bool:
    with file.open(encoding="utf-8", errors="replace", newline="") as stream:
        head = checkpoints.table(stream).fieldnames or ()
    return {name.strip().lower() for name in head} >= {*checkpoints.COLUMNS}


def _draft(folder: _Folder) -> Beginning:
    """Write a workflow for what a folder holds."""
    made = headed("using")
    made.section("survey")
    made.lines += key_lines("name", real_path(folder.path).name or "survey", "  ")
    points = sum(look.facts.n_points for look in folder.lines)
    many = f"{counted(len(folder.lines), 'files')}, {grouped(points)} points"
    made.known("flightlines", patterns(folder.path, _paths(folder.lines)), many)
    timed, channel, crs, linear = guesses(folder.lines)
    shots = timed and not linear  # else nothing looks at trajectory, sensor and beamlets
    if folder.trajectories or shots or not timed:
        _trajectory(made, folder, timed=timed)
    if crs.value is None:
        made.open("crs", "EPSG:32615", crs.reason)
    else:
        made.found.append(("CRS", crs.reason))
        made.lines.append(f"  # CRS: {plain(crs.reason)}")
    if shots:
        text = "no file names the instrument: spl100, hrqls, or its facts"
        made.supposed("sensor", SENSOR, text)
    if shots and channel.value is None:
        made.open("channel_dimension", "user_data", channel.reason)
    elif channel.value is not None:
        made.known("channel_dimension", channel.value, f"{channel.value} {channel.reason}")
    _reference(made, folder)
    made.lines += ["", "output: out"]
    _filter(made, linear, numbered=channel.value is not None, timed=timed)
    made.left_out += _left_out(folder)
    return made


def _trajectory(made: Beginning, folder: _Folder, *, timed: bool) -> None:
    """One of the kinds of files that are there: others of the same flight would repeat it."""
    if not timed:
        made.unknown.append(("gps_time", "no usable times: there are no shots, noise is not known"))
    elif folder.trajectories:
        kind = min(folder.trajectories, key=lambda p: (p.suffix.lower() in SBET_SUFFIXES, p)).suffix
        chosen = [path for path in folder.trajectories if path.suffix == kind]
        rest = [path for path in folder.trajectories if path.suffix != kind]
        more = f"; {folder.named(rest)} may hold the same" if rest else ""
        reason = f"{folder.named(chosen)}, by its columns{more}"
        made.known("trajectory", patterns(folder.path, chosen), reason)
    else:
        text = "no trajectory is here: beams come from where lines of sight meet"
        made.open("trajectory", "trajectory/*.sbet", text)


def _reference(made: Beginning, folder: _Folder) -> None:
    if not folder.references and not folder.checkpoints:
        return
    made.section("reference")
    if folder.references:
        paths = _paths(folder.references)
        reason = "class 2, ground, in other clouds"
        made.known("points", patterns(folder.path, paths), reason, "reference")
    if folder.checkpoints:
        first = folder.checkpoints[:1]
        reason = f"by its columns; of {folder.named(folder.checkpoints)}"
        made.known("checkpoints", folder.named(first), reason)


def _filter(made: Beginning, linear: str, *, numbered: bool, timed: bool) -> None:
    """Whether there is noise to be found, and what that needs."""
    if not timed:
        text = (
            "# Without times noise is not known: every point stays; ground and surfaces are made."
        )
        made.lines += ["", text, *_KEPT]
        return
    if linear:
        why = (
            f"{linear}: taken for linear-mode lidar, every point stays; if single photons were "
            "counted, delete the last two lines, and name survey.sensor"
        )
        made.unknown.append(("filter", why))
        made.lines += ["", *wrapped(f"? {why}"), *_KEPT]
        return
    made.lines += [
        "",
        "# Pulse rate [Hz] and slant length of the range gate [m] are estimated from the points.",
        "# acquisition: {prf_hz: 60000, gate_m: 300}",
    ]
    if not numbered:
        why = (
            "if this is linear-mode lidar, which has no such noise, remove the # before the last "
            "two lines of the workflow"
        )
        made.unknown.append(("filter", why))
        made.lines += ["", *wrapped(f"? {why}"), *(f"# {line}" for line in _KEPT)]


def _left_out(folder: _Folder) -> Iterator[str]:
    """Files that the workflow does not name, and why."""
    yield from map(str, folder.bad)
    for paths, why in (
        (_paths(folder.others), "no times or beamlet numbers like the others', no ground"),
        (folder.results, "delivered by a run"),
    ):
        if paths:
            yield f"{folder.named(paths)}: {why}"


def _paths(looks: Sequence[CloudLook]) -> list[Path]:
    return [look.facts.path for look in looks]
