"""Beam geometry of each point, and what is estimated where the survey does not state it.

Domain: time.

Sources: [W17] 6.2.2 and [W18] 2.2.2: the line of sight joins the return with the trajectory at the
shot's time.

Deviations: without a trajectory the scan angle gives the beam, across the flight direction, or it
is vertical. Its origin is then where it crosses the height :data:`STAND_IN_HEIGHT_M`: ranges still
order the returns of a beam. How a flightline is cut does not matter.
"""

import math
from collections.abc import Sequence
from functools import cache
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.beams.rays import look
from spl_batch.airborne.beams.shot_runs import run_starts
from spl_batch.airborne.settings.survey import PRF_HZ
from spl_batch.constants import QUANTUM_M
from spl_batch.lattice.tables import BeamTable, PointTable, Trajectory

STAND_IN_HEIGHT_M: Final = 10_000.0
"""Height of stand-in origins [m]; above every terrain and every survey flight."""

LEAST_COSINE: Final = 0.1
"""Beams lean from the vertical by an angle whose cosine is larger than this, and look down."""

FARTHEST_M: Final = 20_000.0
"""Slant range that no airborne survey has [m]."""

STEP_BIN_S: Final = 1e-8
"""Bin of the histogram of steps between shots [s]."""

STEP_BINS: Final = round(1.0 / (PRF_HZ[0] * STEP_BIN_S))
"""Bins of that histogram: steps up to that of the slowest pulse rate."""

ELSEWHERE_M: Final = 10_000.0
"""Distance from its first return at which a shot of an aircraft has none [m]."""

ASIDE_M: Final = 1.0
"""What places may be off for other reasons, at most [m]."""

LONGER: Final = 1.51
"""Ratio of steps between shots that are one period: rounding makes them 2 and 3 units long."""

PRF_DIGITS: Final = 3
"""Digits of an estimated pulse rate [count]: rounded times give no more in short files."""

AHEAD_S: Final = 1.0
"""Time in which a scan looks ahead and astern many times over [s]."""

AHEAD_RETURNS: Final = 20_000
"""Returns of a stretch by which it is asked how far ahead they lie [count]."""

LOOKS_AHEAD: Final = 0.05
"""Returns lie ahead of a sensor on average by no more than this part of its height."""

MIN_ANGLES: Final = 16
"""Fewer distinct scan angles than this are a label of the line, not a geometry."""


def beams(
    table: PointTable, trajectory: Trajectory | None, *, heading_rad: float | None = None
) -> BeamTable:
    """Line of sight of each point.

    Parameters
    ----------
    table : PointTable
        With ``x, y, z, gps_time, scan_angle``; times are finite.
    trajectory : Trajectory or None
        Sensor positions; where they do not cover a time the beam is not known, nor is that of a
        return that no sensor there can have seen: it is not below it, or farther than
        :data:`FARTHEST_M`.
    heading_rad : float, optional
        Flight direction, clockwise from north [rad], used without a trajectory: beams
        then lean by the scan angle to starboard. None gives vertical beams.
    """
    if trajectory is not None:
        return _from_trajectory(table, trajectory)
    points = np.empty((len(table), 3), dtype=np.float64)
    for axis, name in enumerate(("x", "y", "z")):
        points[:, axis] = table[name] * QUANTUM_M
    lean = np.zeros(len(table))
    if heading_rad is not None:
        lean = np.deg2rad(table["scan_angle"].astype(np.float64))
    starboard = (0.0, 0.0) if heading_rad is None else (np.cos(heading_rad), -np.sin(heading_rad))
    return _stand_in(points, lean, starboard)


def _from_trajectory(table: PointTable, trajectory: Trajectory) -> BeamTable:
    n = len(table)
    shots = run_starts(table["gps_time"])
    sensor, covered = trajectory.position(table["gps_time"][shots[:-1]])
    origin, direction, range_m = np.empty((n, 3)), np.empty((n, 3)), np.empty(n)
    place = (table["x"], table["y"], table["z"])
    look(shots, sensor, place, QUANTUM_M, origin, direction, range_m)
    # A return beside or above the sensor, or so far from it, is a fault of its coordinates.
    possible = (direction[:, 2] < -LEAST_COSINE) & (range_m > 0) & (range_m < FARTHEST_M)
    known: NDArray[np.bool_] = np.repeat(covered, np.diff(shots)) & possible
    return BeamTable(origin, direction, range_m, known)


def _stand_in(
    points: NDArray[np.float64], lean_rad: NDArray[np.float64], starboard: Sequence[float]
) -> BeamTable:
    cosine = np.cos(lean_rad)
    direction = np.column_stack(
        [np.sin(lean_rad) * starboard[0], np.sin(lean_rad) * starboard[1], -cosine]
    )
    known: NDArray[np.bool_] = (cosine > LEAST_COSINE) & (points[:, 2] < STAND_IN_HEIGHT_M)
    range_m = (STAND_IN_HEIGHT_M - points[:, 2]) / np.where(known, cosine, 1.0)
    return BeamTable(points - direction * range_m[:, None], direction, range_m, known)


