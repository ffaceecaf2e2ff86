"""Frozen value types that travel between the storeys; names, dtypes and units of columns.

A *table* is a set of equally long numpy columns. Coordinates are integers on the survey-wide
lattice (:data:`~spl_batch.constants.QUANTUM_M`), never metres relative to a part of the survey.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import IntFlag
from types import MappingProxyType
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import DTypeLike, NDArray

from spl_batch.lattice.row_order import lexicographic_order


class Column(NamedTuple):
    """What a column holds: its dtype on disk and in memory, unit and meaning."""

    dtype: DTypeLike
    unit: str
    meaning: str


COLUMNS: Final[Mapping[str, Column]] = MappingProxyType(
    {
        "x": Column(np.int64, "quanta", "easting on the survey lattice"),
        "y": Column(np.int64, "quanta", "northing on the survey lattice"),
        "z": Column(np.int32, "quanta", "height on the survey lattice"),
        "gps_time": Column(np.float64, "s", "time as the file has it; NaN where it has none"),
        "channel": Column(np.uint8, "", "beamlet number as the file has it; 0 where it has none"),
        "return_number": Column(np.uint8, "", "LAS return number"),
        "number_of_returns": Column(np.uint8, "", "LAS number of returns of the pulse"),
        "scan_angle": Column(np.float32, "deg", "LAS scan angle, positive to starboard"),
        "point_source_id": Column(np.uint16, "", "LAS point source id"),
        "line": Column(np.uint16, "", "flightline, by its number in the survey"),
        "intensity": Column(np.uint16, "", "LAS intensity as delivered"),
        "input_class": Column(np.uint8, "", "LAS classification of the input"),
        "flags": Column(np.uint8, "", "bits of PointFlag"),
        "source": Column(np.uint64, "", "key of the input file"),
        "index": Column(np.uint32, "", "position of the point in its input file"),
        "shot": Column(np.int64, "", "shot number on the flightline's absolute grid"),
        "line_density": Column(np.float32, "1/m", "noise points per metre of this beamlet"),
        "afterpulse": Column(np.float32, "", "probability of being an afterpulse, 0..1"),
        "afterpulse_rate": Column(
            np.float32, "1/m", "afterpulses per metre of beamlet at its lags, 0 for no parent"
        ),
        "afterpulse_share": Column(np.float32, "", "afterpulses per detection of its flightline"),
        "range_sigma": Column(np.float32, "m", "ranging spread of its flightline, one sigma"),
        "noise_density": Column(np.float32, "1/m3", "expected noise points per cubic metre"),
        "p_value": Column(np.float32, "", "P(at least as many neighbours | noise)"),
        "noise_class": Column(
            np.uint8, "", "0 signal, 1 background, 2 afterpulse, 255 not assessed"
        ),
        "wire": Column(np.uint8, "", "1 where the scan along lines is sure of a conductor"),
        "ground": Column(np.uint8, "", "1 on the terrain, else 0"),
        "classification": Column(np.uint8, "", "ASPRS class as delivered"),
        "set_flags": Column(np.uint8, "", "LAS flags that are set: 4 withheld, 8 overlap"),
        "HeightAboveGround": Column(np.float32, "", "height above the terrain as delivered"),
    }
)
"""Every column that a table may have."""

SOURCE_COLUMNS: Final = (
    *("x", "y", "z", "gps_time", "channel", "return_number", "scan_angle", "point_source_id"),
    *("number_of_returns", "intensity", "input_class", "flags", "source", "index"),
)
"""Columns that reading an input file gives."""


class PointFlag(IntFlag):
    """Facts about one point that decide what may be done with it."""

    WITHHELD = 1
    """The vendor withheld the point: it is carried along and takes part in nothing."""
    VENDOR_NOISE = 2
    """The input class is 7 or 18: carried along, counted, takes part in nothing."""
    NO_BEAM = 4
    """No valid time, or the trajectory does not cover it: left unfiltered."""
    OUTSIDE_AOI = 8
    """Outside the area of interest: carried along, takes part as a neighbour only."""
    WATER = 16
    """Inside a water polygon."""
    SHOT_NOISE = 32
    """The filter of single shots (differential cell count), where it ran, calls it noise, or it is
    far beyond the range gate that is stated."""


EXCLUDED: Final = PointFlag.WITHHELD | PointFlag.VENDOR_NOISE
"""Flags of points that no computation looks at."""

UNFILTERED: Final = EXCLUDED | PointFlag.NO_BEAM | PointFlag.OUTSIDE_AOI
"""Flags of points whose ``noise_class`` is "not assessed"."""


@dataclass(frozen=True, slots=True)
class PointTable:
    """Equally long columns of points.

    Raises
    ------
    ValueError
        If the columns differ in length or a name is unknown.
    """

    #: mapping of str to ndarray: one-dimensional arrays; names and dtypes as in :data:`COLUMNS`.
    columns: Mapping[str, NDArray[Any]]

    def __post_init__(self) -> None:
        lengths = {len(values) for values in self.columns.values()}
        if len(lengths) > 1:
            raise ValueError(f"columns differ in length: {sorted(lengths)}")
        unknown = set(self.columns) - set(COLUMNS)
        if unknown:
            raise ValueError(f"unknown columns: {sorted(unknown)}")

    def __len__(self) -> int:
        return len(next(iter(self.columns.values()))) if self.columns else 0

    def __getitem__(self, name: str) -> NDArray[Any]:
        return self.columns[name]

    def __contains__(self, name: object) -> bool:
        return name in self.columns

    def with_columns(self, **columns: NDArray[Any]) -> "PointTable":
        """Table with columns added or replaced, cast to their declared dtypes."""
        cast = {k: np.asarray(v, dtype=COLUMNS[k].dtype) for k, v in columns.items()}
        return PointTable({**self.columns, **cast})

    def take(self, selection: NDArray[Any] | slice) -> "PointTable":
        """Rows by mask, index array or slice; a slice, or a mask of all, copies nothing."""
        if isinstance(selection, slice):
            return PointTable({k: v[selection] for k, v in self.columns.items()})
        if selection.dtype == np.bool_ and len(selection) == len(self) and selection.all():
            return PointTable(dict(self.columns))
        rows = np.flatnonzero(selection) if selection.dtype == np.bool_ else selection
        return PointTable({k: v.take(rows) for k, v in self.columns.items()})

    def select(self, names: Sequence[str]) -> "PointTable":
        """Columns by name."""
        return PointTable({k: self.columns[k] for k in names})

    def has(self, flags: PointFlag) -> NDArray[np.bool_]:
        """Which points carry any of these flags: (n,) bool."""
        mask: NDArray[np.bool_] = (self.columns["flags"] & np.uint8(flags)) != 0
        return mask


def rows_of(chosen: NDArray[np.bool_]) -> NDArray[np.intp] | slice:
    """Rows that are chosen by (n,) bool; a slice, which copies nothing, where they adjoin."""
    rows = np.flatnonzero(chosen)
    if len(rows) and rows[-1] - rows[0] + 1 == len(rows):
        return slice(int(rows[0]), int(rows[-1]) + 1)
    return rows


def concat(tables: Sequence[PointTable], names: Sequence[str]) -> PointTable:
    """Tables one below the other, with these columns; none gives an empty table."""
    if not tables:
        return PointTable({k: np.empty(0, dtype=COLUMNS[k].dtype) for k in names})
    if len(tables) == 1:
        return tables[0].select(names)
    return PointTable({k: np.concatenate([t[k] for t in tables]) for k in names})


CANONICAL_ORDER: Final = ("x", "y", "z", "gps_time", "channel", "return_number", "source", "index")
"""Sort keys, first one first, that put the same points in the same order always."""


def canonical_order(table: PointTable) -> NDArray[np.intp]:
    """Indices that sort a table by :data:`CANONICAL_ORDER`: (n,) intp."""
    return lexicographic_order([table[k] for k in CANONICAL_ORDER])


@dataclass(frozen=True, slots=True)
class Trajectory:
    """Positions of the sensor in the survey's CRS and the point clouds' time."""

    #: (m,): strictly increasing times, in the same standard as the points' ``gps_time`` [s].
    time_s: NDArray[np.float64]
    xyz_m: NDArray[np.float64]  #: (m, 3): easting, northing, height [m].
    max_gap_s: float = 2.0  #: Longest step that is interpolated over [s].

    def position(
        self, time_s: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """Linear interpolation.

        Parameters
        ----------
        time_s : (n,) float64
            Times [s]; NaN is not covered.

        Returns
        -------
        xyz_m : (n, 3) float64
            Positions [m]; NaN where not covered.
        covered : (n,) bool
            False before the first, after the last and inside a gap of the record.
        """
        n = len(time_s)
        if len(self.time_s) < 2:
            return np.full((n, 3), np.nan), np.zeros(n, dtype=np.bool_)
        right = np.clip(np.searchsorted(self.time_s, time_s, side="right"), 1, len(self.time_s) - 1)
        t0, t1 = self.time_s[right - 1], self.time_s[right]
        covered: NDArray[np.bool_] = (
            (time_s >= self.time_s[0]) & (time_s <= self.time_s[-1]) & (t1 - t0 <= self.max_gap_s)
        )
        weight = ((time_s - t0) / (t1 - t0))[:, None]
        xyz = self.xyz_m[right - 1] * (1 - weight) + self.xyz_m[right] * weight
        xyz[~covered] = np.nan
        return xyz, covered

    def clip(self, start_s: float, stop_s: float) -> "Trajectory":
        """Records that are needed to interpolate within ``[start_s, stop_s]``."""
        first = max(int(np.searchsorted(self.time_s, start_s, side="right")) - 1, 0)
        last = int(np.searchsorted(self.time_s, stop_s, side="left")) + 1
        return Trajectory(self.time_s[first:last], self.xyz_m[first:last], self.max_gap_s)


@dataclass(frozen=True, slots=True)
class ShotClock:
    """Absolute shot grid of one flightline: shot = round((t - t0) PRF)."""

    t0_s: float  #: Time of shot 0 [s]; a whole second.
    prf_hz: float

    def shot(self, time_s: NDArray[np.float64]) -> NDArray[np.int64]:
        """Shot number of each time: (n,) int64; times must be finite."""
        number: NDArray[np.int64] = np.rint((time_s - self.t0_s) * self.prf_hz).astype(np.int64)
        return number


@dataclass(frozen=True, slots=True)
class BeamTable:
    """Geometry of the beamlet that each point lies on."""

    #: (n, 3): sensor position at the shot's time [m]; NaN where the beam is not known.
    origin_m: NDArray[np.float64]
    direction: NDArray[np.float64]  #: (n, 3): unit vector from the sensor to the point.
    #: (n,): slant range from the sensor (or, without a trajectory, from a stand-in) [m].
    range_m: NDArray[np.float64]
    known: NDArray[np.bool_]  #: (n,): whether the beam is known.

    def take(self, selection: NDArray[Any] | slice) -> "BeamTable":
        """Rows by mask, index array or slice; a slice copies nothing."""
        columns: Sequence[Any] = (self.origin_m, self.direction, self.range_m, self.known)
        if isinstance(selection, slice):
            return BeamTable(*(column[selection] for column in columns))
        rows = np.flatnonzero(selection) if selection.dtype == np.bool_ else selection
        # Rows of three numbers are taken in a tenth of the time that indexing them needs.
        return BeamTable(*(column.take(rows, axis=0) for column in columns))


@dataclass(frozen=True, slots=True)
class VoxelPart:
    """One stretch's share of the voxel-spherical noise model."""

    corner: tuple[int, int, int]  #: Absolute index of the first voxel along x, y, z.
    #: (nx, ny, nz): expected noise points per sphere, fixed point, in 2**-32 points; parts add up.
    amount: NDArray[np.int64]
    #: (nx, ny, nz): shots and beamlets that touch each sphere, for the published correction; they
    #: add up as well.
    shots: NDArray[np.int64] | None = None
    beamlets: NDArray[np.int64] | None = None
    #: (nx, ny, nz, 16): seen beamlets that cross each square of a quarter of a voxel's edge
    #: half-way up the voxel, at x * 4 + y, 16 for one over ground of gain 1; they add up as well.
    squares: NDArray[np.uint16] | None = None

    def layers(self) -> range:
        """Absolute indices of its layers."""
        return range(self.corner[2], self.corner[2] + self.amount.shape[2])

    def add(self, corner: Sequence[int], totals: Mapping[str, NDArray[Any]]) -> None:
        """Add it to a box of voxels, in place, where they overlap.

        ``corner``: absolute index of the box's first voxel; ``totals``: the box by the name of the
        sum, ``amount``, ``shots``, ``beamlets``, ``squares``.
        """
        for name, total in totals.items():
            values = getattr(self, name)
            low = np.maximum(self.corner, corner)
            ends = np.add(self.corner, values.shape[:3]), np.add(corner, total.shape[:3])
            high = np.maximum(np.minimum(*ends), low)
            of_part, of_box = (
                tuple(map(slice, low - first, high - first)) for first in (self.corner, corner)
            )
            total[of_box] += values[of_part].astype(total.dtype, copy=False)

    def box(self) -> list[int]:
        """First voxel along x, y, z, and the ones past the last."""
        ends = (c + n for c, n in zip(self.corner, self.amount.shape, strict=True))
        return [*self.corner, *ends]


FIXED_POINT: Final = 2.0**32
"""Steps of a sum per whole: of :attr:`VoxelPart.amount` per point, of light per photo-electron."""

ROWS_AT_ONCE: Final = 1 << 14
"""Rows that are looked up at once where a step makes many arrays of them; speed and memory only
[count]."""


TILE_COLUMNS: Final = (
    *("x", "y", "z", "gps_time", "channel", "return_number", "line", "intensity", "input_class"),
    *("number_of_returns", "flags", "source", "index"),
    *("line_density", "afterpulse", "afterpulse_rate", "afterpulse_share", "range_sigma"),
)
"""Columns of a point tile."""
