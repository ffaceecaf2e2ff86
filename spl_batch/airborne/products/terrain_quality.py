"""Standard deviation of the terrain: how well each cell of the DTM is known.

A DTM is interpolated between cells that hold ground returns. Its error in other cells follows from
two things that the ground itself tells: how far the nearest ground is, and how much heights here
differ from what is interpolated over such a distance. The second is measured where the ground is
known: each cell with ground is compared with the plane through the ground in a square ring around
it, whose inner radius is the distance in question. That is cross-validation with a hole of growing
size, the empirical form of a variogram of residuals about a local drift [Kraus et al. 2006 estimate
DTM accuracy from density, distance and curvature in the same way].

Deviations from them: the distance enters by what it costs here, not by a fixed formula. The
deviation is 1.2533 times the mean absolute difference, so that few gross errors do not widen it
everywhere.

Where a cell holds many ground returns their mean hides a third thing: in grass, moss or brush they
fill a layer, and nobody knows where in it the ground is. Ranging noise fills one as well, but it
averages out, so that neighbouring cells agree; what grows differs from cell to cell. So the
variance of returns about the ground of their cell counts as it is, undivided by their number, but
for no more than the variance by which cells differ beyond what noise alone explains.

It cannot show what no point tells: shrubs or a terrace of fill that were taken for ground.
"""

from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from spl_batch.numerics.compiled import njit
from spl_batch.numerics.nearest_cells import distances

RINGS: Final = (1, 2, 4, 8)
"""Inner radii of the rings [cells]; the outer one is twice the inner."""

AROUND: Final = 12
"""Cells on each side whose differences are averaged [cells]."""

_ENOUGH = 6
"""Cells with ground that a ring must hold [count]."""

_HALF_NORMAL = 1.2533
"""Standard deviation for each mean absolute value of a normal distribution."""

_DAMPING = 0.25
"""Added to the scatter of a ring's places, which a gap may put on one line [cells2]."""

_SLOPE_CELLS = 2
"""Cells on each side whose ground tells the slope that returns scatter about [cells]."""

Grid = NDArray[np.float64]


class Scatter(NamedTuple):
    """How the ground returns of each cell lie about their mean.

    Parameters
    ----------
    returns : (...) ndarray
        Ground returns [count].
    products : (..., 6) ndarray
        Means of xx, xy, yy, xz, yz, zz of their offsets; 0 without returns [m2].
    """

    returns: NDArray[Any]
    products: NDArray[Any]


def scatter_of(
    places: tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int32]],
    start: NDArray[np.int64],
    unit_m: float,
) -> Scatter:
    """Scatter of the returns of each cell that holds any, cell by cell.

    Parameters
    ----------
    places : three (n,) int32
        Returns, those of a cell together.
    start : (cells + 1,) int64
        Where each cell begins.
    unit_m : float
        Unit of the places [m].
    """
    first = start[:-1][start[1:] > start[:-1]]
    count = np.diff(np.append(first, len(places[0])))
    # Sums of whole numbers are exact in any order; from one of their own they are small.
    off = [axis.astype(np.float64) - np.repeat(axis[first], count) for axis in places]
    pairs = ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))
    mean = [np.add.reduceat(axis, first) / count if len(first) else axis for axis in off]
    products = np.empty((len(first), len(pairs)))
    for k, (i, j) in enumerate(pairs if len(first) else ()):
        products[:, k] = np.add.reduceat(off[i] * off[j], first) / count - mean[i] * mean[j]
    return Scatter(count, products * unit_m**2)


def terrain_sigma(means: Grid, cell_m: float, scatter: Scatter | None = None) -> Grid:
    """Standard deviation of a terrain model that is interpolated between some cells.

    Parameters
    ----------
    means : (rows, columns, 3) float64
        Place and height of the ground in each cell [m]; NaN without ground.
    cell_m : float
        Edge of a cell [m].
    scatter : Scatter, optional
        That of the returns of each cell; each cell has one by default.

    Returns
    -------
    (rows, columns) float64
        Standard deviation [m]; NaN where no ring holds enough ground to tell.
    """
    held = ~np.isnan(means[:, :, 2])
    moments = _moments(means, held, cell_m)
    integrals = _integrals(moments, 2 * max(RINGS))
    levels = _differences(held, moments, integrals)
    if levels is None:
        return np.full(held.shape, np.nan)
    found = _at_distance(levels, distances(held))
    if scatter is None:
        return found
    layer = _layer_variance(scatter, integrals, levels[0] ** 2, cell_m)
    return np.sqrt(found**2 + layer)