def observe_track(table: PointTable) -> dict[str, NDArray[np.int64]]:
    """What a flightline's heading is estimated from; parts of a flightline add up.

    Parameters
    ----------
    table : PointTable
        Points of one flightline with finite times, at least one.

    Returns
    -------
    dict
        ``second`` (m,), and per whole second ``count``, ``x_sum``, ``y_sum`` [quanta];
        ``angle`` (a,) distinct scan angles [mdeg], all int64.
    """
    second = np.floor(table["gps_time"]).astype(np.int64)
    x, y = table["x"], table["y"]
    if np.any(second[1:] < second[:-1]):
        order = np.argsort(second, kind="stable")
        second, x, y = second[order], x[order], y[order]
    starts = run_starts(second)
    angle = np.rint(table["scan_angle"].astype(np.float64) * 1000).astype(np.int64)
    return {
        "second": second[starts[:-1]],
        "count": np.diff(starts),
        "x_sum": np.add.reduceat(x, starts[:-1]),
        "y_sum": np.add.reduceat(y, starts[:-1]),
        "angle": np.flatnonzero(np.bincount(angle - angle.min()))[: 4 * MIN_ANGLES] + angle.min(),
    }


def merge_track(parts: Sequence[dict[str, NDArray[np.int64]]]) -> dict[str, NDArray[np.int64]]:
    """Add up parts of :func:`observe_track`, in any order, or none."""
    names = ("second", "angle", "count", "x_sum", "y_sum")
    joined = {
        name: np.concatenate([np.empty(0, np.int64), *(part[name] for part in parts)])
        for name in names
    }
    second, inverse = np.unique(joined["second"], return_inverse=True)
    merged = {"second": second, "angle": np.unique(joined["angle"])[: 4 * MIN_ANGLES]}
    for name in names[2:]:
        merged[name] = np.zeros(len(second), dtype=np.int64)
        np.add.at(merged[name], inverse, joined[name])
    return merged


def heading_from_track(track: dict[str, NDArray[np.int64]]) -> float | None:
    """Flight direction from the drift of the points' centroid.

    Returns
    -------
    float or None
        Heading, clockwise from north [rad]; None (beams are then vertical) where the
        scan angle takes too few values to be a geometry, or the drift is no clear line.
    """
    if len(track["angle"]) < MIN_ANGLES or len(track["second"]) < 3:
        return None
    # The first and last second are cut somewhere: their centroids are not comparable.
    inner = slice(1, -1) if len(track["second"]) > 4 else slice(None)
    time = (track["second"] - track["second"][0])[inner].astype(np.float64)
    x = ((track["x_sum"] / track["count"])[inner]) * QUANTUM_M
    y = ((track["y_sum"] / track["count"])[inner]) * QUANTUM_M
    speed = np.array([np.polynomial.polynomial.polyfit(time, v, 1)[1] for v in (x, y)])
    travelled = float(np.hypot(*speed) * np.ptp(time))
    spread = np.hypot(
        x - x.mean() - speed[0] * (time - time.mean()),
        y - y.mean() - speed[1] * (time - time.mean()),
    )
    if travelled < 50.0 or float(np.median(spread)) > 0.1 * travelled:
        return None
    return float(np.arctan2(speed[0], speed[1]))


class Ahead(NamedTuple):
    """How far ahead of the sensor, or astern, its returns lie on average."""

    ahead_m: float  #: Along the direction of flight [m].
    height_m: float  #: Of the sensor above them [m].
    speed_m_s: float  #: Of the sensor over ground [m/s].

    @property
    def is_above(self) -> bool:
        """Whether the sensor is about above what it sees."""
        return abs(self.ahead_m) <= LOOKS_AHEAD * self.height_m


