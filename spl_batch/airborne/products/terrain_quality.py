"""Standard deviation of the terrain: how well each cell of the DTM is known.

A DTM is interpolated between cells that hold ground returns. Its error in other cells follows from
two things that the ground itself shows: how far the nearest ground is, and how much heights here
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

It cannot show what no point shows: shrubs or a terrace of fill that were taken for ground.
"""

import math
from collections.abc import Iterator
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.numerics.nearest_cells import distances, nearest_cells

RING_PLACES: Final = 6
"""Places with ground that the plane of a ring is fitted to, at least [count]. At 4 it
moves 984 + 0 cells of its sigma, at twice 5752 + 4563."""

RINGS: Final = (1, 2, 4, 8)
"""Inner radii of the rings [cells]; the outer one is twice the inner. Of cells finer than
:data:`CELL_M` so many together count as one: nearer ground stands in the same growth and on the
same stone, and what it agrees about is no sign of how well either is known. Half moves 123 + 28
cells of its sigma, twice 6905 + 7023 cells of its sigma."""

CELL_M: Final = 1.0
"""Least edge of what counts as a cell of a ring [m]. Half moves nothing, twice 6905 + 7023 cells of
its sigma."""

AROUND: Final = 12
"""Cells on each side whose differences are averaged [cells]. Half moves 6905 + 7019 cells of its
sigma, twice 6905 + 7020 cells of its sigma."""

_HALF_NORMAL = math.sqrt(math.pi / 2.0)
"""Standard deviation for each mean absolute value of a normal distribution."""

_DAMPING = 0.25
"""Added to the scatter of a ring's places, which a gap may put on one line [cells2]. Half moves
6905 + 7019 cells of its sigma, twice 6905 + 7020 cells of its sigma."""

Grid = NDArray[np.float64]


def rings(cell_m: float) -> tuple[int, ...]:
    """Inner radii of the rings, in raster cells of this edge [m]."""
    together = max(round(CELL_M / cell_m), 1)
    return tuple(together * ring for ring in RINGS)


class Scatter(NamedTuple):
    """How the ground returns of each cell lie about their mean."""

    returns: NDArray[Any]
    products: NDArray[Any]


def scatter_of(
    places: tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int32]],
    start: NDArray[np.int64],
    unit_m: float,
) -> Scatter:
    """Scatter of the returns of each cell that holds any, cell by cell.

    ``places``: three (n,), those of a cell together from ``start`` on, in units of ``unit_m``.
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
        Standard deviation [m]; NaN where no ring holds enough ground.
    """
    held, radii = ~np.isnan(means[:, :, 2]), rings(cell_m)
    if not held.any():
        return np.full(held.shape, np.nan)
    places = (means - means[held].mean(axis=0)) / (cell_m, cell_m, 1.0)
    integrals = _moments(places, 2 * radii[-1])
    levels = _differences(places, integrals, radii)
    if levels is None:
        return np.full(held.shape, np.nan)
    found = _at_distance(levels, distances(held), radii)
    if scatter is None:
        return found
    layer = _layer_variance(scatter, integrals, levels[0] ** 2, cell_m)
    return np.sqrt(found**2 + layer)


def _layer_variance(scatter: Scatter, integrals: Grid, differ: Grid, cell_m: float) -> Grid:
    """Variance of ground within the layer of its returns; ``differ``: of means among cells [m2].

    The ground as far as the second ring begins gives the slope that returns scatter about.
    """
    shape = scatter.returns.shape
    radii = rings(cell_m)
    sums = (_boxes(field, 2 * radii[-1], radii[1]) for field in integrals)
    *_, east, north = _planes(sums, 1)
    east, north = (np.where(np.isnan(slope), 0.0, slope) / cell_m for slope in (east, north))
    xx, xy, yy, xz, yz, zz = np.moveaxis(scatter.products, -1, 0)
    about = zz - 2 * (east * xz + north * yz)
    about += east * (east * xx + 2 * north * xy) + north * north * yy
    count = scatter.returns.astype(np.float64)
    several = count > 1
    integrals, given = _room(4, shape, AROUND)
    given[0] = np.where(several, count * np.maximum(about, 0.0), 0.0)
    given[1] = np.where(several, count - 1, 0.0)
    given[2], given[3] = count, count > 0
    _add_up(integrals)
    # Differences of sums may fall short of zero by rounding.
    total, free, returns, cells = np.maximum(_boxes(integrals, AROUND, AROUND), 0.0)
    variance = total / np.maximum(free, 1.0)
    each = np.maximum(returns / np.maximum(cells, 1.0), 1.0)
    beyond_noise = np.maximum(differ - variance / each, 0.0)
    layer: Grid = np.minimum((1.0 - 1.0 / each) * variance, beyond_noise)
    return layer


