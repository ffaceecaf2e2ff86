"""Bloom: one bright point that lights the whole array, so that many channels see it at its range.

Domain: time. The returns of a retro-reflector lie on a sphere around the sensor, as wide as the
array, and look like a surface. In a shot of bloom

- *many channels have one range*: within the ranging spread, wherever they point. On level ground
  beams lean, and ranges spread over the array;
- *light goes on*: many of these channels see the true surface close behind. Behind ground and roofs
  there are only afterpulses, which are fewer. Returns in front may be leaves and say nothing;
- *shots around do not*: a point lights a few shots, a surface square to the beam many on end.

A small bright surface square to the beam that lets light pass has all of it. So these returns are
counted and told; they become noise only where the settings ask for it. What follows them is the
ground, so no law of afterpulses is taken from such shots. No source has a rule for it.
"""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.beams.bloom_shots import PASSED, one_range
from spl_batch.airborne.beams.shot_runs import run_starts
from spl_batch.airborne.beams.told_apart import told_apart
from spl_batch.airborne.sensors.sensor import Sensor
from spl_batch.lattice.tables import BeamTable, PointTable

DOMAIN: Final = "time"

WINDOW: Final = 6.0
"""Ranges that are one [ranging spreads]."""

SPREAD: Final = 1.3
"""Their largest standard deviation [ranging spreads]: leaves that fill the window have 1.7."""

FILLED: Final = 0.3
"""Least part of the sensor's channels with a return there: 0.36 photo-electrons in each."""

BEHIND_M: Final = 12.0
"""How far behind another return is looked for [m]."""

LEAST: Final = 20
"""Channels from which an array can tell [count]."""

SURFACE: Final = 0.25
"""Part of an interval's shots, each with one range, from which on they see a surface."""


class Bloom(NamedTuple):
    """Returns of bloom."""

    returns: NDArray[np.bool_]  #: (n,): which returns.
    of_shots: NDArray[np.bool_]  #: (n,): which returns are of their shots, at any range.
    shots: int  #: How many shots they are of [count].


def find_bloom(
    table: PointTable, beams: BeamTable, starts: NDArray[np.int64], channels: int,
    sigma_m: float, interval_shots: int,
) -> Bloom:  # fmt: skip
    """Returns of light that reached the whole array.

    Parameters
    ----------
    table : PointTable
        Points in time order, with ``channel`` and ``shot``.
    starts : (s + 1,) int64
        Where each shot begins, and the end.
    channels : int
        Channels of the sensor, not of these shots: a shot is judged alike in any company [count].
    sigma_m : float
        Ranging spread, one sigma [m].
    interval_shots : int
        Shots of an interval, which is never cut: only those say what the shots around see [count].
    """
    none = np.zeros(len(table), np.bool_)
    if channels < LEAST or len(starts) < 2:
        return Bloom(none, none, 0)
    width = WINDOW * sigma_m
    low, seen = np.zeros(len(starts) - 1), np.zeros(len(starts) - 1, np.uint8)
    rules = FILLED * channels, width, SPREAD * sigma_m, BEHIND_M
    one_range(starts, table["channel"], beams.range_m, rules, low, seen)
    if not (seen == PASSED).any():
        return Bloom(none, none, 0)
    _, interval = np.unique(table["shot"][starts[:-1]] // interval_shots, return_inverse=True)
    alike = np.bincount(interval.reshape(-1), seen > 0)[interval.reshape(-1)]
    found = (seen == PASSED) & (alike < max(SURFACE * interval_shots, 2.0))
    counts = np.diff(starts)
    of_shots = np.repeat(found, counts)
    behind_m = beams.range_m - np.repeat(low, counts)
    return Bloom(of_shots & (behind_m >= 0) & (behind_m <= width), of_shots, int(found.sum()))


def find_unnumbered(
    table: PointTable, beams: BeamTable, sensor: Sensor, sigma_m: float, interval_shots: int
) -> Bloom:
    """Returns as of :func:`find_bloom` of files that do not number beamlets: beams tell them apart.

    Parameters
    ----------
    table : PointTable
        Points in time order, with ``shot``.
    """
    seen, order = told_apart(table, beams, sensor)
    starts, ordered = run_starts(seen["gps_time"]), beams.take(order)
    found = find_bloom(seen, ordered, starts, sensor.beamlets, sigma_m, interval_shots)
    returns, of_shots = np.zeros((2, len(table)), np.bool_)
    returns[order], of_shots[order] = found.returns, found.of_shots
    return Bloom(returns, of_shots, found.shots)
