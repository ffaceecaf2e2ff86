"""Sensor positions from CSV, Parquet or SBET, in the survey's CRS and the points' time."""

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet as pq
from numpy.typing import NDArray
from pyproj import CRS, Transformer
from pyproj.exceptions import ProjError

from spl_batch.errors import InputError
from spl_batch.io.crs import crs_name, crs_problems, horizontal, parse_crs
from spl_batch.io.gpstime import TimeStandard, align, time_standard
from spl_batch.io.las_header import open_input
from spl_batch.io.sbet import SBET_SUFFIXES, read_sbet
from spl_batch.io.tables import read_groups, reading, writing
from spl_batch.model import Trajectory

COLUMNS: Final = ("gps_time", "x", "y", "z")
"""Columns of a trajectory in CSV or Parquet."""

SBET_CRS: Final = "EPSG:4979"
"""CRS of an SBET unless the workflow names another: WGS 84, ellipsoidal heights."""

_PARQUET_SUFFIXES: Final = frozenset({".parquet", ".pq"})
_ROW_GROUP: Final = 65_536
_FAR_M: Final = 50_000.0
_Record = tuple[NDArray[np.float64], NDArray[np.float64]]


@dataclass(frozen=True, slots=True)
class LoadedTrajectory:
    """A trajectory and what was found out about it.

    Parameters
    ----------
    trajectory : Trajectory
        Sorted by time, in the survey's CRS.
    standard : str
        Time standard of its values.
    warnings : tuple of str
        What had to be done to it; each is one sentence.
    """

    trajectory: Trajectory
    standard: TimeStandard
    warnings: tuple[str, ...]


def read_trajectory(
    paths: Sequence[Path], *, survey_crs: CRS | None, trajectory_crs: str | None
) -> LoadedTrajectory:
    """Read trajectory files and join them.

    Parameters
    ----------
    paths : sequence of Path
        CSV (``gps_time,x,y,z``; any order and case, further columns allowed, comma,
        semicolon or tab), Parquet with the same columns, or SBET (``.out``, ``.sbet``).
    survey_crs : CRS or None
        CRS that positions are wanted in; none leaves them as they are.
    trajectory_crs : str or None
        CRS of the files; by default EPSG:4979 for SBET and the survey's for others.

    Returns
    -------
    LoadedTrajectory

    Raises
    ------
    InputError
        If a file is missing, damaged, or has values that are not finite.
    """
    if not paths:
        raise InputError("survey.trajectory", "matches no file; check the path")
    warnings: list[str] = []
    parts = []
    for path in paths:
        time, position, crs = _read(path, trajectory_crs)
        _refuse_non_finite(path, time, position)
        if crs is not None:
            position, warning = _transformed(path, position, crs, survey_crs)
            warnings += [warning] if warning else []
        parts.append((time, position))
    time = np.concatenate([t for t, _ in parts])
    xyz = np.concatenate([p for _, p in parts])
    time, xyz, dropped = _in_order(time, xyz)
    if dropped:
        warnings.append(f"trajectory: {dropped} records repeat a time and were left out")
    if len(time) < 2:
        raise InputError(str(paths[0]), f"{len(time)} trajectory records; at least 2 are needed")
    return LoadedTrajectory(
        Trajectory(time, xyz), time_standard(time), tuple(dict.fromkeys(warnings))
    )


