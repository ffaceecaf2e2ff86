"""Whether clouds without beamlet numbers are linear-mode lidar, which has no noise to be filtered.

A pulse of linear-mode lidar is one beam, of which few returns share a time. A shot of a
single-photon lidar has a return of many a beamlet.
"""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.errors import grouped
from spl_batch.formats.gps_clock import usable_times
from spl_batch.formats.las.reader import LasFacts

SPARSE_M2: Final = 2.0
"""Density in its box below which a cloud is taken for linear-mode lidar: single-photon surveys have
ten times as many points and more, noise included [1/m2]."""

RETURNS_A_SHOT: Final = 5.0
"""Points that share a time, on average, from which on they are those of many beamlets [count]."""

IN_ORDER: Final = 0.9
"""Share of points that are no earlier than the point before, from which on the points of a shot lie
together; points in order of their place do not tell how many a shot has."""


@dataclass
class Density:
    """How dense clouds are, in their boxes and in time."""

    points: int = 0  #: Points of all clouds.
    area_m2: float = 0.0  #: Area of their boxes.
    timed: int = 0  #: Points that were looked at, of clouds in order of time.
    shots: int = 0  #: Different times of these.

    def add(self, facts: LasFacts, gps_time: NDArray[Any]) -> None:
        """Add a cloud.

        Parameters
        ----------
        facts : LasFacts
            Its header.
        gps_time : (n,) float64
            Times of some of its points, in their order [s].
        """
        self.points += facts.n_points
        self.area_m2 += facts.area_m2
        time = gps_time[usable_times(gps_time)]
        if len(time) > 1 and np.mean(np.diff(time) >= 0) >= IN_ORDER:
            self.timed += len(time)
            self.shots += len(np.unique(time))

    @property
    def signs(self) -> str:
        """What speaks for linear-mode lidar, in words; empty where nothing does."""
        found = []
        if self.area_m2 >= 1.0 and self.points / self.area_m2 < SPARSE_M2:
            found.append("few points per m2")
        if self.shots and self.timed / self.shots < RETURNS_A_SHOT:
            found.append(f"only {grouped(self.timed / self.shots, 1)} points at the same gps_time")
        return ", ".join(["no beamlet numbers", *found]) if found else ""
