"""What of a water polygon's returns may carry a terrain model.

Domain: space. What lies below the water's level (:mod:`~spl_batch.airborne.ground.water.level`)
does not. What stands above it is kept noise, a boat, a deck, or land that the polygon wrongly
holds: an island or a bank. Land and decks are dense: of an absolute cell of 2.5 m at least
:data:`TOP_COUNT` returns, and :data:`TOP_SHARE` of all, lie within :data:`LAYER_M` of a return of
theirs. And they go on: such layers of neighbouring cells hang together over :data:`PATCH_CELLS`
cells or more, those of the land around among them. Only that is left to the ground filter, which
cuts decks off. Noise between a deck and the water is not dense beside the deck.
"""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from spl_batch.airborne.ground.water.level import (
    CELL_M,
    LAYER_M,
    NEAR_M,
    NOWHERE,
    TOP_COUNT,
    TOP_SHARE,
    Heights,
    in_water,
    water_levels,
)
from spl_batch.lattice.tables import PointFlag, PointTable
from spl_batch.lattice.tiles import cell_index, quanta

LAND_CELL_M: Final = CELL_M / 2
"""Edge of the absolute cells in which land is dense [m]."""

PATCH_CELLS: Final = round(CELL_M / LAND_CELL_M + 1) ** 2
"""Cells over which land hangs together: those that a boat as long as a cell of the level may touch
[count]."""

NEAR_CELLS: Final = -int(-PATCH_CELLS * LAND_CELL_M // CELL_M)
"""Cells of the level around water in which such land lies [count]."""


class _Layers(NamedTuple):
    """Dense layers of cells."""

    column: Heights  #: (m,): number of the cell along x.
    row: Heights  #: (m,): and along y.
    low: Heights  #: (m,): lowest return [quanta].
    high: Heights  #: (m,): highest one [quanta].


def off_surface(table: PointTable, usable: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Returns in water polygons that no terrain may rest on.

    Parameters
    ----------
    table : PointTable
        All points of a cell with ``x, y, z, flags``.
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
    water, (x, y, z) = in_water(table, usable)
    if not len(z):
        return out
    levels = water_levels(x, y, z)
    level = levels.at(x, y)
    above = water[(z > level + quanta(NEAR_M)) & (level > NOWHERE)]
    out[water[z < level - quanta(NEAR_M)]] = True
    stands = usable & ~table.has(PointFlag.WATER)
    stands[above] = True
    near = np.flatnonzero(usable)
    near = near[levels.near(table["x"][near], table["y"][near], NEAR_CELLS)]
    out[above] = ~_land(table, near, stands)[above]
    return out


def _land(
    table: PointTable, near: NDArray[np.intp], stands: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Returns of dense layers that are as wide as land: (n,) bool.

    ``near``: signal, which layers must be a share of. ``stands``: (n,) bool, what layers are made
    of: the land around the water, and what stands above it.
    """
    out = np.zeros(len(table), np.bool_)
    edge = quanta(LAND_CELL_M)
    i, j = (cell_index(table[axis][near].astype(np.int64), edge) for axis in "xy")
    rows = int(np.ptp(j)) + 1
    cell = (i - i.min()) * rows + (j - j.min())
    total, standing = np.bincount(cell), stands[near]
    near, cell = near[standing], cell[standing]
    order = np.lexsort((table["z"][near], cell))
    near, cell = near[order], cell[order]
    z = table["z"][near].astype(np.int64)
    dense, layer = _dense(cell, z, total)
    if len(layer):
        starts = np.flatnonzero(np.diff(layer, prepend=-1))
        ends = np.flatnonzero(np.diff(layer, append=len(starts)))
        cell, z = cell[dense], z[dense]
        column, row = np.divmod(cell[starts], rows)
        out[near[dense]] = _wide(_Layers(column, row, z[starts], z[ends]))[layer]
    return out


def _dense(
    cell: Heights, z: Heights, total: NDArray[np.intp]
) -> tuple[NDArray[np.bool_], NDArray[np.int64]]:
    """Which returns are dense, (n,) bool, and the layer of each of these, from 0 on: (m,).

    Parameters
    ----------
    cell, z : (n,) int64
        Number of the cell of each return, and its height [quanta], by cell and rising in it.
    total : (cells,) intp
        Returns of each cell that a layer must be a share of [count].
    """
    # One rising sequence of heights: those of different cells are farther apart than any layer.
    thick = quanta(LAYER_M)
    climbing = cell * (int(z.max(initial=0) - z.min(initial=0)) + 3 * thick) + z
    held = np.searchsorted(climbing, climbing + thick, side="right")
    held -= np.searchsorted(climbing, climbing - thick, side="left")
    dense: NDArray[np.bool_] = held >= np.maximum(TOP_COUNT, np.ceil(TOP_SHARE * total[cell]))
    climbing = climbing[dense]
    return dense, np.cumsum(np.diff(climbing, prepend=climbing[:1]) > thick)


def _wide(layers: _Layers) -> NDArray[np.bool_]:
    """Which layers hang together with others over enough cells: (m,) bool."""
    # Numbers rise along a column; one that no cell has parts it from the next.
    column = int(np.ptp(layers.row)) + 2
    cell = (layers.column - layers.column.min()) * column + layers.row - layers.row.min()
    order, half = np.argsort(cell, kind="stable"), quanta(LAYER_M) // 2
    wide = np.empty(len(cell), np.bool_)
    wide[order] = _hang_together(
        cell[order], layers.low[order] - half, layers.high[order] + half, column
    )
    return wide


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
