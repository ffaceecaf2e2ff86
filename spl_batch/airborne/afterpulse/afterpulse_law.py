r"""How many afterpulses follow a detection, and how far behind it, flightline by flightline.

Domain: time. [W17] 7.5 finds 10-20 afterpulses for 80-100 signal returns of a shot, in a band of
2-3 m; a law is not given there. Here a detection starts an afterpulse with probability
:math:`p`, at a lag with density

.. math:: f(l) = \frac{e^{-(l - d) / s}}{s\,(1 - e^{-(L - d) / s})}, \quad d \le l \le L,

:math:`d` the dead time as range, :math:`L` the sensor's longest lag; the simulator draws from the
same law. p and s are fitted. Only shots of one hard plane and nothing else tell them: whatever
follows a return there can be an afterpulse only, or background, whose rate is known. One shot in
:data:`EVERY` is enough.
The sensor's own p and s count as :data:`PRIOR` afterpulses that were seen, so a flightline
without hard surfaces has those of its sensor.
"""

import math
from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.afterpulse.hard_surfaces import Rules
from spl_batch.airborne.afterpulse.lag_counts import observe_lags, rate_behind
from spl_batch.airborne.beams.shot_runs import lag_behind, offsets, run_starts
from spl_batch.airborne.sensors.sensor import Sensor
from spl_batch.constants import QUANTUM_M
from spl_batch.lattice.tables import BeamTable, PointTable, rows_of

DOMAIN: Final = "time"

BIN_M: Final = 0.05
"""Bins of the observed lags [m]."""

EVERY: Final = 4
"""One shot in so many is observed; by shot number, so that no cut matters."""

PRIOR: Final = 100.0
"""Afterpulses that the sensor's own figures are worth [count]."""

SCALE_M: Final = (0.05, 5.0)
"""Shortest and longest scale that is believed [m]."""


class AfterpulseLaw(NamedTuple):
    """Afterpulses of a flightline.

    Parameters
    ----------
    probability : float
        Afterpulses per detection.
    scale_m : float
        Scale of the exponential lag behind the dead time [m].
    dead_m, longest_m : float
        Dead time as range, and the longest lag [m].
    sigma_m : float
        Ranging spread [m].
    """

    probability: float
    scale_m: float
    dead_m: float
    longest_m: float
    sigma_m: float

    @property
    def least_m(self) -> float:
        """Shortest lag that can be measured: both returns carry the ranging spread [m]."""
        return max(self.dead_m - 5.0 * self.sigma_m, 1e-3)


def sensor_law(sensor: Sensor) -> AfterpulseLaw:
    """The law that the sensor's facts give."""
    return AfterpulseLaw(
        sensor.afterpulse_probability, sensor.afterpulse_scale_m, sensor.dead_m,
        sensor.afterpulse_lag_max_m, sensor.range_sigma_m,
    )  # fmt: skip


def observe(
    table: PointTable, beams: BeamTable, rules: Rules, least_m: float
) -> dict[str, NDArray[np.int64]]:
    """Lags behind hard surfaces in one stretch; parts of a flightline add up.

    Parameters
    ----------
    table : PointTable
        Rows of one stretch, sorted by (gps_time, channel, ...), with ``shot``.
    beams : BeamTable
        Their beams; rows without a known one take no part.
    rules : Rules
        What a hard surface is.
    least_m : float
        Shortest lag [m].

    Returns
    -------
    dict
        ``afterpulse_parents`` (1,) and ``afterpulse_lags`` (b,) int64 [count], in bins of
        :data:`BIN_M` up to the longest lag.
    """
    lags = _no_lags(rules.longest_m)
    rows = np.flatnonzero(beams.known & (table["shot"] % EVERY == 0))
    parents = 0
    if len(rows):
        time, channel = table["gps_time"][rows], table["channel"][rows]
        range_m = beams.range_m[rows]
        shots = run_starts(time)
        lag = np.empty(len(rows), dtype=np.float32)
        lag_behind(run_starts(time, channel), range_m, least_m, rules.longest_m, lag)
        parents = observe_lags(
            shots, np.flatnonzero(_several(channel, shots)), shot_offsets(table.take(rows), shots),
            beams.direction.take(rows, axis=0), range_m, channel, lag, rules, BIN_M, lags,
        )  # fmt: skip
    return {"afterpulse_parents": np.array([parents], np.int64), "afterpulse_lags": lags}


