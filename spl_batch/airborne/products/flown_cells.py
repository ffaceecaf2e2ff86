"""Raster cells of a ground cell that were flown.

Light comes back from everywhere that was flown, if only as noise. A cell was flown if it holds a
return of any kind, or lies in a gap between such cells no wider than twice ``products.void_max_m``
(a closing: it does not grow outwards). Only returns about as high as the ground around count: beams
lean, and off the edge of a swath noise lies far above and below ground that no beamlet met.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import convolve

from spl_batch.airborne.products.cell_values import cell_number, held, shape_of
from spl_batch.airborne.settings import ProductSettings
from spl_batch.lattice.tables import PointTable
from spl_batch.lattice.tiles import Bounds, grow, inside, quanta
from spl_batch.numerics.nearest_cells import distances
from spl_batch.numerics.nearest_heights import NEAREST
from spl_batch.numerics.neighbours.point_grid import PointGrid

NEAR_GROUND_M: Final = 10.0
"""How far above or below the ground around a return counts [m]: a beam that leans by 15 degrees is
3 m off there. Half moves 96 + 32 cells of the density, twice 574 + 405 cells of the density."""


def about_ground(
    table: PointTable, region: Bounds, ground: NDArray[np.float64], size: int
) -> NDArray[np.bool_]:
    """Returns of a region that lie about as high as the ground around: (n,) bool.

    The ground around is the median of the :data:`NEAREST` raster cells with ground that are nearest
    to the return's: where noise is taken for ground beyond the edge of a swath, it is one or two.
    Amid cells with ground light has met it at any height.

    ``ground``: (m, 3), mean places of raster cells with ground, from the region's corner; without
    any all returns count. ``size``: edge of a raster cell [quanta].
    """
    there = inside(table["x"], table["y"], region)
    if not len(ground):
        return there
    rows, columns = np.flatnonzero(there), shape_of(region, size)[1]
    number = cell_number(table.select(("x", "y")).take(rows), region, size)
    beside = np.zeros(shape_of(region, size), np.int64)
    beside[tuple((ground[:, 1::-1] // size).astype(np.int64).T)] = 1
    amid = convolve(beside, np.ones((3, 3), np.int64), mode="constant") >= NEAREST
    asked = ~amid.ravel()[number]
    cells, of_cell = np.unique(number[asked], return_inverse=True)
    centres = (np.column_stack([cells % columns, cells // columns]) + 0.5) * size
    nearest = PointGrid.of(ground).nearest(centres, min(NEAREST, len(ground)))
    height = np.median(ground[nearest, 2], axis=1)[of_cell]
    rows = rows[asked]
    there[rows] = np.abs(table["z"][rows] - height) <= quanta(NEAR_GROUND_M)
    return there


def covered_cells(
    x: NDArray[np.int64], y: NDArray[np.int64], core: Bounds, settings: ProductSettings
) -> NDArray[np.bool_]:
    """Raster cells of a ground cell that returns cover, row 0 southernmost: (rows, columns) bool.

    ``x, y``: returns of the cell and of twice ``products.void_max_m`` around it [quanta].
    """
    size = quanta(settings.cell_m)
    reach = quanta(settings.void_max_m) // size
    rim = 2 * reach + 1
    cells = Bounds(*(side // size for side in grow(core, rim * size)))
    return close(held(x, y, cells, size), reach)[rim:-rim, rim:-rim]


def close(cells: NDArray[np.bool_], reach: int) -> NDArray[np.bool_]:
    """Held cells, and gaps between them that no disc of this radius fits into [cells].

    Beyond the edge nothing is known, and cells there end no gap.
    """
    if not cells.any():
        return cells
    near = distances(cells) <= reach
    if near.all():
        return np.ones_like(cells)
    closed: NDArray[np.bool_] = cells | (distances(~near) > reach)
    return closed
