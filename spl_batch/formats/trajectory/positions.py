"""Sensor positions in the survey's CRS and the points' time: gathered, written, read again."""

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS

from spl_batch.errors import InputError, counted
from spl_batch.formats.gps_clock import TimeStandard, clock, time_standard
from spl_batch.formats.trajectory.merge import Merge
from spl_batch.formats.trajectory.records import COLUMNS
from spl_batch.formats.trajectory.usable import Records
from spl_batch.formats.verified.parquet_npz import read_groups, reading, writing
from spl_batch.lattice.tables import Trajectory

_ROW_GROUP: Final = 65_536
_FAR_M: Final = 50_000.0


@dataclass(frozen=True, slots=True)
class PointExtent:
    """What a trajectory is compared with."""

    time_s: tuple[float, float]  #: First and last ``gps_time`` of the points [s].
    #: (4,) or (6,) float: their bounding box: all minima, then all maxima [m].
    bounds_m: Sequence[float]


class Gathering:
    """Records of trajectory files in the order of time, some at a time; iterate once.

    What it says of them is complete at the end of the iteration.

    Parameters
    ----------
    points : PointExtent or None
        Points in whose time the records are wanted, and which they must be near to.

    Attributes
    ----------
    records : int
        Records, each time counted once.
    span_s : (float, float)
        First and last time [s].
    warnings : tuple of str
        What had to be done to them; each is one sentence.
    """

    def __init__(self, merge: Merge, points: PointExtent | None) -> None:
        self.records = 0
        self.span_s = (np.inf, -np.inf)
        self.warnings: tuple[str, ...] = ()
        self._merge, self._points = merge, points
        self._converted: list[str] = []
        if points is not None:
            self._set_clock(points)

    @property
    def standard(self) -> TimeStandard:
        """Time standard of the records."""
        return time_standard(np.array(self.span_s))

    def __iter__(self) -> Iterator[Records]:
        """Records.

        Raises
        ------
        InputError
            If there are too few of them, or no position is within 50 km of the points,
            which means different CRS.
        """
        nearness = _Nearness(self._points.bounds_m) if self._points is not None else None
        for time, xyz in self._merge.pieces():
            self.records += len(time)
            self.span_s = (min(self.span_s[0], float(time[0])), float(time[-1]))
            if nearness is not None:
                nearness.add(xyz)
            yield time, xyz
        self._judge(nearness)

    def _set_clock(self, points: PointExtent) -> None:
        wanted = time_standard(np.asarray(points.time_s, dtype=np.float64))
        for given, (files, *span_s) in self._merge.standards().items():
            try:
                convert = clock(given, (span_s[0], span_s[1]), points.time_s, wanted)
            except ValueError as error:
                raise InputError(str(self._merge.paths[files[0]]), str(error)) from None
            if convert is not None:
                self._merge.use_clock(files, convert)
                self._converted.append(f"trajectory: {given} time converted to {wanted} time")

    def _judge(self, nearness: "_Nearness | None") -> None:
        path, warnings = str(self._merge.paths[0]), list(dict.fromkeys(self._merge.warnings))
        if self.records < 2:
            raise InputError(
                path, f"{counted(self.records, 'trajectory records')}; at least 2 are needed"
            )
        if self._merge.dropped:
            repeating = counted(self._merge.dropped, "records", "repeat")
            warnings.append(f"trajectory: {repeating} a time: left out")
        warnings += self._converted
        if nearness is not None and self._points is not None:
            nearness.refuse_far(path)
            _refuse_apart(path, self.span_s, self._points.time_s)
            warnings += _uncovered(self.span_s, self._points.time_s)
        self.warnings = tuple(warnings)


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
        CRS that positions are wanted in; none leaves them as they are.
    trajectory_crs : str or None
        CRS of the files; by default EPSG:4979 for SBET and the survey's for others.
    points : PointExtent, optional
        Points in whose time the records are wanted; by default they keep their own.
    folder : Path, optional
        Where records wait for their place; by default where temporary files lie.

    Raises
    ------
    InputError
        If a file is missing, damaged, or has values that are not finite.
    """
    if not paths:
        raise InputError("survey.trajectory", "matches no file; check the path")
    with Merge(paths, folder) as merge:
        merge.read(survey_crs, trajectory_crs)
        yield Gathering(merge, points)


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
        groups = [
            file.metadata.row_group(g).column(0).statistics for g in range(file.num_row_groups)
        ]
        # One record beyond each end is needed to interpolate up to the ends.
        before = [g for g, s in enumerate(groups) if s.min <= start_s]
        after = [g for g, s in enumerate(groups) if s.max >= stop_s]
        first = before[-1] if before else 0
        last = after[0] if after else len(groups) - 1
        columns = read_groups(file, COLUMNS, range(first, max(first, last) + 1))
    time, *position = (columns[name] for name in COLUMNS)
    return Trajectory(time, np.column_stack(position)).clip(start_s, stop_s)


def _uncovered(span_s: tuple[float, float], points_s: tuple[float, float]) -> list[str]:
    if span_s[0] <= points_s[0] and points_s[1] <= span_s[1]:
        return []
    text = (
        f"trajectory covers {span_s[0]:.3f} to {span_s[1]:.3f} s, the points span"
        f" {points_s[0]:.3f} to {points_s[1]:.3f} s: points outside stay unfiltered"
    )
    return [text]


def _refuse_apart(path: str, span_s: tuple[float, float], points_s: tuple[float, float]) -> None:
    """Raise :class:`InputError` where no point lies in the time of the trajectory."""
    gap_s = max(span_s[0] - points_s[1], points_s[0] - span_s[1])
    if gap_s > 0.0:
        raise InputError(
            path,
            f"trajectory covers {span_s[0]:.3f} to {span_s[1]:.3f} s, the points span"
            f" {points_s[0]:.3f} to {points_s[1]:.3f} s, {gap_s:.0f} s away: no point could be"
            " filtered; name the trajectory of this flight, or none",
        )


class _Nearness:
    """How near positions come to the points, and where they are."""

    def __init__(self, bounds_m: Sequence[float]) -> None:
        half = len(bounds_m) // 2
        self._low, self._high = np.asarray(bounds_m[:2]), np.asarray(bounds_m[half : half + 2])
        self._nearest_m = np.inf
        self._west_south, self._east_north = np.full(2, np.inf), np.full(2, -np.inf)

    def add(self, xyz_m: NDArray[np.float64]) -> None:
        """Look at some positions."""
        xy = xyz_m[:, :2]
        gap = np.maximum(np.maximum(self._low - xy, xy - self._high), 0.0)
        self._nearest_m = min(self._nearest_m, float(np.hypot(gap[:, 0], gap[:, 1]).min()))
        self._west_south = np.minimum(self._west_south, xy.min(axis=0))
        self._east_north = np.maximum(self._east_north, xy.max(axis=0))

    def refuse_far(self, path: str) -> None:
        """Raise :class:`InputError` where no position is near the points."""
        if self._nearest_m <= _FAR_M:
            return
        middle = (self._west_south + self._east_north) / 2
        raise InputError(
            path,
            f"trajectory around x {middle[0]:.0f}, y {middle[1]:.0f} is"
            f" {self._nearest_m / 1000:.0f} km from the points (x {self._low[0]:.0f} to"
            f" {self._high[0]:.0f}, y {self._low[1]:.0f} to {self._high[1]:.0f}):"
            " they are in different CRS, name the trajectory's in survey.trajectory_crs",
        )