def _differences(places: Grid, integrals: Grid, radii: tuple[int, ...]) -> Grid | None:
    """Deviation from the planes of rings, around each cell: (rings, rows, columns) [m].

    No larger ring gives less. For a ring that holds too little the next larger one speaks; without
    one, the next smaller one, times the ratio of the radii. Where none holds enough, the nearest
    place where one does counts; without any there is nothing: None.
    """
    shape = places.shape[:2]
    levels = np.empty((len(radii), *shape))
    for level, ring in zip(levels, radii, strict=True):
        off = _off_ring(places, integrals, 2 * radii[-1], ring)
        known = ~np.isnan(off)
        sums, given = _room(2, shape, AROUND)
        given[0], given[1] = known, np.where(known, off, 0.0)
        _add_up(sums)
        count, total = _boxes(sums, AROUND, AROUND)
        level[:] = np.nan
        np.divide(_HALF_NORMAL * total, count, out=level, where=count > RING_PLACES - 0.5)
    nowhere = np.asarray(np.isnan(levels).all(axis=0))
    if nowhere.all():
        return None
    if nowhere.any():
        nearest = nearest_cells(~nowhere)
        for level in levels:
            level[:] = level[nearest]
    for k in reversed(range(len(radii) - 1)):
        np.copyto(levels[k], levels[k + 1], where=np.isnan(levels[k]))
    for k in range(1, len(radii)):
        lost = np.isnan(levels[k])
        levels[k][lost] = 2.0 * levels[k - 1][lost]
        np.maximum(levels[k], levels[k - 1], out=levels[k])
    return levels


def _off_ring(places: Grid, integrals: Grid, room: int, ring: int) -> Grid:
    """How far each cell is off the plane of its ring: (rows, columns) [m]; NaN without one.

    ``integrals``: :func:`_moments` in a room of that reach.
    """
    x, y, z = np.moveaxis(places, -1, 0)
    sums = (_boxes(field, room, 2 * ring) - _boxes(field, room, ring - 1) for field in integrals)
    middle_x, middle_y, middle_z, east, north = _planes(sums, RING_PLACES)
    above = east * (x - middle_x) + north * (y - middle_y)
    off: Grid = np.abs(z - (middle_z + above))
    return off


def _moments(places: Grid, reach: int) -> Grid:
    """1, x, y, z, xx, xy, yy, xz, yz of cells with ground, added up in a :func:`_room`."""
    x, y, z = np.moveaxis(places, -1, 0)
    held = ~np.isnan(z)
    integrals, field = _room(9, held.shape, reach)
    moments = np.ones_like(x), x, y, z, x * x, x * y, y * y, x * z, y * z
    for room, values in zip(field, moments, strict=True):
        np.copyto(room, values, where=held)
    _add_up(integrals)
    return integrals


def _room(count: int, shape: tuple[int, ...], reach: int) -> tuple[Grid, Grid]:
    """Fields of zeros with a rim, for sums from the first corner on, and what is within the rim."""
    fields: Grid = np.zeros((count, *(size + 2 * reach + 1 for size in shape)))
    inside = [slice(reach + 1, reach + 1 + size) for size in shape]
    return fields, fields[:, inside[0], inside[1]]


def _add_up(fields: Grid) -> None:
    """Sums from the first corner on, in place: along rows of sums along columns."""
    for axis in (1, 2):
        np.cumsum(fields, axis=axis, out=fields)


def _boxes(integrals: Grid, room: int, reach: int) -> Grid:
    """Sums over a square around each cell, of what is added up in a :func:`_room` of a reach."""
    low, high = room - reach, room + reach + 1
    south, west = (slice(low, low + size - 2 * room - 1) for size in integrals.shape[-2:])
    north, east = (slice(high, high + size - 2 * room - 1) for size in integrals.shape[-2:])
    summed: Grid = integrals[..., north, east] - integrals[..., south, east]
    summed -= integrals[..., north, west]
    summed += integrals[..., south, west]
    return summed


def _planes(sums: Iterator[Grid], least: int) -> tuple[Grid, Grid, Grid, Grid, Grid]:
    """Planes through the ground around each cell: middle x, y, z and rise to east and north.

    ``sums``: moments over that ground, as :func:`_moments` has them, nine (rows, columns); NaN
    where it is in fewer cells than ``least``.
    """
    count = next(sums)
    count = np.where(count > least - 0.5, count, np.nan)
    x, y, z = (next(sums) / count for _ in range(3))
    pairs = ((x, x, _DAMPING), (x, y, 0.0), (y, y, _DAMPING), (x, z, 0.0), (y, z, 0.0))
    xx, xy, yy, xz, yz = (next(sums) / count - a * b + more for a, b, more in pairs)
    scale = xx * yy - xy * xy
    return x, y, z, (yy * xz - xy * yz) / scale, (xx * yz - xy * xz) / scale


def _at_distance(levels: Grid, away: Grid, radii: tuple[int, ...]) -> Grid:
    """Deviation at each cell by its distance to ground [cells]; linear between the rings."""
    # A cell with ground is its own mean of returns: it shares with its neighbours what differs
    # between them.
    found = levels[0].copy()
    for k in range(1, len(radii)):
        share = np.clip((away - radii[k - 1]) / (radii[k] - radii[k - 1]), 0.0, 1.0)
        found += share * (levels[k] - levels[k - 1])
    beyond: Grid = found * np.maximum(away / radii[-1], 1.0)
    return beyond
