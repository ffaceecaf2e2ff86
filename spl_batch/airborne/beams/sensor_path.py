"""Path of the sensor, from the points alone: where lines of sight meet.

Domain: time.

Returns of one beamlet lie on one line; all lines of a shot, and of those around it, meet at the
sensor. [W17] 6.2.2 and [W18] 2.2.2 take its position from the trajectory, and leave open what to do
without one. Here

| symbol | name |
|---|---|
| x = a + b (z - c) | a line of sight, ``across`` + ``slope`` (z - ``height``), by least squares |
| S | ``spread``: sum of (z - c)^2; the variance of b is that of a return over S |
| P(t) | the sensor: linear between whole seconds, [X, Y, Z] |

P minimises the robust sum of (X - a_x - b_x (Z - c))^2 S / (Z - c)^2, likewise in y, plus what is
known of any aircraft: it accelerates little, and flies above the points. Without a
channel dimension a shot's pencil of beamlets stands for one line; the robust scale then finds its
width as the error.

How a flightline is cut does not matter: lines are chosen within absolute intervals of shots, and
the seconds are absolute.
"""

from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solveh_banded

from spl_batch.airborne.beams.shot_runs import run_starts
from spl_batch.constants import FOOT_M, QUANTUM_M
from spl_batch.lattice.tables import PointTable, Trajectory

PER_INTERVAL: Final = 2
"""Lines kept of each interval of shots: those with the largest spread [count]. Half and twice move
13 and 6 labels of the scene *water* without its trajectory; the other numbers here move none."""

PENCIL_SPREAD_MIN_M2: Final = 450.0
"""Least spread of a shot's line: metres wide, it has to be tens of metres long [m2]. That of a
beamlet counts by its spread, however little that is."""

LINES_MIN: Final = 40
"""Fewer lines than this in a flightline show no sensor [count]."""

ERROR_MAX_RAD: Final = 5e-3
"""Beams whose halves of the evidence disagree by more are not believed [rad]."""

ACCELERATION_M_S2: Final = 1.0
"""Spread of an aircraft's acceleration [m/s2]."""

SPEED_M_S: Final = 150.0
"""Spread of its speed, per axis [m/s]."""

ABOVE_M: Final = 2500.0
"""Height above the points, and its spread [m]."""

ROUNDS: Final = 15
"""Rounds of re-weighting [count]."""

_HALF_BAND: Final = 6
"""Knots two seconds apart meet in an acceleration: three unknowns each."""


class Lines(NamedTuple):
    """Lines of sight, in time order."""

    time_s: NDArray[np.float64]  #: (n,): when they were looked along [s].
    across: NDArray[np.float64]  #: (n, 2): mean easting and northing of the returns [m].
    height: NDArray[np.float64]  #: (n,): their mean height [m].
    slope: NDArray[np.float64]  #: (n, 2): easting and northing per metre of height.
    spread: NDArray[np.float64]  #: (n,): sum of the squared heights about the mean [m2].

    def take(self, rows: NDArray[Any]) -> "Lines":
        """Some of the lines."""
        return Lines(*(values[rows] for values in self))


class Path(NamedTuple):
    """Where the sensor was."""

    trajectory: Trajectory | None  #: None where the lines do not show it.
    lines: int  #: Lines of sight that took part [count].
    #: Half the angle between beams from two halves of the lines, 90th percentile [rad].
    error_rad: float | None


def collect(table: PointTable, beamlets: int, interval_shots: int) -> dict[str, NDArray[Any]]:
    """Best lines of sight of each interval of a stretch: fields of :class:`Lines`.

    Parameters
    ----------
    table : PointTable
        Rows of one stretch, with ``x, y, z, shot``, sorted by (gps_time, channel, ...).
    beamlets : int
        Beamlets of a shot; with one, a shot's returns make one line.
    interval_shots : int
        Shots of an interval; stretches begin at multiples of it.
    """
    starts = run_starts(table["gps_time"], table["channel"])
    first, size = starts[:-1], np.diff(starts)
    if not len(first):
        none, pair = np.empty(0), np.empty((0, 2))
        return Lines(none, pair, none, pair, none)._asdict()
    # Differences to a group's first return are whole numbers, so their sums are exact.
    own = [
        (table[k].astype(np.int64) - np.repeat(table[k][first].astype(np.int64), size)) * QUANTUM_M
        for k in "xyz"
    ]
    sums = [np.add.reduceat(values, first) for values in own]
    spread = np.add.reduceat(own[2] ** 2, first) - sums[2] ** 2 / size
    limit, least = (0.0, 2) if beamlets > 1 else (PENCIL_SPREAD_MIN_M2, 3)
    interval = np.floor_divide(table["shot"][first], interval_shots)
    kept = _best(interval, spread, (spread > limit) & (size >= least))
    mean = np.stack(
        [table[k][first] * QUANTUM_M + s / size for k, s in zip("xyz", sums, strict=True)]
    )
    slope = np.stack(
        [
            (np.add.reduceat(own[a] * own[2], first) - sums[a] * sums[2] / size)[kept]
            / spread[kept]
            for a in range(2)
        ],
        axis=1,
    )
    lines = Lines(
        table["gps_time"][first[kept]], mean[:2, kept].T, mean[2, kept], slope, spread[kept]
    )
    return lines._asdict()