def shot_offsets(table: PointTable, shots: NDArray[np.int64]) -> NDArray[np.float64]:
    """Points relative to the first one of their shot: (n, 3) float64 [m]."""
    offset = np.empty((len(table), 3))
    offsets(shots, (table["x"], table["y"], table["z"]), QUANTUM_M, offset)
    return offset


def _no_lags(longest_m: float) -> NDArray[np.int64]:
    """Counts of lags up to a longest one, before any is seen."""
    return np.zeros(math.ceil(longest_m / BIN_M - 1e-9), dtype=np.int64)


def _several(channel: NDArray[np.uint8], shots: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Shots that know channels: without them, who follows whom is not known."""
    low = np.minimum.reduceat(channel, shots[:-1])
    several: NDArray[np.bool_] = np.maximum.reduceat(channel, shots[:-1]) > low
    return several


def fit(
    parts: Sequence[dict[str, NDArray[Any]]], noise_per_m: float, sensor: Sensor
) -> AfterpulseLaw:
    """Law of a flightline.

    Parameters
    ----------
    parts : sequence of dict
        Results of :func:`observe`, in any order.
    noise_per_m : float
        Background per metre of beamlet, which follows a return as well [1/m].
    sensor : Sensor
        Dead time, and what is expected beforehand.
    """
    prior = sensor_law(sensor)
    parents = sum(int(p["afterpulse_parents"][0]) for p in parts)
    lags = sum((p["afterpulse_lags"] for p in parts), _no_lags(prior.longest_m))
    middle = (np.arange(len(lags)) + 0.5) * BIN_M
    late = middle > prior.dead_m
    count = lags.sum() - noise_per_m * BIN_M * parents * np.count_nonzero(late)
    excess = np.dot(lags, middle) - noise_per_m * BIN_M * parents * middle[late].sum()
    count = max(float(count), 0.0)
    excess = max(float(excess) - count * prior.dead_m, 0.0)
    window = prior.longest_m - prior.dead_m
    total = count + PRIOR
    mean = (excess + PRIOR * truncated_mean(prior.scale_m, window)) / total
    probability = total / (parents + PRIOR / max(prior.probability, 1e-6))
    return prior._replace(probability=min(probability, 0.95), scale_m=scale_of_mean(mean, window))


def truncated_mean(scale_m: float, window_m: float) -> float:
    """Mean of an exponential lag that does not pass a window [m]."""
    return float(scale_m - window_m / np.expm1(window_m / scale_m))


def scale_of_mean(mean_m: float, window_m: float) -> float:
    """Scale whose :func:`truncated_mean` this is, by bisection [m]."""
    low, high = SCALE_M
    for _ in range(60):
        middle = 0.5 * (low + high)
        if truncated_mean(middle, window_m) < mean_m:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)


def rate(table: PointTable, beams: BeamTable, law: AfterpulseLaw) -> NDArray[np.float32]:
    """Afterpulses per metre of beamlet expected at each return.

    Parameters
    ----------
    table : PointTable
        Rows of one stretch, sorted by (gps_time, channel, ...).
    beams : BeamTable
        Their beams; rows without a known beam get 0.
    law : AfterpulseLaw
        Of the flightline.

    Returns
    -------
    (n,) float32
        [1/m]; 0 where no return of the beamlet is in front, or channels are not known.
    """
    out = np.zeros(len(table), dtype=np.float32)
    if not beams.known.any():
        return out
    rows = rows_of(beams.known)
    time, channel = table["gps_time"][rows], table["channel"][rows]
    found = np.empty(len(time), dtype=np.float32)
    rate_behind(
        run_starts(time, channel), beams.range_m[rows], law.least_m, law.longest_m, law.dead_m,
        law.probability, law.scale_m, found,
    )  # fmt: skip
    shots = run_starts(time)
    found[~np.repeat(_several(channel, shots), np.diff(shots))] = 0.0
    out[rows] = found
    return out
