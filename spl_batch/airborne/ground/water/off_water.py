"""What of a water polygon's returns may carry a terrain model.

Domain: space. What lies below the water's level (:mod:`~spl_batch.airborne.ground.water.level`)
does not. What stands above it is kept noise, a boat, a deck, or land that the polygon wrongly
holds: an island or a bank. Land and decks are dense: of an absolute cell of 2.5 m at least
:data:`TOP_COUNT` returns, and :data:`TOP_SHARE` of all, lie within :data:`LAYER_M` of a return of
theirs. And they go on: such layers of neighbouring cells hang together over :data:`PATCH_CELLS`
cells or more, those of the land around among them. Only that is left to the ground filter, which
cuts decks off. Noise between a deck and the water is not dense beside the deck.

A cell's level and its layers are its own, and few: the returns of a place may come part by part.
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
    Levels,
    in_water,
)
from spl_batch.lattice.tables import PointFlag, PointTable
from spl_batch.lattice.tiles import cell_index, quanta

DOMAIN: Final = "space"

LAND_CELL_M: Final = 2.5
"""Edge of the absolute cells in which land is dense [m]; whole ones make up one of a level."""

PATCH_CELLS: Final = 9
"""Cells over which land hangs together: those that a boat of 5 m may touch [count]."""

NEAR_CELLS: Final = -int(-PATCH_CELLS * LAND_CELL_M // CELL_M)
"""Cells of the level around water in which such land lies [count]."""

NO_LAYER: Final = -1

PART_STEP_M: Final = CELL_M
"""Parts of a place are cut at multiples of this [m]."""


class Doubtful(NamedTuple):
    """Returns of a part in water, and off its surface."""

    rows: NDArray[np.intp]  #: (n,): which rows of the part.
    #: (n,): number of the layer that each stands in; :data:`NO_LAYER` if in none, or below.
    layer: NDArray[np.int32]


class _Layers(NamedTuple):
    """Dense layers of cells."""

    column: Heights  #: (m,): number of the cell along x.
    row: Heights  #: (m,): and along y.
    low: Heights  #: (m,): lowest return [quanta].
    high: Heights  #: (m,): highest one [quanta].


class OffWater:
    """Returns in water polygons that no terrain may rest on, of a place that comes part by part.

    Parts are cut at multiples of :data:`PART_STEP_M` and come in the same order each time. All are
    to be looked at (:meth:`look`) before the first is judged, and all to be judged before it is
    known of any what is :meth:`off`.
    """

    def __init__(self) -> None:
        self._levels = Levels()
        self._layers: list[_Layers] = []
        self._count = 0
        self._wide: NDArray[np.bool_] | None = None

    def look(self, table: PointTable, usable: NDArray[np.bool_]) -> None:
        """Take in the water of a part: of points with ``x, y, z, flags`` those that are usable."""
        self._levels.look(*in_water(table, usable)[1])

    @property
    def seen(self) -> bool:
        """Whether there is any water."""
        return self._levels.seen

    def judge(self, table: PointTable, usable: NDArray[np.bool_]) -> Doubtful:
        """What of a part lies off the water's surface, and the layers that it stands in."""
        water, (x, y, z) = in_water(table, usable)
        level = self._levels.at(x, y) if len(z) else z
        below = water[z < level - quanta(NEAR_M)]
        above = water[(z > level + quanta(NEAR_M)) & (level > NOWHERE)]
        stands = usable & ~table.has(PointFlag.WATER)
        stands[above] = True
        layer = self._layer(table, usable, stands)[above]
        nothing = np.full(len(below), NO_LAYER, np.int32)
        return Doubtful(np.concatenate([below, above]), np.concatenate([nothing, layer]))

    def off(self, layer: NDArray[np.int32]) -> NDArray[np.bool_]:
        """Whether returns in these layers are neither at the water's surface nor land: (n,)."""
        if self._wide is None:
            self._wide = _wide(self._layers)
        out = np.ones(len(layer), np.bool_)
        known = layer != NO_LAYER
        out[known] = ~self._wide[layer[known]]
        return out

    def _layer(
        self, table: PointTable, usable: NDArray[np.bool_], stands: NDArray[np.bool_]
    ) -> NDArray[np.int32]:
        """Number of the dense layer that each return belongs to, near water: (n,).

        ``usable``: (n,) bool, signal, which layers must be a share of. ``stands``: (n,) bool, what
        layers are made of: the land around the water, and what stands above it.
        """
        out = np.full(len(table), NO_LAYER, np.int32)
        near = np.flatnonzero(usable)
        near = near[self._levels.near(table["x"][near], table["y"][near], NEAR_CELLS)]
        if not len(near):
            return out
        edge = quanta(LAND_CELL_M)
        i, j = (cell_index(table[axis][near].astype(np.int64), edge) for axis in "xy")
        west, south, rows = int(i.min()), int(j.min()), int(np.ptp(j)) + 1
        cell = (i - west) * rows + (j - south)
        del i, j
        total, standing = np.bincount(cell), stands[near]
        near, cell = near[standing], cell[standing]
        order = np.lexsort((table["z"][near], cell))
        near, cell = near[order], cell[order]
        z = table["z"][near].astype(np.int64)
        dense, layer = _dense(cell, z, total)
        if not len(layer):
            return out
        starts = np.flatnonzero(np.diff(layer, prepend=NO_LAYER))
        ends = np.flatnonzero(np.diff(layer, append=len(starts)))
        cell, z = cell[dense], z[dense]
        column, along = np.divmod(cell[starts], rows)
        self._layers.append(_Layers(column + west, along + south, z[starts], z[ends]))
        out[near[dense]] = layer + self._count
        self._count += len(starts)
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


def off_surface(table: PointTable, usable: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Returns in water polygons that no terrain may rest on.

    Parameters
    ----------
    table : PointTable
        All points of a place with ``x, y, z, flags``.
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
    waters = OffWater()
    waters.look(table, usable)
    found = waters.judge(table, usable)
    out[found.rows] = waters.off(found.layer)
    return out


def _wide(found: list[_Layers]) -> NDArray[np.bool_]:
    """Which layers hang together with others over enough cells: (m,) bool."""
    if not found:
        return np.zeros(0, np.bool_)
    layers = _Layers(*(np.concatenate(parts) for parts in zip(*found, strict=True)))
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