def _layer_variance(scatter: Scatter, integrals: Grid, differ: Grid, cell_m: float) -> Grid:
    """Variance of the ground within the layer that its returns fill: (rows, columns) [m2].

    ``differ``: variance by which a cell's mean differs from those around [m2].
    """
    sums = _boxes(integrals, 2 * max(RINGS), _SLOPE_CELLS)
    held = sums[0] > 0.5
    slope = np.zeros((2, *held.shape))
    slope[:, held] = np.array(_plane(sums[:, held])[3:]) / cell_m
    east, north = slope
    xx, xy, yy, xz, yz, zz = np.moveaxis(scatter.products, -1, 0)
    about = zz - 2 * (east * xz + north * yz)
    about += east * (east * xx + 2 * north * xy) + north * north * yy
    count = scatter.returns.astype(np.float64)
    several = count > 1
    given = np.stack(
        [
            np.where(several, count * np.maximum(about, 0.0), 0.0),
            np.where(several, count - 1, 0.0),
            count,
            (count > 0).astype(np.float64),
        ]
    )
    # Differences of sums may fall short of zero by rounding.
    total, free, returns, cells = np.maximum(_boxes(_integrals(given, AROUND), AROUND, AROUND), 0.0)
    variance = total / np.maximum(free, 1.0)
    each = np.maximum(returns / np.maximum(cells, 1.0), 1.0)
    beyond_noise = np.maximum(differ - variance / each, 0.0)
    layer: Grid = np.minimum((1.0 - 1.0 / each) * variance, beyond_noise)
    return layer


def _differences(held: NDArray[np.bool_], moments: Grid, integrals: Grid) -> Grid | None:
    """Deviation from the planes of rings, around each cell: (rings, rows, columns) [m].

    No larger ring gives less. For a ring that holds too little the next larger one speaks; without
    one, the next smaller one, times the ratio of the radii. Where none holds enough, the nearest
    place where one does counts; without any there is nothing: None.
    """
    levels = np.full((len(RINGS), *held.shape), np.nan)
    for k, ring in enumerate(RINGS):
        off, known = _off_ring(held, moments, integrals, ring)
        given = np.stack([known.astype(np.float64), np.where(known, np.abs(off), 0.0)])
        count, total = _boxes(_integrals(given, AROUND), AROUND, AROUND)
        here = count > _ENOUGH - 0.5
        levels[k][here] = _HALF_NORMAL * total[here] / count[here]
    nowhere = np.asarray(np.isnan(levels).all(axis=0))
    if nowhere.all():
        return None
    nearest = ndimage.distance_transform_edt(nowhere, return_distances=False, return_indices=True)
    levels = np.stack([level[tuple(nearest)] for level in levels])
    for k in reversed(range(len(RINGS) - 1)):
        levels[k] = np.where(np.isnan(levels[k]), levels[k + 1], levels[k])
    for k in range(1, len(RINGS)):
        levels[k] = np.where(np.isnan(levels[k]), 2.0 * levels[k - 1], levels[k])
    return np.maximum.accumulate(levels, axis=0)


def _moments(means: Grid, held: NDArray[np.bool_], cell_m: float) -> Grid:
    """1, x, y, z, xx, xy, yy, xz, yz of cells with ground, 0 elsewhere: (9, rows, columns)."""
    middle = means[held].mean(axis=0) if held.any() else np.zeros(3)
    x, y, z = np.moveaxis(np.where(held[:, :, None], means - middle, 0.0), 2, 0)
    x, y = x / cell_m, y / cell_m
    return np.stack([held.astype(np.float64), x, y, z, x * x, x * y, y * y, x * z, y * z])


def _integrals(fields: Grid, reach: int) -> Grid:
    """Sums from the first corner on of (n, rows, columns) fields, with zeros around them."""
    count, *shape = fields.shape
    integrals: Grid = np.zeros((count, *(size + 2 * reach + 1 for size in shape)))
    inside = [slice(reach + 1, reach + 1 + size) for size in shape]
    integrals[:, inside[0], inside[1]] = fields
    _add_up(integrals)
    return integrals


@njit()
def _add_up(fields: Grid) -> None:
    """Sums from the first corner on, in place: along rows of sums along columns."""
    count, rows, columns = fields.shape
    for k in range(count):
        for r in range(1, rows):
            for c in range(columns):
                fields[k, r, c] += fields[k, r - 1, c]
        for r in range(rows):
            for c in range(1, columns):
                fields[k, r, c] += fields[k, r, c - 1]


