"""What the files of a folder are: flightlines, other clouds, trajectories, what else belongs."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np

from spl_batch.airborne.first_use.clouds import CloudLook, channel_guess, look_at
from spl_batch.airborne.plan.inputs.first_look import gap_s, in_time_of
from spl_batch.airborne.plan.inputs.survey_inputs import NO_POINTS
from spl_batch.airborne.sensors.sensor import Sensor
from spl_batch.constants import CLASS_GROUND
from spl_batch.engine.settings.mistaken_file import url_fault
from spl_batch.engine.verbs.beginning import files_below
from spl_batch.errors import InputError, WorkflowError
from spl_batch.formats import checkpoints
from spl_batch.formats.trajectory.records import PARQUET_SUFFIXES, SBET_RECORD, SBET_SUFFIXES, ends

CLOUDS: Final = frozenset({".las", ".laz"})
POLYGONS: Final = frozenset({".gpkg", ".shp", ".geojson", ".fgb"})
OTHERS: Final = frozenset({".h5", ".hdf5"})
"""Files of other receivers by their suffix."""

TIMES_ALIKE_S: Final = 2.0
"""Trajectories whose ends differ by less are one flight in two formats [s]."""

DELIVERED: Final = frozenset({"input_classification", "noise_class"})
"""Dimensions that a run adds to each cloud."""

LOOKED_INTO: Final = 200
"""Clouds whose points are looked at, evenly among more of them [count]."""

EMPTY: Final = -1
"""Rank of a cloud without points."""

Span = tuple[float, float]


@dataclass
class Folder:
    """What was found in a folder; each file below it once."""

    path: Path
    lines: list[CloudLook] = field(default_factory=list)  #: Clouds that seem to be raw flightlines.
    #: Other clouds that hold a ground class.
    references: list[CloudLook] = field(default_factory=list)
    others: list[CloudLook] = field(default_factory=list)
    results: list[Path] = field(default_factory=list)  #: Clouds that a run delivered.
    bad: list[InputError] = field(default_factory=list)  #: Clouds that cannot be read.
    #: dict of Path to (float, float): first and last time of each [s], in the clock of the points
    #: where that can be told.
    trajectories: dict[Path, Span] = field(default_factory=dict)
    #: Trajectories of a flight that another file has too.
    doubles: list[Path] = field(default_factory=list)
    #: Trajectories of other times than the flightlines'.
    elsewhen: list[Path] = field(default_factory=list)
    #: checkpoints, polygons: by their columns; by their names.
    checkpoints: list[Path] = field(default_factory=list)
    polygons: list[Path] = field(default_factory=list)
    foreign: list[Path] = field(default_factory=list)

    @property
    def damaged_lines(self) -> list[Path]:
        """Clouds that cannot be read, beside flightlines: a run names them as failures."""
        places = {look.facts.path.parent for look in self.lines}
        paths = [Path(error.path) for error in self.bad]
        return [path for path in paths if path.parent in places and path.exists()]

    def named(self, path: Path) -> str:
        """What the workflow calls a file."""
        return path.relative_to(self.path).as_posix()


def look_through(path: Path, sensor: Sensor) -> Folder:
    """Look at every file below a folder; nothing is read to its end.

    Parameters
    ----------
    path : Path
        The folder. Results of runs in it, and hidden files, are left out.

    Raises
    ------
    WorkflowError
        If it is no folder, or it holds clouds and none can be used.
    """
    if not path.is_dir():
        raise WorkflowError(f"{path}: {_no_folder(path)}")
    found = Folder(path)
    files = files_below(path)
    _sort_clouds([file for file in files if file.suffix.lower() in CLOUDS], sensor, found)
    for file in files:
        suffix = file.suffix.lower()
        if suffix in POLYGONS:
            found.polygons.append(file)
        elif suffix in OTHERS:
            found.foreign.append(file)
        elif suffix in {".csv", ".txt", *PARQUET_SUFFIXES, *SBET_SUFFIXES}:
            _sort_table(file, found)
    if not found.lines and (found.bad or found.results):
        raise WorkflowError(_nothing(found))
    _sort_trajectories(found)
    return found


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


def _sort_clouds(files: Sequence[Path], sensor: Sensor, found: Folder) -> None:
    """Flightlines are what is most like a raw survey: with beamlet numbers, else with times."""
    some = {
        files[k] for k in np.linspace(0, len(files) - 1, min(len(files), LOOKED_INTO)).astype(int)
    }
    looks = []
    for file in files:
        try:
            look = look_at(file) if file in some else look_at(file, points=False)
        except InputError as error:
            found.bad.append(error)
            continue
        if set(look.facts.dimensions) >= DELIVERED:
            found.results.append(file)
        else:
            looks.append(look)
    rank = {look.facts.path: _rank(look, looks, sensor) for look in looks}
    best = max(rank.values(), default=0)
    for look in looks:
        if best == EMPTY:
            found.bad.append(InputError(str(look.facts.path), NO_POINTS))
        elif rank[look.facts.path] == best:
            found.lines.append(look)
        elif _holds_ground(look, looks):
            found.references.append(look)
        else:
            found.others.append(look)


def _rank(look: CloudLook, looks: Sequence[CloudLook], sensor: Sensor) -> int:
    """How much a cloud is like a raw flightline; one that was not looked into is like its peers."""
    if not look.facts.n_points:
        return EMPTY
    if not len(look.ends.gps_time):
        peers = _peers(look, looks)
        return _rank(peers[0], looks, sensor) if peers else 0
    numbered = channel_guess([look], sensor).value is not None
    return 2 * numbered + (look.span_s is not None)


def _peers(look: CloudLook, looks: Sequence[CloudLook]) -> list[CloudLook]:
    """Clouds of the same dimensions that were looked into."""
    return [
        one
        for one in looks
        if len(one.ends.gps_time) and one.facts.dimensions == look.facts.dimensions
    ]


def _holds_ground(look: CloudLook, looks: Sequence[CloudLook]) -> bool:
    """Whether a cloud has ground; one that was not looked into has it where a peer does."""
    if not look.facts.n_points:
        return False
    seen = [look] if len(look.ends.gps_time) else _peers(look, looks)
    return any(CLASS_GROUND in one.ends.classes for one in seen)


def _sort_table(file: Path, found: Folder) -> None:
    """A table is a trajectory by its columns and times, or holds checkpoints."""
    if file.suffix.lower() in SBET_SUFFIXES and file.stat().st_size % SBET_RECORD.itemsize:
        return  # many programs call a log so
    try:
        span = ends(file)
    except InputError:
        if _has_checkpoints(file):
            found.checkpoints.append(file)
        return
    if span is not None:
        found.trajectories[file] = span


def _has_checkpoints(file: Path) -> bool:
    if file.suffix.lower() != ".csv":
        return False
    with file.open(encoding="utf-8", errors="replace", newline="") as stream:
        head = checkpoints.table(stream).fieldnames or ()
    return {name.strip().lower() for name in head} >= {*checkpoints.COLUMNS}


def _sort_trajectories(found: Folder) -> None:
    """Put aside what is of another flight, and the second file of the same."""
    spans = [look.span_s for look in found.lines if look.span_s is not None]
    if not spans:
        return
    kept: dict[Path, Span] = {}
    order = sorted(found.trajectories, key=lambda p: (p.suffix.lower() in SBET_SUFFIXES, p))
    for path in order:
        try:
            (span,) = in_time_of(spans, [found.trajectories[path]])
        except ValueError:
            found.elsewhen.append(path)
            continue
        if not any(gap_s(line, [span]) == 0 for line in spans):
            found.elsewhen.append(path)
        elif any(np.allclose(span, one, rtol=0.0, atol=TIMES_ALIKE_S) for one in kept.values()):
            found.doubles.append(path)
        else:
            kept[path] = span
    found.trajectories = kept


def _nothing(found: Folder) -> str:
    """Why a folder holds no survey, and what helps."""
    if found.bad:
        return f"{found.path}: no cloud can be used: {found.bad[0]}"
    return (
        f"{found.path}: holds clouds that a run delivered alone, such as "
        f"{found.named(found.results[0])}; name the folder of the raw flightlines"
    )
