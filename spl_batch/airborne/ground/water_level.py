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

What stands above the level is kept noise, a boat, a deck, or land that the polygon wrongly holds:
an island or a bank. Land and decks are dense: of an absolute cell of 2.5 m at least
:data:`TOP_COUNT` returns, and :data:`TOP_SHARE` of all, lie within :data:`LAYER_M` of a return of
theirs. And they go on: such layers of neighbouring cells hang together over :data:`PATCH_CELLS`
cells or more, those of the land around among them. Only that is left to the ground filter, which
cuts decks off. Noise between a deck and the water is not dense beside the deck.
"""

from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from spl_batch.lattice.tables import PointFlag, PointTable
from spl_batch.lattice.tiles import cell_index, quanta

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

NEAR_M: Final = 0.25
"""Returns farther from the level are no surface: five ranging spreads [m]."""

APART_M: Final = 0.05
"""Levels of all that was returned and of its ground differ by no more: a ranging spread [m]."""

LAND_CELL_M: Final = 2.5
"""Edge of the absolute cells in which land is dense [m]."""

PATCH_CELLS: Final = 9
"""Cells over which land hangs together: those that a boat of 5 m may touch [count]."""

_NOWHERE: Final = -(2**40)
"""A level below everything [quanta]."""

Heights = NDArray[np.int64]
Float = NDArray[np.float64]


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


def off_surface(table: PointTable, usable: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Returns in water polygons that no terrain may rest on.

    Parameters
    ----------
    table : PointTable
        Points with ``x, y, z, flags``.
    usable : (n,) bool
        Signal; level and land are taken from these.

    Returns
    -------
    (n,) bool
        What lies farther than :data:`NEAR_M` below the water's surface, and what stands so far
        above it and is neither land nor as dense and wide as land. False for what is not usable,
        and above the water where its level is not known.
    """
    out = np.zeros(len(table), np.bool_)
    wet = table.has(PointFlag.WATER)
    water = np.flatnonzero(usable & wet)
    if not len(water):
        return out
    x, y, z = (table[axis][water].astype(np.int64) for axis in "xyz")
    level = water_level(x, y, z)
    out[water] = z < level - quanta(NEAR_M)
    above = water[(z > level + quanta(NEAR_M)) & (level > _NOWHERE)]
    if len(above):
        stands = usable & ~wet
        stands[above] = True
        out[above] = ~_land(table, usable, stands, above)
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
        Those at the surface, :data:`NEAR_M` and :data:`APART_M` on either side of it, lie on it.
    """
    water = np.flatnonzero(table.has(PointFlag.WATER))
    if not len(water):
        return table
    x, y, z = (table[axis][water].astype(np.int64) for axis in "xyz")
    # Under a deck what is left of the water may hang together with no other.
    level = water_level(x, y, z, beyond=True)
    height = table["z"].copy()
    height[water] = np.where(np.abs(z - level) <= quanta(NEAR_M + APART_M), level, z)
    return table.with_columns(z=height)


def _land(
    table: PointTable,
    usable: NDArray[np.bool_],
    stands: NDArray[np.bool_],
    asked: NDArray[np.intp],
) -> NDArray[np.bool_]:
    """Which returns belong to layers that are dense and hang together: (m,) bool.

    Parameters
    ----------
    table : PointTable
        Points with ``x, y, z``.
    usable : (n,) bool
        Signal, which layers must be a share of.
    stands : (n,) bool
        What layers are made of: the land around the water, and what stands above it.
    asked : (m,) intp
        Rows of what stands above it.
    """
    edge = quanta(LAND_CELL_M)
    i, j = (cell_index(table[axis].astype(np.int64), edge) for axis in "xy")
    i, j = (along - (int(along[asked].min()) - PATCH_CELLS) for along in (i, j))
    columns, rows = (int(along[asked].max()) + PATCH_CELLS + 1 for along in (i, j))
    near = (i >= 0) & (i < columns) & (j >= 0) & (j < rows)
    # Numbers rise along a column; one that no cell has parts it from the next.
    number = i * (rows + 1) + j
    total = np.bincount(number[usable & near], minlength=columns * (rows + 1))
    row = np.flatnonzero(stands & near)
    order = np.lexsort((table["z"][row], number[row]))
    row = row[order]
    cell, z = number[row], table["z"][row].astype(np.int64)
    # One rising sequence of heights: those of different cells are farther apart than any layer.
    thick = quanta(LAYER_M)
    climbing = cell * (int(np.ptp(z)) + 3 * thick) + z
    last = np.searchsorted(climbing, climbing + thick, side="right")
    first = np.searchsorted(climbing, climbing - thick, side="left")
    dense = last - first >= np.maximum(TOP_COUNT, np.ceil(TOP_SHARE * total[cell]))
    row, cell, climbing, z = row[dense], cell[dense], climbing[dense], z[dense]
    land = np.zeros(len(table), np.bool_)
    if len(row):
        layer = np.cumsum(np.diff(climbing, prepend=climbing[0]) > thick)
        ends = np.flatnonzero(np.diff(layer, append=layer[-1] + 1))
        starts = np.append(0, ends[:-1] + 1)
        half = thick // 2
        wide = _hang_together(cell[starts], z[starts] - half, z[ends] + half, rows + 1)
        land[row] = wide[layer]
    return land[asked]


def _hang_together(cell: Heights, low: Heights, high: Heights, column: int) -> NDArray[np.bool_]:
    """Layers that meet those of cells beside them, and so on, over enough cells: (m,) bool.

    Parameters
    ----------
    cell : (m,) int64
        Number of the cell of each layer, rising.
    low, high : (m,) int64
        Ends of each layer, with half of what may lie between two that meet [quanta].
    column : int
        From the number of a cell to that of the one beside it in the next column.
    """
    pairs = []
    for step in (1, column - 1, column, column + 1):
        start, end = (np.searchsorted(cell, cell + step, side) for side in ("left", "right"))
        count = end - start
        one = np.repeat(np.arange(len(cell)), count)
        other = np.arange(len(one)) - np.repeat(np.cumsum(count) - count, count) + start[one]
        meet = (low[one] <= high[other]) & (low[other] <= high[one])
        pairs.append((one[meet], other[meet]))
    one, other = (np.concatenate(ends) for ends in zip(*pairs, strict=True))
    size = len(cell)
    graph = coo_array((np.ones(len(one), np.bool_), (one, other)), shape=(size, size))
    _, patch = connected_components(graph, directed=False)
    held = np.unique(patch.astype(np.int64) * (int(cell[-1]) + 1) + cell) // (int(cell[-1]) + 1)
    wide: NDArray[np.bool_] = (np.bincount(held) >= PATCH_CELLS)[patch]
    return wide


def water_level(x: Heights, y: Heights, z: Heights, *, beyond: bool = False) -> Heights:
    """Level of the water around each of its returns.

    Parameters
    ----------
    x, y, z : (n,) int64
        Returns in water polygons, in any order, on the absolute lattice [quanta].
    beyond : bool
        Where what hangs together with a return tells no level, the water around it does.

    Returns
    -------
    (n,) int64
        [quanta]; the same for all returns of a cell.
    """
    level = np.empty(len(z), np.int64)
    if len(z):
        cells = _by_cell(x, y, z)
        tops = _tops(z[cells.order], cells.start)
        around = _median_around(tops, cells.place, beyond=beyond)
        level[cells.order] = np.repeat(around, np.diff(cells.start))
    return level


def _by_cell(x: Heights, y: Heights, z: Heights) -> _Cells:
    edge = quanta(CELL_M)
    i, j = cell_index(x, edge), cell_index(y, edge)
    order = np.lexsort((-z, i, j))
    i, j = i[order], j[order]
    first = np.flatnonzero(np.diff(i, prepend=i[0] - 1) | np.diff(j, prepend=j[0]))
    return _Cells(order, np.append(first, len(z)), (i[first], j[first]))


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
    alike = np.count_nonzero(np.abs(beside - tops[:, None]) <= quanta(AGREE_M), axis=1) - 1
    others = np.count_nonzero(~np.isnan(beside), axis=1) - 1
    agreed = np.where(3 * alike >= others, tops, np.nan)
    near = around(agreed, REACH_CELLS, water)
    if beyond:
        alone = np.isnan(near).all(axis=1)
        near[alone] = around(agreed, REACH_CELLS, np.ones_like(water))[alone]
    near = np.sort(near, axis=1)
    known = np.count_nonzero(~np.isnan(near), axis=1)  # NaN comes last
    middle = near[np.arange(len(tops)), np.maximum(known - 1, 0) // 2]
    return np.where(known > 0, middle, _NOWHERE).astype(np.int64)
