r"""The level of water polygons: how high the surface of their water lies.

Domain: space. A terrain model of water is its surface (hydro-flattened, USGS Lidar Base
Specification). Afterpulses of the surface and returns of the bottom lie below it and are kept as
points. Clear water may send back many more returns from its bottom than from its surface, so the
level is no mean and no median of what is there; it is the top layer:

1. of each absolute cell of 5 m: the highest returns of which :data:`TOP_COUNT`, and
   :data:`TOP_SHARE` of all, lie within :data:`LAYER_M`; their median height, if a third of the
   tops of the eight cells around agree with it: those of crowns do not;
2. of the cells within :data:`REACH_CELLS` that hang together with it: the median of these.

What is assumed: polygons hold water. Of the tops of 55 m x 55 m of it, those of decks, boats and
banks are less than half. Where none agree, as in a creek under trees, nothing is below the water.
Nothing is assumed of slopes: a median of what lies around a cell of a river follows its fall, and
is off by that over some metres where the polygon ends.
"""

from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from spl_batch.airborne.ground.lowest_layers import SUPPORTED
from spl_batch.airborne.ground.scales import BLOCK_M, DEPTH_M, SIGMA_M
from spl_batch.airborne.ground.scales import LAYER_M as RETURN_M
from spl_batch.lattice.tables import PointFlag, PointTable
from spl_batch.lattice.tiles import cell_index, quanta

CELL_M: Final = 5.0
"""Edge of the absolute cells in which the top layer is looked for [m]."""

REACH_CELLS: Final = round(1.5 * BLOCK_M / CELL_M)
"""Cells on each side whose tops make the level: those of a block and of the ones around [count]."""

REACH_M: Final = (REACH_CELLS + 1) * CELL_M
"""How far the level of a return looks, at most [m]."""

LAYER_M: Final = 2 * RETURN_M
"""Thickness of the top layer: returns above and below the surface [m]."""

TOP_COUNT: Final = SUPPORTED
TOP_SHARE: Final = 0.05
"""Returns that make a layer: so many, and so much of the cell."""

NEAR_M: Final = DEPTH_M
"""Returns farther from the level are no surface, and tops of neighbouring cells of one water differ
by no more, as with a fall of a twentieth [m]."""

APART_M: Final = SIGMA_M
"""Levels of all that was returned and of its ground differ by no more [m]."""

NOWHERE: Final = np.iinfo(np.int64).min // 2
"""A level below everything [quanta]."""

Heights = NDArray[np.int64]
Float = NDArray[np.float64]


class Levels(NamedTuple):
    """Levels of water by cells.

    Parameters
    ----------
    first : (int, int)
        Column and row of the first cell.
    number : (columns, rows) int64
        Number of each cell on from there, -1 without water.
    level : (m,) int64
        Level of each numbered cell [quanta]; :data:`NOWHERE` where it is not known.
    """

    first: tuple[int, int]
    number: Heights
    level: Heights

    def at(self, x: Heights, y: Heights) -> Heights:
        """Level of returns in water: (n,) [quanta]; :data:`NOWHERE` where it is not known."""
        i, j = self._cell(x, y)
        at: Heights = self.number[i, j]
        return self.level[at]

    def near(self, x: NDArray[Any], y: NDArray[Any], cells: int) -> NDArray[np.bool_]:
        """Which returns lie in a cell with water, or so many cells beside one: (n,) bool."""
        around = ndimage.maximum_filter(np.pad(self.number >= 0, cells), 2 * cells + 1)
        i, j = (along + cells for along in self._cell(x, y))
        there: NDArray[np.bool_] = (i >= 0) & (i < around.shape[0])
        there &= (j >= 0) & (j < around.shape[1])
        there[there] = around[i[there], j[there]]
        return there

    def _cell(self, x: NDArray[Any], y: NDArray[Any]) -> tuple[Heights, Heights]:
        """Column and row of the cells of returns, on from the first one."""
        edge = quanta(CELL_M)
        return cell_index(x, edge) - self.first[0], cell_index(y, edge) - self.first[1]


def water_levels(x: Heights, y: Heights, z: Heights, *, beyond: bool = False) -> Levels:
    """Levels of the water that some returns lie in.

    Parameters
    ----------
    x, y, z : (n,) int64
        Returns in water polygons, on the absolute lattice [quanta].
    beyond : bool
        Where what is connected with a cell shows no level, the water around it does.
    """
    if not len(z):
        return Levels((0, 0), np.full((1, 1), -1, np.int64), np.empty(0, np.int64))
    i, j = (cell_index(along, quanta(CELL_M)) for along in (x, y))
    order = np.lexsort((-z, i, j))
    i, j = i[order], j[order]
    new = np.flatnonzero(np.diff(i, prepend=i[0] - 1) | np.diff(j, prepend=j[0]))
    tops, i, j = _tops(z[order], np.append(new, len(z))), i[new], j[new]
    first = int(i.min()), int(j.min())
    i, j = i - first[0], j - first[1]
    number = np.full((int(i.max()) + 1, int(j.max()) + 1), -1, np.int64)
    number[i, j] = np.arange(len(tops))
    return Levels(first, number, _median_around(tops, (i, j), beyond=beyond))


