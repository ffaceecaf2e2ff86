"""Smooth surface repeatability: by how much the heights of one flightline differ on what is smooth.

Source: USGS Lidar Base Specification, Data Processing and Handling, Relative Vertical Accuracy,
Intraswath Precision; the same is "within-swath smooth-surface precision" of the ASPRS standards of
2023, section 7.14. On smooth hard places of 50 m2 or more each cell has

    Dz = range of its heights - slope x edge x sqrt(2),

never below zero; cells have an edge of twice the nominal spacing, rounded up to whole metres
first. RMSDz is the root mean square over all cells.

Deviations: nobody draws the places. They are squares of :data:`SQUARE_M` of an absolute grid with
returns of one flightline in all of their cells, level to 10 degrees. Which of them are smooth is
decided later, when the thickness of all is known: their heights are added up by thickness here. The
slope is that of the square's plane by least squares, not of the lowest returns of nine cells.
"""

from collections.abc import Iterator, Mapping
from types import MappingProxyType
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.constants import QUANTUM_M
from spl_batch.lattice.tiles import Bounds, inside, quanta

SQUARE_M: Final = 8.0
"""Edge of a place [m]."""

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

AT_ONCE: Final = 1 << 18
"""Returns of columns of places that are looked at together, about [count]."""

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


def smooth_sums(first: NDArray[np.int64], line: NDArray[np.int64], core: Bounds) -> dict[str, Sums]:
    """Level places of a region, by spacing and thickness; sums of several regions add up.

    Parameters
    ----------
    first : (n, 3) int64
        First signal returns in the region and around it, in any order [quanta].
    line : (n,) int64
        Flightline of each.
    core : Bounds
        The region: places that lie in it as a whole count [quanta].
    """
    sums = {name: np.zeros((STEPS, 3), np.int64) for name in CELLS}
    for part in slabs(first[:, 0], core):
        mine = inside(first[:, 0], first[:, 1], part)
        for name, found in _sums(first[mine], line[mine], part).items():
            sums[name] += found
    return sums


def slabs(x: NDArray[np.int64], core: Bounds) -> Iterator[Bounds]:
    """Whole columns of places of a region, so many that they hold about :data:`AT_ONCE` returns."""
    square = quanta(SQUARE_M)
    west, south = -(-core.xmin // square), -(-core.ymin // square)
    columns, rows = core.xmax // square - west, core.ymax // square - south
    if columns < 1 or rows < 1:
        return
    whole = Bounds(*(k * square for k in (west, south, west + columns, south + rows)))
    known = x[(x >= whole.xmin) & (x < whole.xmax)]
    held = np.bincount((known - whole.xmin) // square)
    west, count = whole.xmin, 0
    for column, more in enumerate(held.tolist()):
        east = whole.xmin + column * square
        if count and count + more > AT_ONCE:
            yield whole._replace(xmin=west, xmax=east)
            west, count = east, 0
        count += more
    yield whole._replace(xmin=west)


def _sums(xyz: NDArray[np.int64], line: NDArray[np.int64], whole: Bounds) -> dict[str, Sums]:
    """What :func:`smooth_sums` finds in whole places, of the returns in them alone."""
    square, edge = quanta(SQUARE_M), quanta(EDGE_M)
    columns, rows = (whole.xmax - whole.xmin) // square, (whole.ymax - whole.ymin) // square
    line = np.unique(line, return_inverse=True)[1]
    parts = square // edge
    at = (line * rows + (xyz[:, 1] - whole.ymin) // square) * columns
    at += (xyz[:, 0] - whole.xmin) // square
    # Only places with enough returns for all of their cells can count, and there are few of these.
    enough, place = _held_by(at, FEWEST * parts**2)
    if not len(place):
        return {name: np.zeros((STEPS, 3), np.int64) for name in CELLS}
    xyz = xyz[enough]
    # Heights above the lowest return of their place: what lies elsewhere changes no rounding.
    low = np.full(int(place.max()) + 1, int(xyz[:, 2].max()))
    np.minimum.at(low, place, xyz[:, 2])
    x, y, z = xyz[:, 0] - whole.xmin, xyz[:, 1] - whole.ymin, xyz[:, 2] - low[place]
    number = (place * parts + y % square // edge) * parts + x % square // edge
    shape = (int(place.max()) + 1, parts, parts)
    highest, lowest = np.full(np.prod(shape), -1), np.full(np.prod(shape), int(z.max()) + 1)
    np.maximum.at(highest, number, z)
    np.minimum.at(lowest, number, z)
    count = np.bincount(number, minlength=len(highest)).reshape(shape)
    east, north, thickness = planes(x % square, y % square, z, place, shape[0])
    slope = np.hypot(east, north)
    step = np.floor(thickness / quanta(STEP_M))
    good = (slope <= LEVEL) & (step < STEPS) & (count.min(axis=(1, 2)) >= FEWEST)
    heights = _Heights(highest.reshape(shape)[good], lowest.reshape(shape)[good], slope[good])
    return {
        name: _by_thickness(heights, times, step[good].astype(np.int64))
        for name, times in CELLS.items()
    }


def _held_by(at: NDArray[np.int64], fewest: int) -> tuple[NDArray[np.bool_], NDArray[np.intp]]:
    """Returns whose place holds at least so many, and the numbers of their places from 0."""
    if at.max(initial=0) > len(at):  # flightlines beyond number must not need memory for squares
        at = np.unique(at, return_inverse=True)[1]
    full = np.bincount(at) >= fewest
    enough: NDArray[np.bool_] = full[at]
    number: NDArray[np.intp] = np.cumsum(full) - 1
    return enough, number[at[enough]]


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


def planes(
    x: NDArray[np.int64],
    y: NDArray[np.int64],
    z: NDArray[np.int64],
    place: NDArray[np.intp],
    places: int,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Slopes to the east and north [rise/run], and standard deviation [quanta], by place.

    Moments are sums of whole numbers below 2**53, exact in any order.
    """

    def added(values: NDArray[np.int64]) -> NDArray[np.float64]:
        return np.bincount(place, weights=values, minlength=places).astype(np.float64)

    n, sx, sy, sz = np.maximum(added(np.ones_like(x)), 1), added(x), added(y), added(z)
    xx, xy, yy = (added(a * b) - s for a, b, s in
                  ((x, x, sx * sx / n), (x, y, sx * sy / n), (y, y, sy * sy / n)))  # fmt: skip
    xz, yz, zz = (added(a * b) - s for a, b, s in
                  ((x, z, sx * sz / n), (y, z, sy * sz / n), (z, z, sz * sz / n)))  # fmt: skip
    with np.errstate(divide="ignore", invalid="ignore"):
        determinant = xx * yy - xy * xy
        east, north = (yy * xz - xy * yz) / determinant, (xx * yz - xy * xz) / determinant
        spread = np.sqrt(np.maximum(zz - east * xz - north * yz, 0.0) / (n - 3))
    lost = ~(determinant > 0) | (n <= 3)
    east, north, spread = (np.where(lost, np.inf, values) for values in (east, north, spread))
    return east, north, spread


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