def load_trajectory(
    paths: Sequence[Path],
    *,
    survey_crs: CRS | None,
    trajectory_crs: str | None,
    time_span_s: tuple[float, float],
    bounds_m: Sequence[float],
) -> LoadedTrajectory:
    """Trajectory in the points' CRS and time standard, checked against the points.

    Parameters
    ----------
    paths, survey_crs, trajectory_crs
        As in :func:`read_trajectory`.
    time_span_s : (float, float)
        First and last ``gps_time`` of the points [s].
    bounds_m : (4,) or (6,) float
        Bounding box of the points: all minima, then all maxima [m].

    Returns
    -------
    LoadedTrajectory
        With warnings where it does not cover all points.

    Raises
    ------
    InputError
        Also if no position is within 50 km of the points, which means different CRS.
    """
    loaded = read_trajectory(paths, survey_crs=survey_crs, trajectory_crs=trajectory_crs)
    wanted = time_standard(np.asarray(time_span_s, dtype=np.float64))
    try:
        trajectory = align(loaded.trajectory, time_span_s, wanted)
    except ValueError as error:
        raise InputError(str(paths[0]), str(error)) from None
    _refuse_far(paths[0], trajectory, bounds_m)
    warnings = list(loaded.warnings)
    if wanted != loaded.standard and trajectory is not loaded.trajectory:
        warnings.append(f"trajectory: {loaded.standard} time converted to {wanted} time")
    first, last = float(trajectory.time_s[0]), float(trajectory.time_s[-1])
    if first > time_span_s[0] or last < time_span_s[1]:
        warnings.append(
            f"trajectory covers {first:.3f} to {last:.3f} s, the points span"
            f" {time_span_s[0]:.3f} to {time_span_s[1]:.3f} s: points outside stay unfiltered"
        )
    return replace(
        loaded,
        trajectory=trajectory,
        standard=time_standard(trajectory.time_s),
        warnings=tuple(warnings),
    )


def write_trajectory(path: Path, trajectory: Trajectory) -> None:
    """Write a trajectory as Parquet, atomically."""
    columns = dict(zip(COLUMNS, (trajectory.time_s, *trajectory.xyz_m.T), strict=True))
    with writing(path, dict.fromkeys(COLUMNS, np.float64)) as writer:
        for start in range(0, len(trajectory.time_s), _ROW_GROUP):
            writer.write({k: v[start : start + _ROW_GROUP] for k, v in columns.items()})


def read_slice(path: Path, start_s: float, stop_s: float) -> Trajectory:
    """Records of a written trajectory that are needed within a time span.

    Parameters
    ----------
    path : Path
        From :func:`write_trajectory`; only the row groups that matter are read.
    start_s, stop_s : float
        Time span [s].

    Raises
    ------
    DamagedError
        If the file is missing or damaged.
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


def _read(path: Path, trajectory_crs: str | None) -> tuple[*_Record, CRS | None]:
    named = None
    if trajectory_crs is not None:
        named = parse_crs(trajectory_crs, "survey.trajectory_crs")
    if path.suffix.lower() in SBET_SUFFIXES:
        crs = named or CRS.from_user_input(SBET_CRS)
        if not crs.is_geographic:
            raise InputError(
                str(path),
                f"an SBET has latitude and longitude, survey.trajectory_crs is {crs_name(crs)}:"
                " name a geographic CRS or leave it out",
            )
        return *read_sbet(path), crs
    if path.suffix.lower() in _PARQUET_SUFFIXES:
        return *_read_parquet(path), named
    return *_read_csv(path), named


def _read_parquet(path: Path) -> _Record:
    with open_input(path):
        pass
    try:
        with pq.ParquetFile(path) as file:
            names = _columns(path, file.schema_arrow.names)
            return _arrays(path, file.read(columns=names), names)
    except pa.ArrowException as error:
        raise InputError(str(path), f"is not a Parquet trajectory: {_line(error)}") from None


def _read_csv(path: Path) -> _Record:
    with open_input(path) as file:
        head = file.readline(65_536).decode("utf-8-sig", errors="replace")
        delimiter = max(",;\t", key=head.count)
        given = next(csv.reader(io.StringIO(head.strip().lstrip("#")), delimiter=delimiter), [])
        names = _columns(path, given)
        try:
            table = pyarrow.csv.read_csv(
                file,
                read_options=pyarrow.csv.ReadOptions(column_names=given),
                parse_options=pyarrow.csv.ParseOptions(delimiter=delimiter),
                convert_options=pyarrow.csv.ConvertOptions(
                    include_columns=names,
                    column_types=dict.fromkeys(names, pa.float64()),
                    null_values=[""],
                ),
            )
        except pa.ArrowException as error:
            raise InputError(str(path), f"is not a CSV trajectory: {_line(error)}") from None
    return _arrays(path, table, names)


def _columns(path: Path, given: Sequence[str]) -> list[str]:
    """The file's own names of :data:`COLUMNS`."""
    by_name = {name.strip().lower(): name for name in reversed(given)}
    missing = [name for name in COLUMNS if name not in by_name]
    if missing:
        raise InputError(
            str(path),
            f"has no column {', '.join(missing)}; a trajectory has the columns"
            f" {', '.join(COLUMNS)}, this one {', '.join(n.strip()[:40] for n in given[:20])}",
        )
    return [by_name[name] for name in COLUMNS]


