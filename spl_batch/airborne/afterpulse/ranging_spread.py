"""Ranging spread of a flightline, from the planes that its shots see.

Domain: time. Returns on a hard plane spread by the ranging noise alone, on other planes by more:
the least spread of planes tells it. The sensor's own figure counts as :data:`PRIOR` planes.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.afterpulse.lag_counts import SPREAD_STEP_M
from spl_batch.airborne.sensors.sensor import Sensor

DOMAIN: Final = "time"

PRIOR: Final = 15.0
"""Planes that the sensor's own figure is worth [count]: fewer than 60 in all change nothing, as a
few planes of shrubs look alike."""

QUANTILE: Final = 0.2
"""Quantile of the planes' spreads: in any survey with planes a fifth of them is hard."""

CHANCE: Final = 1.15
"""Spread of hard planes over that quantile, as some twenty returns of a plane tell it."""

BELIEVED: Final = 1.3
"""Factor to the sensor's spread below which a larger one is roughness of the ground."""


def ranging_spread(planes: NDArray[np.int64], sensor: Sensor) -> float:
    """One standard deviation of ranges, never less than the sensor's [m].

    Parameters
    ----------
    planes : (s,) int64
        Planes by their spread, in steps of
        :data:`~spl_batch.airborne.afterpulse.lag_counts.SPREAD_STEP_M` [count].
    """
    stated = sensor.range_sigma_m
    counts = planes.astype(np.float64)
    counts[min(int(stated / CHANCE / SPREAD_STEP_M), len(counts) - 1)] += PRIOR
    before = np.insert(np.cumsum(counts), 0, 0.0) / counts.sum()
    edges = np.arange(len(counts) + 1) * SPREAD_STEP_M
    found = CHANCE * float(np.interp(QUANTILE, before, edges))
    return found if found > BELIEVED * stated else stated