def flattened(ground: PointTable, levels: Levels) -> PointTable:
    """Ground with what lies in water polygons lifted or lowered to the water's level.

    Parameters
    ----------
    ground : PointTable
        Ground returns with ``x, y, z, flags``.
    levels : Levels
        Of all ground in the water.

    Returns
    -------
    PointTable
        Those at the surface, :data:`NEAR_M` and :data:`APART_M` on either side of it, lie on it.
    """
    water, (x, y, z) = in_water(ground)
    if not len(water):
        return ground
    level, height = levels.at(x, y), ground["z"].copy()
    height[water] = np.where(np.abs(z - level) <= quanta(NEAR_M + APART_M), level, z)
    return ground.with_columns(z=height)


def in_water(
    table: PointTable, usable: NDArray[np.bool_] | None = None
) -> tuple[NDArray[np.intp], tuple[Heights, Heights, Heights]]:
    """Rows of the returns in water polygons, and where they lie.

    Parameters
    ----------
    table : PointTable
        Points with ``x, y, z, flags``.
    usable : (n,) bool, optional
        Those to be judged; all by default.
    """
    wet = table.has(PointFlag.WATER)
    rows = np.flatnonzero(wet if usable is None else wet & usable)
    x, y, z = (table[axis][rows].astype(np.int64) for axis in "xyz")
    return rows, (x, y, z)


def _tops(z: Heights, start: NDArray[np.intp]) -> Float:
    """Median height of the top layer of each cell, NaN where it has none: (m,) [quanta].

    Parameters
    ----------
    z : (n,) int64
        Heights by cell, falling.
    start : (m + 1,) intp
        Where each cell begins.
    """
    count = np.diff(start)
    needed = np.maximum(TOP_COUNT, np.ceil(TOP_SHARE * count).astype(np.int64))
    tops = np.full(len(count), np.nan)
    for cell in np.flatnonzero(count >= needed):
        heights = z[start[cell] : start[cell + 1]]
        below = needed[cell] - 1
        full = heights[: len(heights) - below] - heights[below:] <= quanta(LAYER_M)
        if full.any():
            layer = heights[np.argmax(full) :]
            middle = np.median(layer[layer >= layer[0] - quanta(LAYER_M)])
            # A return or two just above the surface must not cut its lower half off.
            near = np.abs(heights - middle) <= quanta(LAYER_M / 2)
            tops[cell] = np.median(heights[near])
    return tops


def _median_around(tops: Float, place: tuple[Heights, Heights], *, beyond: bool) -> Heights:
    """Median of the tops that agree in the water around each cell, else far below: (m,)."""
    i, j = (along - int(along.min()) + REACH_CELLS for along in place)
    held = np.zeros((int(i.max()) + REACH_CELLS + 1, int(j.max()) + REACH_CELLS + 1), np.bool_)
    held[i, j] = True
    water, _ = ndimage.label(held, np.ones((3, 3), np.int32))

    def around(values: Float, reach: int, water: NDArray[np.integer[Any]]) -> Float:
        """Values of the cells of the same water, row by row: (m, (2 reach + 1)^2)."""
        grid = np.full(held.shape, np.nan)
        grid[i, j] = values
        steps = np.arange(-reach, reach + 1)
        at = i[:, None, None] + steps[:, None], j[:, None, None] + steps
        same = water[at] == water[i, j][:, None, None]
        return np.where(same, grid[at], np.nan).reshape(len(values), -1)

    beside = around(tops, 1, water)
    alike = np.count_nonzero(np.abs(beside - tops[:, None]) <= quanta(NEAR_M), axis=1) - 1
    others = np.count_nonzero(~np.isnan(beside), axis=1) - 1
    agreed = np.where(3 * alike >= others, tops, np.nan)
    near = around(agreed, REACH_CELLS, water)
    if beyond:
        alone = np.isnan(near).all(axis=1)
        near[alone] = around(agreed, REACH_CELLS, np.ones_like(water))[alone]
    near = np.sort(near, axis=1)
    known = np.count_nonzero(~np.isnan(near), axis=1)  # NaN comes last
    middle = near[np.arange(len(tops)), np.maximum(known - 1, 0) // 2]
    return np.where(known > 0, middle, NOWHERE).astype(np.int64)
