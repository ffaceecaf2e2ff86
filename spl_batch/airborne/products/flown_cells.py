"""Raster cells of a ground cell that were flown.

Light comes back from everywhere that was flown, if only as noise. A cell was flown if it holds a
return of any kind, or lies in a gap between such cells no wider than twice ``products.void_max_m``
(a closing: it does not grow outwards). Only returns about as high as the ground around count: beams
lean, and off the edge of a swath noise lies far above and below ground that no beamlet met.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.products.cell_values import held
from spl_batch.airborne.settings import ProductSettings
from spl_batch.lattice.tables import PointTable
from spl_batch.lattice.tiles import Bounds, grow, inside, quanta
from spl_batch.numerics.nearest_cells import within_discs

Heights = tuple[int, int]
"""Lowest and highest [quanta]."""

NEAR_GROUND_M: Final = 10.0
"""How far above the highest and below the lowest ground around a return counts [m]: a beam that
leans by 15 degrees is 3 m off there."""


def ground_heights(table: PointTable, region: Bounds) -> Heights | None:
    """Lowest and highest ground of a region [quanta]; None without any."""
    ground = table["z"][inside(table["x"], table["y"], region) & (table["ground"] == 1)]
    return (int(ground.min()), int(ground.max())) if len(ground) else None


def about_ground(table: PointTable, region: Bounds, ground: Heights | None) -> NDArray[np.bool_]:
    """Returns of a region that lie about as high as its ground: (n,) bool.

    ``ground``: what :func:`ground_heights` gave; without any all returns count.
    """
    there = inside(table["x"], table["y"], region)
    if ground is not None:
        z, near = table["z"], quanta(NEAR_GROUND_M)
        there &= (z >= ground[0] - near) & (z <= ground[1] + near)
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
    near = within_discs(cells, reach)
    if near.all():
        return np.ones_like(cells)
    closed: NDArray[np.bool_] = cells | ~within_discs(~near, reach)
    return closed
