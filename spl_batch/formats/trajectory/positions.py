"""Sensor positions in the survey's CRS and the points' time: gathered, written, read again.

Records are brought into the survey's CRS batch by batch and wait on disk; those before the next
batch's first record are in order and go on. Of files that are each in time order, a few batches are
in memory at once, however long they are.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache, partial
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS, Transformer
from pyproj.exceptions import ProjError

from spl_batch.errors import InputError, counted, grouped
from spl_batch.formats.crs import (
    crs_name,
    crs_problems,
    horizontal,
    no_survey_crs,
    parse_crs,
)
from spl_batch.formats.files.atomic import stop_if_full
from spl_batch.formats.gps_clock import TimeStandard, clock, time_standard
from spl_batch.formats.heights import names_datum
from spl_batch.formats.trajectory.records import COLUMNS, SBET_SUFFIXES, Records, read_records
from spl_batch.formats.transformations import lacks
from spl_batch.formats.units import Units, both
from spl_batch.formats.verified.parquet_npz import ranges_of, read_groups, reading, writing
from spl_batch.lattice.tables import Trajectory

WAITING_RECORDS: Final = 500_000
"""Records that may wait in memory for their turn in time: files in disorder have more [count]."""

SBET_CRS: Final = "EPSG:4979"
"""CRS of an SBET unless the workflow names another: WGS 84, ellipsoidal heights."""

_ROW_GROUP: Final = 65_536
_RECORD_BYTES: Final = 32
ELSEWHERE_M: Final = 50_000.0
"""Farther from all points a trajectory is in another CRS [m]."""

Positions = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class PointExtent:
    """What a trajectory is compared with."""

    time_s: tuple[float, float]  #: First and last ``gps_time`` of the points [s].
    #: (4,) or (6,) float: their bounding box: all minima, then all maxima [m].
    bounds_m: Sequence[float]


class _Batch(NamedTuple):
    """Records side by side on disk: of which file, where, how many, first and last time [s]."""

    file: int
    offset: int
    records: int
    first_s: float
    last_s: float


@dataclass
class Gathering:
    """Records of trajectory files in the order of time, some at a time; iterate once.

    Its attributes are complete at the end of the iteration.
    """

    _paths: Sequence[Path]
    _disk: IO[bytes]
    _folder: Path | None
    _points: PointExtent | None
    _units: Units  # of the survey's CRS
    records: int = 0  #: Records, each time counted once.
    span_s: tuple[float, float] = (np.inf, -np.inf)  #: First and last time [s].
    #: What had to be done to them, and what was done that loses nothing; each is one sentence.
    warnings: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    _batches: list[_Batch] = field(default_factory=list)
    _dropped: int = 0
    _nearest_m: float = np.inf
    _low: NDArray[np.float64] = field(default_factory=partial(np.full, 2, np.inf))
    _high: NDArray[np.float64] = field(default_factory=partial(np.full, 2, -np.inf))

    @property
    def standard(self) -> TimeStandard:
        """Time standard of the records."""
        return time_standard(np.array(self.span_s))

    def read(self, survey_crs: CRS | None, trajectory_crs: str | None) -> None:
        """Read the files, and bring them into the points' time."""
        for file, path in enumerate(self._paths):
            convert = _conversion(path, survey_crs, trajectory_crs, self.warnings)
            for time, position in read_records(path, self.warnings.append):
                end = self._batches[-1] if self._batches else _Batch(0, 0, 0, 0.0, 0.0)
                offset = end.offset + end.records * _RECORD_BYTES
                self._batches.append(self._put(file, offset, time, convert(position)))
        self.warnings = list(dict.fromkeys(self.warnings))
        if self._points is not None:
            self._set_clock(self._points.time_s)

    def _set_clock(self, points_s: tuple[float, float]) -> None:
        """Bring times into the points' standard, by which batches may change order."""
        wanted = time_standard(np.asarray(points_s, dtype=np.float64))
        shared: dict[TimeStandard, list[int]] = {}
        for file in sorted({batch.file for batch in self._batches}):
            shared.setdefault(time_standard(np.array(self._span({file}))), []).append(file)
        for given, files in shared.items():
            try:
                convert = clock(given, self._span(set(files)), points_s, wanted)
            except ValueError as error:
                raise InputError(str(self._paths[files[0]]), str(error)) from None
            if convert is None:
                continue
            for k, batch in enumerate(self._batches):
                if batch.file in files:
                    time, xyz = self._fetch(batch)
                    self._batches[k] = self._put(batch.file, batch.offset, convert(time), xyz)
            self.notes.append(f"trajectory: {given} time converted to {wanted} time")

    def _span(self, files: set[int]) -> tuple[float, float]:
        """First and last time of some files [s]."""
        mine = [batch for batch in self._batches if batch.file in files]
        return min(b.first_s for b in mine), max(b.last_s for b in mine)

    def __iter__(self) -> Iterator[Records]:
        """Records, each time once.

        Raises
        ------
        InputError
            If there are too few of them, too many wait for their turn, or no position is within
            50 km of the points, which means different CRS.
        """
        order = sorted(self._batches, key=lambda batch: (batch.first_s, batch.offset))
        starts = [*(batch.first_s for batch in order[1:]), np.inf][: len(order)]
        time, xyz = np.empty(0), np.empty((0, 3))
        for batch, next_s in zip(order, starts, strict=True):
            fresh = self._fetch(batch)
            time, xyz = np.concatenate([time, fresh[0]]), np.concatenate([xyz, fresh[1]])
            ready = time < next_s
            if ready.any():
                yield self._in_order(time[ready], xyz[ready])
            time, xyz = time[~ready], xyz[~ready]
            if len(time) > WAITING_RECORDS:
                raise InputError(
                    str(self._paths[0]),
                    f"more than {grouped(WAITING_RECORDS)} trajectory records are out of time "
                    "order: sort them by time",
                )
        self._judge(str(self._paths[0]))

    def _in_order(self, time: NDArray[np.float64], xyz: Positions) -> Records:
        # Position breaks ties, so that the order of files and records cannot matter.
        order = np.lexsort((xyz[:, 2], xyz[:, 1], xyz[:, 0], time))
        time, xyz = time[order], xyz[order]
        first = np.diff(time, prepend=-np.inf) > 0
        self._dropped += int(np.count_nonzero(~first))
        time, xyz = time[first], xyz[first]
        self.records += len(time)
        self.span_s = (min(self.span_s[0], float(time[0])), float(time[-1]))
        if self._points is not None:
            half = len(self._points.bounds_m) // 2
            low, high = self._points.bounds_m[:2], self._points.bounds_m[half : half + 2]
            gap = np.maximum(np.maximum(low - xyz[:, :2], xyz[:, :2] - high), 0.0)
            self._nearest_m = min(self._nearest_m, float(np.hypot(*gap.T).min()))
            self._low = np.minimum(self._low, xyz[:, :2].min(axis=0))
            self._high = np.maximum(self._high, xyz[:, :2].max(axis=0))
        return time, xyz

    def _judge(self, path: str) -> None:
        if self.records < 2:
            raise InputError(
                path, f"{counted(self.records, 'trajectory records')}; at least 2 are needed"
            )
        if self._dropped:
            repeating = counted(self._dropped, "records", "repeat")
            self.warnings.append(f"trajectory: {repeating} a time: left out")
        if self._points is None:
            return
        if self._nearest_m > ELSEWHERE_M:
            unit = self._units.of_coordinates
            x, y = (self._low + self._high) / 2 / unit[1]
            raise InputError(
                path,
                f"trajectory around x {x:.0f}, y {y:.0f} {unit[0]} is"
                f" {both(self._nearest_m, unit, 0)} from the points: they are in different CRS, "
                "name the trajectory's in survey.trajectory_crs",
            )
        (start, stop), (first, last) = self.span_s, self._points.time_s
        text = f"trajectory covers {start:.3f} to {stop:.3f} s, the points span {first:.3f} to"
        if max(start - last, first - stop) > 0.0:
            away_s = max(start - last, first - stop)
            raise InputError(
                path,
                f"{text} {last:.3f} s, {away_s:.0f} s away: no point could be filtered; name the"
                " trajectory of this flight, or none",
            )
        if first < start or stop < last:
            self.warnings.append(f"{text} {last:.3f} s: points outside stay unfiltered")

    def _put(self, file: int, offset: int, time: NDArray[np.float64], xyz: Positions) -> _Batch:
        try:
            self._disk.seek(offset)
            self._disk.write(np.column_stack([time, xyz]).tobytes())
        except OSError as error:
            stop_if_full(error, self._folder or "the folder for temporary files")
            raise
        return _Batch(file, offset, len(time), float(time.min()), float(time.max()))

    def _fetch(self, batch: _Batch) -> Records:
        self._disk.seek(batch.offset)
        content = self._disk.read(batch.records * _RECORD_BYTES)
        records = np.frombuffer(content, dtype=np.float64).reshape(-1, 4)
        return records[:, 0].copy(), records[:, 1:].copy()