def look_ahead(beams: BeamTable, time_s: NDArray[np.float64]) -> Ahead | None:
    """Mean look along the flight direction: near zero, as scans look both ways.

    Parameters
    ----------
    beams : BeamTable
        Beams of returns in time order, from positions that are not derived from them: (n,).
    time_s : (n,) float64
        Their times [s].

    Returns
    -------
    Ahead or None
        None where the sensor is known for less than :data:`AHEAD_S`, or stands still.
    """
    rows = np.flatnonzero(beams.known)
    rows = rows[:: max(len(rows) // AHEAD_RETURNS, 1)]
    if not len(rows) or time_s[rows[-1]] - time_s[rows[0]] < AHEAD_S:
        return None
    time, place = time_s[rows] - time_s[rows].mean(), beams.origin_m[rows, :2]
    velocity = time @ (place - place.mean(axis=0)) / (time @ time)
    speed = float(np.hypot(*velocity))
    if speed < 1.0:
        return None
    to_return = beams.direction[rows] * beams.range_m[rows, None]
    ahead = float(np.mean(to_return[:, :2] @ velocity)) / speed
    return Ahead(ahead, float(-np.mean(to_return[:, 2])), speed)


def off_one_beam(table: PointTable) -> tuple[int, int, int]:
    """Returns of one channel and one time, and those that cannot lie on one beam with the first.

    Parameters
    ----------
    table : PointTable
        Rows sorted by ``gps_time`` and ``channel``, with ``x, y, z``.

    Returns
    -------
    together, apart, elsewhere : int
        Returns that follow another one of their channel and time; those of them that lie farther
        aside of the first one than :data:`ASIDE_M` and a beam of 45 degrees explain; and those that
        lie farther than :data:`ELSEWHERE_M`, where no shot of the same flight does [count].
    """
    starts = run_starts(table["gps_time"], table["channel"])
    first = np.repeat(starts[:-1], np.diff(starts))
    later = np.flatnonzero(first < np.arange(len(first)))
    steps = (table[axis][later].astype(np.int64) - table[axis][first[later]] for axis in "xyz")
    east, north, up = (QUANTUM_M * step for step in steps)
    aside = np.hypot(east, north)
    apart, elsewhere = aside > ASIDE_M + np.abs(up), aside > ELSEWHERE_M
    return len(later), int(np.count_nonzero(apart)), int(np.count_nonzero(elsewhere))


def ordered_times(time_s: NDArray[np.float64]) -> NDArray[np.float64]:
    """Times in order; the given array if they are."""
    return np.sort(time_s) if np.any(time_s[1:] < time_s[:-1]) else time_s


def shot_steps(time_s: NDArray[np.float64]) -> NDArray[np.int64]:
    """Histogram of the steps between consecutive shots; histograms add up.

    Parameters
    ----------
    time_s : (n,) float64
        Times of the points of one flightline, in any order; not finite ones are ignored.

    Returns
    -------
    (STEP_BINS,) int64
        Number of steps by length, in bins of :data:`STEP_BIN_S`; longer ones are dropped.
    """
    time = ordered_times(time_s[np.isfinite(time_s)])
    step = np.diff(time[run_starts(time)[:-1]])
    step = step[step < (STEP_BINS - 1) * STEP_BIN_S]
    index = np.rint(step / STEP_BIN_S).astype(np.int64)
    return np.bincount(index, minlength=STEP_BINS).astype(np.int64)


@cache
def _windows() -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
    """Window of +-2 % around each bin, in which jitter does not split the mode [bins].

    Its first bin, the one after its last, and the square root of their number; the same for each of
    thousands of flightlines.
    """
    step = np.arange(STEP_BINS)
    half = np.maximum(3, step // 50)
    low = np.maximum(step - half, 0)
    high = np.minimum(step + half + 1, STEP_BINS)
    return low, high, np.sqrt(high - low)


def estimate_prf(steps: NDArray[np.int64]) -> float | None:
    """Pulse repetition frequency from the steps between shots.

    Silent shots make steps of two and more periods, but one period stays the commonest. The mean
    of all steps nearer to it than to two periods takes out the jitter (20.03 / 19.97 us), and a
    rounding of times to up to half a period. It has :data:`PRF_DIGITS`, so that a flightline has
    the same whatever files it is cut into.

    Parameters
    ----------
    steps : (STEP_BINS,) int64
        Sum of histograms of :func:`shot_steps`.

    Returns
    -------
    float or None
        PRF [Hz]; None where no step is common enough, or half or twice the commonest is there as
        well: then times are rounded to most of a period, and the rate has to be stated.
    """
    total = int(steps.sum())
    if total < 10:
        return None
    low, high, root = _windows()
    cumulative = np.concatenate([[0], np.cumsum(steps)])
    window = (cumulative[high] - cumulative[low]).astype(np.float64)
    window[:4] = 0
    # The window widens with the step, so ties and trends favour the long steps: undo it.
    mode = int(np.argmax(window / root))
    if window[mode] < max(5.0, 0.05 * total):
        return None
    halves, doubles = (steps[round(0.95 * k * mode) : round(1.05 * k * mode)] for k in (0.5, 2))
    if halves.sum() > 0.05 * window[mode] or doubles.sum() > window[mode]:
        return None
    near = slice(math.ceil(mode / LONGER), math.floor(mode * LONGER) + 1)
    centre = np.arange(len(steps))[near] * STEP_BIN_S
    period = float(np.dot(steps[near], centre) / steps[near].sum())
    return float(f"{1.0 / period:.{PRF_DIGITS}g}")
