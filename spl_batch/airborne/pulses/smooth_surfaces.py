"""Smooth surface repeatability: by how much the heights of one flightline differ on what is smooth.

Source: USGS Lidar Base Specification, Data Processing and Handling, Relative Vertical Accuracy,
Intraswath Precision; the same is "within-swath smooth-surface precision" of the ASPRS standards of
2023, section 7.14. On smooth hard places of 50 m2 or more each cell has

    Dz = range of its heights - slope x edge x sqrt(2),

never below zero; cells have an edge of twice the nominal spacing, rounded up to whole metres
first. RMSDz is the root mean square over all cells.

Deviations: nobody draws the places. They are squares of an absolute grid with
returns of one flightline in all of their cells, level to 10 degrees. Which of them are smooth is
decided later, when the thickness of all is known: their heights are added up by thickness here. The
slope is that of the square's plane by least squares, not of the lowest returns of nine cells.
"""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.pulses.level_places import SQUARE_M, Places
from spl_batch.airborne.pulses.place_sums import spans
from spl_batch.constants import QUANTUM_M
from spl_batch.lattice.tiles import quanta

EDGE_M: Final = 2.0
"""Edge of a cell where the spacing is 0.35 or 0.71 m: twice a whole metre [m]."""

CELLS: Final[Mapping[str, int]] = MappingProxyType({"QL1": 1, "QL2": 1, "QL3": 2})
"""Edge of a cell by nominal spacing: 1.41 m are 2 whole metres [:data:`EDGE_M`]."""

LEVEL: Final = 0.176
"""Slope of a place, at most: 10 degrees [rise/run]."""

STEP_M: Final = 0.005
THICKEST_M: Final = 0.25
"""Places are told apart by steps of their standard deviation about a plane, up to this [m]."""

STEPS: Final = round(THICKEST_M / STEP_M)

FEWEST: Final = 3
"""Returns of a flightline in each cell, at least [count]."""

QUARTER: Final = 0.25
"""Share of the places that are taken for hard: the thickest of these is the ranging noise."""

TWICE: Final = 2.0
"""A place thicker than this times the noise is overgrown."""

Sums = NDArray[np.int64]
"""By thickness: places, cells [count], and the sum of their squared differences [quanta2]:
(:data:`STEPS`, 3)."""


class Repeatability(NamedTuple):
    """What the smooth places of a survey tell."""

    rmsd_m: float
    #: Smooth places, and their cells [count].
    places: int
    cells: int
    noise_m: float  #: Standard deviation about the planes of the smoothest quarter, at most [m].


def smooth_sums(places: Places) -> dict[str, Sums]:
    """Level places by spacing and thickness; sums of several regions add up.

    ``places``: from :func:`~spl_batch.airborne.pulses.level_places.places_in`.
    """
    slope, edge, parts = places.slope, quanta(EDGE_M), quanta(SQUARE_M) // quanta(EDGE_M)
    step = np.floor(places.thickness / quanta(STEP_M))
    shape = (len(slope), parts, parts)
    highest, lowest = np.full(shape, -1), np.full(shape, np.iinfo(np.int64).max)
    count = np.zeros(shape, np.int64)
    spans(places.offset, places.place, edge, highest, lowest, count)
    good = (slope <= LEVEL) & (step < STEPS) & (count.min(axis=(1, 2)) >= FEWEST)
    heights = _Heights(highest[good], lowest[good], slope[good])
    return {
        name: _by_thickness(heights, times, step[good].astype(np.int64))
        for name, times in CELLS.items()
    }


class _Heights(NamedTuple):
    """Highest and lowest return of each cell of a place [quanta], and the place's slope."""

    highest: NDArray[np.int64]
    lowest: NDArray[np.int64]
    slope: NDArray[np.float64]


def _by_thickness(heights: _Heights, times: int, step: NDArray[np.int64]) -> Sums:
    """Sums of places whose cells have so many times the smallest edge.

    They are of whole numbers: no order of places matters.
    """
    places, parts, _ = heights.highest.shape
    joined = (places, parts // times, times, parts // times, times)
    span = heights.highest.reshape(joined).max(axis=(2, 4))
    span -= heights.lowest.reshape(joined).min(axis=(2, 4))
    climb = np.rint(heights.slope * times * quanta(EDGE_M) * np.sqrt(2.0)).astype(np.int64)
    squared = np.maximum(span - climb[:, None, None], 0) ** 2
    sums = np.zeros((STEPS, 3), np.int64)
    np.add.at(sums[:, 0], step, 1)
    np.add.at(sums[:, 1], step, span[0].size if places else 0)
    np.add.at(sums[:, 2], step, squared.sum(axis=(1, 2)))
    return sums


def repeatability(sums: NDArray[Any]) -> Repeatability | None:
    """What the smooth places tell; None where there are none.

    ``sums``: (STEPS, 3) int64, of all regions together.
    """
    places = sums[:, 0].cumsum()
    if not places[-1]:
        return None
    noise_m = STEP_M * (1 + int(np.searchsorted(places, QUARTER * places[-1])))
    smooth = sums[: min(round(TWICE * noise_m / STEP_M), STEPS)].sum(axis=0)
    rmsd_m = float(np.sqrt(smooth[2] / smooth[1])) * QUANTUM_M
    return Repeatability(rmsd_m, int(smooth[0]), int(smooth[1]), noise_m)
