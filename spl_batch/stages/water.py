r"""Water surfaces: what of a water polygon's returns may carry a terrain model, and how high.

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

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from spl_batch.model import PointFlag, PointTable
from spl_batch.tiling import cell_index, quanta

DOMAIN: Final = "space"

CELL_M: Final = 5.0
"""Edge of the absolute cells in which the top layer is looked for [m]."""

REACH_CELLS: Final = 5
"""Cells on each side whose tops make the level [count]."""

REACH_M: Final = (REACH_CELLS + 1) * CELL_M
"""How far the level of a place looks, at most [m]."""

LAYER_M: Final = 0.3
"""Thickness of the top layer: three ranging spreads on each side [m]."""

TOP_COUNT: Final = 3
TOP_SHARE: Final = 0.05
"""Returns that make a layer: so many, and so much of the cell."""

AGREE_M: Final = 0.25
"""Tops of neighbouring cells of one water differ by no more: a fall of a twentieth [m]."""

BELOW_M: Final = 0.25
"""Returns farther below the level are no surface: five ranging spreads [m]."""

_NOWHERE: Final = -(2**40)
"""A level below everything [quanta]."""

Heights = NDArray[np.int64]


class _Cells(NamedTuple):
    """Some returns by cell, highest first.

    Parameters
    ----------
    order : (n,) intp
        Rows of the returns.
    start : (m + 1,) intp
        Where each cell begins in ``order``.
    place : tuple of (m,) int64
        Column and row of each cell.
    """

    order: NDArray[np.intp]
    start: NDArray[np.intp]
    place: tuple[Heights, Heights]


def submerged(table: PointTable, usable: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Returns in water polygons that lie below the water's surface.

    Parameters
    ----------
    table : PointTable
        Points with ``x, y, z, flags``.
    usable : (n,) bool
        Signal; the level is taken from these.

    Returns
    -------
    (n,) bool
        False for what is not usable.
    """
    out = np.zeros(len(table), np.bool_)
    water = np.flatnonzero(usable & table.has(PointFlag.WATER))
    x, y, z = (table[axis][water].astype(np.int64) for axis in "xyz")
    out[water] = z < water_level(x, y, z) - quanta(BELOW_M)
    return out


def flattened(table: PointTable) -> PointTable:
    """Ground with what lies in water polygons lifted or lowered to the water's level.

    Parameters
    ----------
    table : PointTable
        Ground returns with ``x, y, z, flags``.

    Returns
    -------
    PointTable
        Those at the surface, :data:`BELOW_M` on either side of it, lie on it.
    """
    water = np.flatnonzero(table.has(PointFlag.WATER))
    if not len(water):
        return table
    x, y, z = (table[axis][water].astype(np.int64) for axis in "xyz")
    level = water_level(x, y, z)
    height = table["z"].copy()
    height[water] = np.where(np.abs(z - level) <= quanta(BELOW_M), level, z)
    return table.with_columns(z=height)


def water_level(x: Heights, y: Heights, z: Heights) -> Heights:
    """Level of the water around each of its returns.

    Parameters
    ----------
    x, y, z : (n,) int64
        Returns in water polygons, in any order, on the absolute lattice [quanta].

    Returns
    -------
    (n,) int64
        [quanta]; the same for all returns of a cell.
    """
    level = np.empty(len(z), np.int64)
    if len(z):
        cells = _by_cell(x, y, z)
        tops = _tops(z[cells.order], cells.start)
        around = _median_around(tops, cells.place)
        level[cells.order] = np.repeat(around, np.diff(cells.start))
    return level


def _by_cell(x: Heights, y: Heights, z: Heights) -> _Cells:
    edge = quanta(CELL_M)
    i, j = cell_index(x, edge), cell_index(y, edge)
    order = np.lexsort((-z, i, j))
    i, j = i[order], j[order]
    first = np.flatnonzero(np.diff(i, prepend=i[0] - 1) | np.diff(j, prepend=j[0]))
    return _Cells(order, np.append(first, len(z)), (i[first], j[first]))


def _tops(z: Heights, start: NDArray[np.intp]) -> NDArray[np.float64]:
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


def _median_around(tops: NDArray[np.float64], place: tuple[Heights, Heights]) -> Heights:
    """Median of the tops that agree in the water around each cell, else far below: (m,)."""
    i, j = (along - int(along.min()) + REACH_CELLS for along in place)
    held = np.zeros((int(i.max()) + REACH_CELLS + 1, int(j.max()) + REACH_CELLS + 1), np.bool_)
    held[i, j] = True
    water, _ = ndimage.label(held, np.ones((3, 3), np.int32))
    own = water[i, j][:, None, None]

    def around(values: NDArray[np.float64], reach: int) -> NDArray[np.float64]:
        """Values of the cells of the same water, row by row: (m, (2 reach + 1)^2)."""
        grid = np.full(held.shape, np.nan)
        grid[i, j] = values
        steps = np.arange(-reach, reach + 1)
        at = i[:, None, None] + steps[:, None], j[:, None, None] + steps
        return np.where(water[at] == own, grid[at], np.nan).reshape(len(values), -1)

    beside = around(tops, 1)
    alike = np.count_nonzero(np.abs(beside - tops[:, None]) <= quanta(AGREE_M), axis=1) - 1
    others = np.count_nonzero(~np.isnan(beside), axis=1) - 1
    near = np.sort(around(np.where(3 * alike >= others, tops, np.nan), REACH_CELLS), axis=1)
    known = np.count_nonzero(~np.isnan(near), axis=1)  # NaN comes last
    middle = near[np.arange(len(tops)), np.maximum(known - 1, 0) // 2]
    return np.where(known > 0, middle, _NOWHERE).astype(np.int64)