@contextmanager
def gathering(
    paths: Sequence[Path],
    *,
    survey_crs: CRS | None,
    trajectory_crs: str | None,
    points: PointExtent | None = None,
    folder: Path | None = None,
) -> Iterator[Gathering]:
    """Trajectory files as one; of files in time order, memory holds a few batches.

    Parameters
    ----------
    paths : sequence of Path
        The files; see :func:`~spl_batch.formats.trajectory.records.read_records`.
    survey_crs : CRS or None
        CRS on whose axes positions are wanted [m]; none leaves them as they are.
    trajectory_crs : str or None
        CRS of the files; by default EPSG:4979 for SBET and the survey's for others.
    points : PointExtent, optional
        Points in whose time the records are wanted; by default they keep their own.
    folder : Path, optional
        Where records wait for their turn; by default where temporary files lie.

    Raises
    ------
    InputError
        If a file is missing, damaged, or has values that are not finite.
    """
    if not paths:
        raise InputError("survey.trajectory", "matches no file; check the path")
    with TemporaryFile(dir=folder) as disk:
        found = Gathering(paths, disk, folder, points, Units.of(survey_crs))
        found.read(survey_crs, trajectory_crs)
        yield found


def _conversion(
    path: Path, survey: CRS | None, trajectory_crs: str | None, warnings: list[str]
) -> Callable[[Positions], Positions]:
    """Brings a file's positions, (n, 3), onto the axes of the survey's CRS in metres.

    Heights as well, where PROJ can.
    """
    crs, units = _crs_of(path, trajectory_crs), Units.of(survey)
    if crs is None:
        return units.metres
    if survey is None:
        raise InputError(str(path), no_survey_crs(crs))
    problems = crs_problems(survey)
    if problems:
        raise InputError(str(path), problems)
    flat = _projection(horizontal(crs), horizontal(survey), best=False)
    # Heights beside degrees alone are in metres; beside feet they are in feet.
    with_unit = len(crs.axis_info) == 3 or not crs.is_geographic
    unit_m = crs.axis_info[-1].unit_conversion_factor if with_unit else 1.0

    def keep_heights(position: Positions) -> Positions:
        east_north = units.metres(flat(position)[:, :2])
        return np.column_stack([east_north, position[:, 2] * unit_m])

    ways: list[Callable[[Positions], Positions]] = [keep_heights]
    if names_datum(crs) and names_datum(survey):
        whole = _projection(crs, survey, best=True)
        ways.append(lambda position: units.metres(whole(position)))

    def convert(position: Positions) -> Positions:
        """Whether heights can be converted shows the first batch; then there is one way."""
        try:
            found = ways[-1](position)
        except ProjError as error:
            if len(ways) == 1:
                whence = f"from {crs_name(crs)} to {crs_name(survey)}"
                raise InputError(str(path), f"cannot be transformed {whence}") from error
            warnings.append(
                f"trajectory: heights stay those of {crs_name(crs)}, not of {crs_name(survey)}: "
                f"PROJ {lacks(crs, survey) or error}"
            )
            del ways[-1]
            return convert(position)
        del ways[:-1]
        return found

    return convert