def _arrays(path: Path, table: pa.Table, names: Sequence[str]) -> _Record:
    for name in names:
        if table[name].null_count:
            raise InputError(str(path), f"column {name.strip()} has empty values; fill them")
    time, *position = (table[n].cast(pa.float64()).to_numpy().astype(np.float64) for n in names)
    return time, np.column_stack(position)


def _line(error: Exception) -> str:
    return " ".join(str(error).split())


def _refuse_non_finite(
    path: Path, time: NDArray[np.float64], position: NDArray[np.float64]
) -> None:
    wrong = ~(np.isfinite(time) & np.isfinite(position).all(axis=1))
    if wrong.any():
        raise InputError(
            str(path),
            f"{np.count_nonzero(wrong)} records are not finite, the first is record"
            f" {int(np.argmax(wrong))}: remove them",
        )


def _in_order(
    time: NDArray[np.float64], xyz: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], int]:
    # Position breaks ties, so that the order of files and records cannot matter.
    order = np.lexsort((xyz[:, 2], xyz[:, 1], xyz[:, 0], time))
    time, xyz = time[order], xyz[order]
    first = np.ones(len(time), dtype=np.bool_)
    first[1:] = np.diff(time) > 0
    return time[first], xyz[first], int(np.count_nonzero(~first))


def _transformed(
    path: Path, position: NDArray[np.float64], crs: CRS, survey_crs: CRS | None
) -> tuple[NDArray[np.float64], str | None]:
    """Positions in the survey's CRS, and a sentence if their heights stay as they are."""
    if survey_crs is None:
        raise InputError(
            str(path), f"is in {crs_name(crs)}, the survey has no CRS: name it in survey.crs"
        )
    problems = crs_problems(survey_crs, None, None)
    if problems:
        raise InputError(str(path), problems)
    warning = None
    xyz = None
    if len(crs.axis_info) == 3 and len(survey_crs.axis_info) == 3:
        xyz = _project(position, crs, survey_crs, best=True)
        if xyz is None:
            warning = (
                f"trajectory: heights stay those of {crs_name(crs)}; what converts them to"
                f" {crs_name(survey_crs)} is not installed (PROJ grids)"
            )
    if xyz is None:
        flat = _project(position, horizontal(crs), horizontal(survey_crs), best=False)
        if flat is None:
            raise InputError(
                str(path), f"cannot be transformed from {crs_name(crs)} to {crs_name(survey_crs)}"
            )
        xyz = np.column_stack([flat[:, :2], position[:, 2]])
    return xyz, warning


def _project(
    position: NDArray[np.float64], source: CRS, target: CRS, *, best: bool
) -> NDArray[np.float64] | None:
    """Transformed positions; none where PROJ cannot."""
    try:
        transformer = Transformer.from_crs(
            source, target, always_xy=True, only_best=best, allow_ballpark=not best
        )
        x, y, z = position.T
        columns = transformer.transform(x, y, z, errcheck=True)
    except ProjError:
        return None
    xyz = np.column_stack(columns)
    return xyz if np.isfinite(xyz).all() else None


def _refuse_far(path: Path, trajectory: Trajectory, bounds_m: Sequence[float]) -> None:
    half = len(bounds_m) // 2
    low, high = np.asarray(bounds_m[:2]), np.asarray(bounds_m[half : half + 2])
    xy = trajectory.xyz_m[:, :2]
    gap = np.maximum(np.maximum(low - xy, xy - high), 0.0)
    nearest = float(np.hypot(gap[:, 0], gap[:, 1]).min())
    if not nearest <= _FAR_M:
        middle = np.median(xy, axis=0)
        raise InputError(
            str(path),
            f"trajectory around x {middle[0]:.0f}, y {middle[1]:.0f} is {nearest / 1000:.0f} km"
            f" from the points (x {low[0]:.0f} to {high[0]:.0f}, y {low[1]:.0f} to {high[1]:.0f}):"
            " they are in different CRS, name the trajectory's in survey.trajectory_crs",
        )