def _best(
    interval: NDArray[np.int64], spread: NDArray[np.float64], usable: NDArray[np.bool_]
) -> NDArray[np.intp]:
    """The usable lines of each interval with the largest spread; the earlier of equals."""
    rows = np.flatnonzero(usable)
    order = rows[np.lexsort([rows, -spread[rows], interval[rows]])]
    starts = run_starts(interval[order])
    rank = np.arange(len(order)) - np.repeat(starts[:-1], np.diff(starts))
    return np.sort(order[rank < PER_INTERVAL])


def other_unit(lines: Lines, sensor_m: NDArray[np.float64]) -> tuple[float, float] | None:
    """Height of a sensor above its returns [m], and that at which lines of sight meet below it.

    Parameters
    ----------
    lines : Lines
        Some lines of sight.
    sensor_m : (n, 3) float64
        Where a trajectory has the sensor at their times [m]; NaN where it has not.

    Returns
    -------
    (float, float) or None
        None where they differ by another factor than feet and metres do, or too few lines agree.
    """
    aside = np.sum((sensor_m[:, :2] - lines.across) * lines.slope, axis=1)
    square = np.sum(lines.slope**2, axis=1)
    seen = (aside > 0.0) & (square > 0.0) & np.isfinite(sensor_m).all(axis=1)
    if np.count_nonzero(seen) < max(LINES_MIN, len(seen) / 2):
        return None
    met = aside[seen] / square[seen]
    stated = (sensor_m[:, 2] - lines.height)[seen]
    low, high = np.quantile(stated / met, (0.25, 0.75))
    near = FOOT_M**-0.5
    if not any(unit / near < low and high < unit * near for unit in (FOOT_M, 1.0 / FOOT_M)):
        return None
    return float(np.median(stated)), float(np.median(met))


def merge(parts: Sequence[dict[str, NDArray[Any]]]) -> Lines:
    """Join lines of a flightline's stretches, in any order; at least one part."""
    joined = Lines(*(np.concatenate([p[name] for p in parts]) for name in Lines._fields))
    keys = (*joined.across.T, joined.height, joined.spread, joined.time_s)
    return joined.take(np.lexsort(keys))


def find_path(lines: Lines, span_s: tuple[float, float]) -> Path:
    """Path of the sensor over a flightline.

    ``lines``: from :func:`merge`. ``span_s``: first and last time of the flightline's points [s].
    """
    if len(lines.time_s) < LINES_MIN:
        return Path(None, len(lines.time_s), None)
    seconds = np.arange(np.floor(span_s[0]), np.floor(span_s[1]) + 2.0)
    found = intersect(lines, seconds)
    # Neighbours in time share their errors: pieces go to one half or the other by a golden-section
    # sequence, which no scan keeps pace with.
    piece = (np.floor(lines.time_s * 100.0) * 0.6180339887498949) % 1.0 < 0.5
    halves = [intersect(lines.take(np.flatnonzero(part)), seconds) for part in (piece, ~piece)]
    error = _disagreement(lines, *(Trajectory(seconds, half) for half in halves))
    height = _at(found, seconds, lines.time_s)[:, 2] - lines.height
    speed = np.hypot(*np.diff(found[:, :2], axis=0).T)
    sound = error <= ERROR_MAX_RAD and height.min() > 0 and float(np.median(speed)) < 400.0
    return Path(Trajectory(seconds, found) if sound else None, len(lines.time_s), error)


def _disagreement(lines: Lines, one: Trajectory, other: Trajectory) -> float:
    """Half the angle between beams to two paths, at the lines: 90th percentile [rad]."""
    a, b = (_at(t.xyz_m, t.time_s, lines.time_s) for t in (one, other))
    apart = a - b
    across = apart[:, :2] - lines.slope * apart[:, 2:]
    height = np.maximum(0.5 * (a + b)[:, 2] - lines.height, 1.0)
    return 0.5 * float(np.quantile(np.hypot(*across.T) / height, 0.9))


def _at(
    knots: NDArray[np.float64], seconds: NDArray[np.float64], time_s: NDArray[np.float64]
) -> NDArray[np.float64]:
    return np.stack([np.interp(time_s, seconds, values) for values in knots.T], axis=1)