def _crs_of(path: Path, trajectory_crs: str | None) -> CRS | None:
    key = "survey.trajectory_crs"
    named = None if trajectory_crs is None else parse_crs(trajectory_crs, key)
    if path.suffix.lower() not in SBET_SUFFIXES:
        return named
    crs = named or CRS.from_user_input(SBET_CRS)
    if not crs.is_geographic:
        raise InputError(
            str(path),
            f"an SBET has latitude and longitude, survey.trajectory_crs is {crs_name(crs)}:"
            " name a geographic CRS or leave it out",
        )
    return crs


def _projection(source: CRS, target: CRS, *, best: bool) -> Callable[[Positions], Positions]:
    """Positions in another CRS; raises ProjError where one of them cannot be transformed."""

    @cache
    def transformer() -> Transformer:
        return Transformer.from_crs(
            source, target, always_xy=True, only_best=best, allow_ballpark=not best
        )

    def project(position: Positions) -> Positions:
        x, y, z = position.T
        xyz = np.column_stack(transformer().transform(x, y, z, errcheck=True))
        if not np.isfinite(xyz).all():
            raise ProjError("a position has no coordinates there")
        return xyz

    return project


def write_trajectory(path: Path, pieces: Iterable[Records]) -> None:
    """Write records, in the order of time, as Parquet, atomically.

    Parameters
    ----------
    pieces : iterable of (time_s, xyz_m)
        However they are cut: (n,) float64 [s] and (n, 3) float64 [m].
    """
    with writing(path, dict.fromkeys(COLUMNS, np.float64)) as writer:
        for time, xyz in _regrouped(pieces):
            writer.write(dict(zip(COLUMNS, (time, *xyz.T), strict=True)))


def _regrouped(pieces: Iterable[Records]) -> Iterator[Records]:
    """The same records in pieces of one size, but for the last."""
    kept: Records = np.empty(0), np.empty((0, 3))
    for piece in pieces:
        time, xyz = (np.concatenate(both) for both in zip(kept, piece, strict=True))
        whole = len(time) - len(time) % _ROW_GROUP
        for start in range(0, whole, _ROW_GROUP):
            yield time[start : start + _ROW_GROUP], xyz[start : start + _ROW_GROUP]
        kept = time[whole:], xyz[whole:]
    if len(kept[0]):
        yield kept


def read_slice(path: Path, start_s: float, stop_s: float) -> Trajectory:
    """Records of a written trajectory that are needed within a time span.

    ``path``: from :func:`write_trajectory`; only the row groups that matter are read.
    """
    with reading(path) as file:
        spans = ranges_of(file.metadata, COLUMNS[0])
        # One record beyond each end is needed to interpolate up to the ends.
        before = [g for g, (low, _) in enumerate(spans) if low <= start_s]
        after = [g for g, (_, high) in enumerate(spans) if high >= stop_s]
        first = before[-1] if before else 0
        last = after[0] if after else len(spans) - 1
        columns = read_groups(file, COLUMNS, range(first, max(first, last) + 1))
    time, *position = (columns[name] for name in COLUMNS)
    return Trajectory(time, np.column_stack(position)).clip(start_s, stop_s)
