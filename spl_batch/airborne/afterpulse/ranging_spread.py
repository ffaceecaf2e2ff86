"""Ranging spread of a flightline, from the planes that its shots see.

Domain: time. Returns on a hard plane spread by the ranging noise alone, on other planes by more:
the least spread of planes tells it. The sensor's own figure counts as :data:`PRIOR` planes. Heath
and meadows have no hard plane: then even the least spreads are unlike, and the sensor's own stands.
"""

from typing import Any, Final

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

LOW: Final = 0.1
ALIKE: Final = 0.7
"""Spreads of hard planes are alike: of those up to :data:`QUANTILE` no larger share is smaller than
the largest times this. As twenty returns tell it, that is 0.78 on the level and 0.72 on mountains;
on real heath it is 0.35 to 0.66."""


def ranging_spread(planes: NDArray[np.int64], sensor: Sensor) -> float:
    """One standard deviation of ranges, never less than the sensor's [m].

    Parameters
    ----------
    planes : (s,) int64
        Planes by their spread, in steps of
        :data:`~spl_batch.airborne.afterpulse.lag_counts.SPREAD_STEP_M` [count].
    """
    stated = sensor.range_sigma_m
    if not _alike(planes):
        return stated
    counts = planes.astype(np.float64)
    counts[min(int(stated / CHANCE / SPREAD_STEP_M), len(counts) - 1)] += PRIOR
    found = CHANCE * _quantile(counts, QUANTILE)
    return found if found > BELIEVED * stated else stated


def _alike(planes: NDArray[np.int64]) -> bool:
    """Whether the least spreads are those of hard planes."""
    if not planes.any():
        return False
    least, most = (_quantile(planes, share) for share in (LOW * QUANTILE, QUANTILE))
    return least >= ALIKE * most


def _quantile(planes: NDArray[Any], share: float) -> float:
    """Spread below which a share of planes lies [m]."""
    before = np.insert(np.cumsum(planes), 0, 0.0) / planes.sum()
    edges = np.arange(len(planes) + 1) * SPREAD_STEP_M
    return float(np.interp(share, before, edges))