@njit()
def _box(integrals: Grid, k: int, r: int, c: int, low: int, high: int) -> float:
    """Sum of a field over a square, by its corners from a cell on."""
    summed = integrals[k, r + high, c + high] - integrals[k, r + low, c + high]
    summed -= integrals[k, r + high, c + low]
    summed += integrals[k, r + low, c + low]
    return float(summed)


def _boxes(integrals: Grid, widest: int, reach: int) -> Grid:
    """Sums over a square around each cell, whole at the edges: (n, rows, columns).

    ``integrals``: of :func:`_integrals` with the reach ``widest``, which is no less than ``reach``.
    """
    count, *shape = integrals.shape
    summed = np.empty((count, *(size - 2 * widest - 1 for size in shape)))
    _add_boxes(integrals, widest - reach, widest + 1 + reach, summed)
    return summed


@njit()
def _add_boxes(integrals: Grid, low: int, high: int, out: Grid) -> None:
    count, rows, columns = out.shape
    for k in range(count):
        for r in range(rows):
            for c in range(columns):
                out[k, r, c] = _box(integrals, k, r, c, low, high)


def _off_ring(
    held: NDArray[np.bool_], moments: Grid, integrals: Grid, ring: int
) -> tuple[Grid, NDArray[np.bool_]]:
    """Height above the plane of a ring around each cell [m], and where there is one."""
    widest = 2 * max(RINGS)
    outer, inner = (
        (widest - reach, widest + 1 + reach) for reach in (2 * ring, ring - 1)
    )  # fmt: skip
    off, known = np.zeros(held.shape), np.zeros(held.shape, np.bool_)
    _fit_rings(held, moments, integrals, outer, inner, off, known)
    return off, known


@njit()
def _fit_rings(
    held: NDArray[np.bool_], moments: Grid, integrals: Grid,
    outer: tuple[int, int], inner: tuple[int, int], off: Grid, known: NDArray[np.bool_],
) -> None:  # fmt: skip
    """Fill for cells with ground whose ring holds enough of it."""
    rows, columns = held.shape
    sums = np.empty(9)
    for r in range(rows):
        for c in range(columns):
            if not held[r, c]:
                continue
            for k in range(9):
                sums[k] = _box(integrals, k, r, c, *outer) - _box(integrals, k, r, c, *inner)
                if k == 0 and not sums[0] > _ENOUGH - 0.5:
                    break
            else:
                x, y, z, east, north = _plane_of(
                    sums[0], sums[1], sums[2], sums[3], sums[4], sums[5], sums[6], sums[7], sums[8]
                )
                above = east * (moments[1, r, c] - x) + north * (moments[2, r, c] - y)
                off[r, c], known[r, c] = moments[3, r, c] - (z + above), True


def _plane(sums: Grid) -> tuple[Grid, Grid, Grid, Grid, Grid]:
    """Middle of planes through some cells (x, y, z) and their rise to east and north.

    ``sums``: (9, n), those of :func:`_moments`; each of one cell at least.
    """
    return _fit(*sums)


def _fit(
    n: Grid, x: Grid, y: Grid, z: Grid, xx: Grid, xy: Grid, yy: Grid, xz: Grid, yz: Grid
) -> tuple[Grid, Grid, Grid, Grid, Grid]:
    """The same of one cell or many."""
    x, y, z = x / n, y / n, z / n
    xx, yy, xy = xx / n - x * x + _DAMPING, yy / n - y * y + _DAMPING, xy / n - x * y
    xz, yz = xz / n - x * z, yz / n - y * z
    scale = xx * yy - xy * xy
    return x, y, z, (yy * xz - xy * yz) / scale, (xx * yz - xy * xz) / scale


_plane_of = njit()(_fit)


def _at_distance(levels: Grid, away: Grid) -> Grid:
    """Deviation at each cell by its distance to ground [cells]; linear between the rings.

    A cell with ground is its own mean of returns: it shares with its neighbours what differs
    between them. Beyond the largest ring the deviation grows with the distance.
    """
    found = levels[0].copy()
    for k in range(1, len(RINGS)):
        share = np.clip((away - RINGS[k - 1]) / (RINGS[k] - RINGS[k - 1]), 0.0, 1.0)
        found += share * (levels[k] - levels[k - 1])
    beyond: Grid = found * np.maximum(away / RINGS[-1], 1.0)
    return beyond
