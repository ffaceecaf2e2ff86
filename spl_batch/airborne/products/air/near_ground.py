"""Returns that fill the air just above the ground everywhere, as fog does.

Domain: space. Fog has enough neighbours to pass any test of noise, and its top becomes the surface.
A place of :data:`SQUARE_M` is *filled* in a step of height where many more returns than noise
explains lie evenly over its cells of 1 m. Bushes, trees and walls leave gaps; roads and roofs have
nothing there. If most places are filled it is fog, or low vegetation without a gap. It is told, and
nothing is removed. Our own rule: no source has one.
"""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from spl_batch.airborne.products.air.place_kernels import below, heights, in_places
from spl_batch.constants import NODATA, NOISE_SIGNAL
from spl_batch.lattice.tables import PointTable
from spl_batch.lattice.tiles import Bounds, quanta

DOMAIN: Final = "space"

COLUMNS_NEEDED: Final = ("x", "y", "z", "noise_class")

SQUARE_M: Final = 10.0
"""Edge of a place [m]."""

CELL_M: Final = 1.0
"""Edge of its cells [m]."""

FLOOR_M: Final = 0.75
"""Lower end of the first step: above what the DTM's errors and ranging noise lift off the ground
[m]."""

STEP_M: Final = 1.0
STEPS: Final = 8
"""Height and number of the steps."""

HALF_M: Final = 0.5
"""Height by which points are sorted [m]."""

TIMES_NOISE: Final = 4.0
LEAST: Final = 10.0
"""A filled place holds so many times the noise, and so many returns more."""

LOW_STEPS: Final = 2
LOW_PER_M3: Final = 0.5
"""Steps that mist in patches fills, higher than most crops, and returns enough to show clumps
[count, 1/m3]."""

UNEVEN: Final = 0.5
"""Largest variance of the cells' counts beyond chance, over their squared mean."""


Index = NDArray[np.int64]


class Placed(NamedTuple):
    """Points over places: those that lie in whole ones, afterpulses left out."""

    shape: tuple[int, int]  #: Rows and columns of places, from the south-west [count].
    place: NDArray[np.int64]  #: (n,): number of each point's place, row by row.
    within: NDArray[np.int64]  #: (n,): number of its cell within the place.
    #: (n,): half metres above the floor, rounded down; NaN where the DTM is void.
    half_metre: NDArray[np.float64]
    #: (n,): the same above the lowest ground of its place.
    level: NDArray[np.float64]
    z: NDArray[np.int32]  #: (n,): heights [quanta].
    kept: NDArray[np.bool_]  #: (n,): whether it is signal.
    grounded: NDArray[np.bool_]  #: (places,): whether points lie on the DTM there.


def highest_ground(dtm: NDArray[np.float32]) -> NDArray[np.float32]:
    """Highest ground of the DTM's cells, NaN where it is void [m].

    On a slope a cell rises to half-way towards the highest cell beside it: bare ground of 60
    degrees would fill the air above the middle of its cells.

    Parameters
    ----------
    dtm : (rows, cols) float32
        DTM of a whole ground cell [m]: a part of it does not know the cells beside its edge.
    """
    top = (dtm + ndimage.maximum_filter(dtm, 3)) / np.float32(2.0)
    return np.where(dtm == np.float32(NODATA), np.float32(np.nan), top)


def placed(table: PointTable, core: Bounds, highest: NDArray[np.float32]) -> Placed | None:
    """Places of points, and their heights above the ground; None where no place is whole.

    Parameters
    ----------
    table : PointTable
        Points of a ground cell or a part of it, :data:`COLUMNS_NEEDED`.
    core : Bounds
        The cell or part; squares of the absolute grid that lie in it are places [quanta].
    highest : (rows, cols) float32
        Its part of :func:`highest_ground`, north up [m].
    """
    edge, cell = quanta(SQUARE_M), quanta(CELL_M)
    west, south = -(-core.xmin // edge), -(-core.ymin // edge)
    columns, rows = core.xmax // edge - west, core.ymax // edge - south
    if columns < 1 or rows < 1:
        return None
    frame = (west * edge, south * edge, int(columns), int(rows))
    kind = table["noise_class"]
    chosen, place, within = in_places(table["x"], table["y"], kind, frame, edge, cell)
    size = (core.xmax - core.xmin) // highest.shape[1]
    surface = below(table["x"], table["y"], chosen, (core.xmin, core.ymin), size, highest)
    z, kept = table["z"][chosen], kind[chosen] == NOISE_SIGNAL
    half_metre, level, grounded = heights(
        z, surface, place, int(rows * columns), FLOOR_M, HALF_M
    )  # fmt: skip
    return Placed((int(rows), int(columns)), place, within, half_metre, level, z, kept, grounded)


def low_places(points: Placed, noise_m3: float) -> NDArray[np.bool_]:
    """Places that returns fill evenly in the first :data:`LOW_STEPS` steps above the ground.

    Parameters
    ----------
    points : Placed
        Points over places.
    noise_m3 : float
        Expected noise [1/m3].

    Returns
    -------
    (rows, columns) bool
        From the south-west.
    """
    full = points.grounded.copy()
    least = SQUARE_M**2 * STEP_M * max(LOW_PER_M3, TIMES_NOISE * noise_m3)
    for count in _by_cell(points, LOW_STEPS):
        mean = count.mean(axis=1)
        full &= count.sum(axis=1) >= least
        full &= count.var(axis=1) - mean <= UNEVEN * mean**2
    return full.reshape(points.shape)


def _by_cell(points: Placed, steps: int) -> NDArray[np.int64]:
    """Returns by step, place and cell: (steps, places, cells)."""
    places, parts = len(points.grounded), quanta(SQUARE_M) // quanta(CELL_M)
    half = round(STEP_M / HALF_M)
    inside = (points.half_metre >= 0) & (points.half_metre < half * steps)
    step = points.half_metre[inside].astype(np.int64) // half
    number = (step * places + points.place[inside]) * parts**2 + points.within[inside]
    size = steps * places * parts**2
    return np.bincount(number, minlength=size).reshape(steps, places, parts**2)


def filled_places(points: Placed | None, noise_m3: float) -> list[int]:
    """How many places there are with ground, and how many of them are filled, step by step.

    Parameters
    ----------
    points : Placed, optional
        Points over places, by :func:`placed`.
    noise_m3 : float
        Expected noise [1/m3].

    Returns
    -------
    list of int
        Places [count], then those filled from the ground up to each of the :data:`STEPS`: a crown
        above a gap is no fog.
    """
    if points is None:
        return [0] * (STEPS + 1)
    full = points.grounded
    out = [int(np.count_nonzero(full))]
    for count in _by_cell(points, STEPS):
        mean = count.mean(axis=1)
        excess = count.var(axis=1) - mean
        noise = noise_m3 * SQUARE_M**2 * STEP_M
        full = full & (count.sum(axis=1) >= TIMES_NOISE * noise + LEAST)
        full &= excess <= UNEVEN * mean**2
        out.append(int(np.count_nonzero(full)))
    return out