def intersect(lines: Lines, seconds: NDArray[np.float64]) -> NDArray[np.float64]:
    """Robust path through which the lines pass: (k, 3) float64, positions at the seconds [m].

    Parameters
    ----------
    lines : Lines
        Lines of sight within the seconds, any number.
    seconds : (k,) float64
        Whole seconds, one after the other, k >= 2 [s].
    """
    anchor = np.zeros(3)
    if len(lines.time_s):
        anchor[:] = *np.median(lines.across, axis=0), np.median(lines.height)
    across, height = lines.across - anchor[:2], lines.height - anchor[2]
    knot = np.clip(np.floor(lines.time_s - seconds[0]).astype(np.int64), 0, len(seconds) - 2)
    share = lines.time_s - seconds[0] - knot
    target = across - lines.slope * height[:, None]
    above = np.full(len(height), ABOVE_M)
    robust, lift, scale = np.ones(len(height)), np.zeros(len(height)), 1.0
    path = np.zeros((len(seconds), 3))
    for k in range(ROUNDS):
        weight = robust * lines.spread / (scale * above) ** 2
        path = _solve(lines.slope, target, (knot, share), weight, weight * lift, len(seconds))
        at = path[knot] * (1 - share)[:, None] + path[knot + 1] * share[:, None]
        above = np.maximum(at[:, 2] - height, 10.0)
        missed = np.hypot(*(at[:, :2] - lines.slope * at[:, 2:] - target).T)
        # What is missed grows with the height; a sum that ignores it pulls the sensor down.
        lift = missed**2 / above
        size = missed * np.sqrt(lines.spread) / above
        # The median of a Rayleigh variable is 1.1774 of its scale.
        scale = max(float(np.median(size)) / 1.1774 if len(size) else 1.0, 0.1 * QUANTUM_M)
        robust = _weights(size / scale, bisquare=k >= 3)
    return path + anchor


def _weights(size: NDArray[np.float64], *, bisquare: bool) -> NDArray[np.float64]:
    """Huber's weights first, which find the way from anywhere; then Tukey's."""
    if not bisquare:
        return 1.5 / np.maximum(size, 1.5)
    weights: NDArray[np.float64] = np.maximum(1.0 - (size / 6.0) ** 2, 0.0) ** 2
    return weights


def _solve(
    slope: NDArray[np.float64],
    target: NDArray[np.float64],
    place: tuple[NDArray[np.int64], NDArray[np.float64]],
    weight: NDArray[np.float64],
    lift: NDArray[np.float64],
    knots: int,
) -> NDArray[np.float64]:
    """Weighted least squares with the aircraft's prior: (knots, 3) float64 [m].

    ``place``: the knot before each line, and how far towards the next one the line lies. ``lift``:
    what the squares gain in slope where they shrink with the height.
    """
    knot, share = place
    band = np.zeros((_HALF_BAND + 1, 3 * knots))
    right = np.zeros(3 * knots)
    hats = (1.0 - share, share)
    one = np.ones(len(share))
    # Rows of the design: X - b_x Z = target_x, and in y.
    rows = (((0, one), (2, -slope[:, 0])), ((1, one), (2, -slope[:, 1])))
    for axis, row in enumerate(rows):
        for i, hat in enumerate(hats):
            for p, u in row:
                at = 3 * (knot + i) + p
                right += np.bincount(at, weight * hat * u * target[:, axis], 3 * knots)
                for j, other in enumerate(hats):
                    for q, v in row:
                        offset = 3 * (j - i) + q - p
                        if offset >= 0:
                            # Lower bands of a symmetric matrix: elements (at + offset, at).
                            product = weight * hat * u * other * v
                            band[offset] += np.bincount(at, product, 3 * knots)
    for i, hat in enumerate(hats):
        right += np.bincount(3 * (knot + i) + 2, hat * lift, 3 * knots)
    _prior(band, right, knots)
    solved: NDArray[np.float64] = solveh_banded(band, right, lower=True).reshape(knots, 3)
    return solved


def _prior(band: NDArray[np.float64], right: NDArray[np.float64], knots: int) -> None:
    """What holds for any aircraft; it decides only where no line does."""
    for axis in range(3):
        place = 3 * np.arange(knots) + axis
        band[0, place] += ABOVE_M**-2
        for coefficients, precision in (
            ((-1.0, 1.0), SPEED_M_S**-2),
            ((1.0, -2.0, 1.0), ACCELERATION_M_S2**-2),
        ):
            count = knots - len(coefficients) + 1
            for i, a in enumerate(coefficients):
                for j, b in enumerate(coefficients[i:], start=i):
                    band[3 * (j - i), place[i : i + max(count, 0)]] += precision * a * b
    right[2::3] += 1.0 / ABOVE_M
