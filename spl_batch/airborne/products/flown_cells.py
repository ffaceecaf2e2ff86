"""Which raster cells of a ground cell were flown.

Light comes back from everywhere that was flown, be it noise. A cell was flown that holds a
return of any kind, or lies in a gap between such cells no wider than twice
``products.void_max_m`` (a closing: it does not grow outwards). Only returns about as high as the
ground around count: beams lean, so that off the edge of a swath there is noise far above and
below ground that no beamlet met.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from spl_batch.airborne.settings import ProductSettings
from spl_batch.lattice.tables import PointTable
from spl_batch.lattice.tiles import Bounds, grow, inside, quanta

NEAR_GROUND_M: Final = 10.0
"""Returns so far above the highest and below the lowest ground around count: a beam that leans
by 15 degrees is 3 m off there [m]."""


def flown(
    table: PointTable, cell: Bounds, settings: ProductSettings, margin: int
) -> NDArray[np.bool_]:
    """Raster cells that were flown, from the south: (rows, cols) bool.

    Parameters
    ----------
    table : PointTable
        Points of the cell and around it, in any order, with ``x, y, z, ground``.
    cell : Bounds
        The ground cell [quanta].
    margin : int
        Raster cells around it of which all points are there; at least those of two voids [count].
    """
    size = quanta(settings.cell_m)
    wide = grow(cell, margin * size)
    shape = (wide.ymax - wide.ymin) // size, (wide.xmax - wide.xmin) // size
    there = about_ground(table, wide)
    held = np.zeros(shape, np.bool_)
    held[(table["y"][there] - wide.ymin) // size, (table["x"][there] - wide.xmin) // size] = True
    closed = close(held, quanta(settings.void_max_m) // size)
    return closed[margin : shape[0] - margin, margin : shape[1] - margin]


def about_ground(table: PointTable, region: Bounds) -> NDArray[np.bool_]:
    """Returns of a region that lie about as high as its ground: (n,) bool.

    Parameters
    ----------
    table : PointTable
        Points in any order, with ``x, y, z, ground``.
    region : Bounds
        Where [quanta]; without ground in it all returns count.
    """
    there = inside(table["x"], table["y"], region)
    ground = there & (table["ground"] == 1)
    if ground.any():
        z, near = table["z"], quanta(NEAR_GROUND_M)
        there &= (z >= z[ground].min() - near) & (z <= z[ground].max() + near)
    return there


def close(held: NDArray[np.bool_], reach: int) -> NDArray[np.bool_]:
    """Held cells, and gaps between them that no disc of this radius fits into [cells].

    Parameters
    ----------
    held : (rows, cols) bool
        Cells; beyond the edge nothing is known, and cells there end no gap.
    reach : int
        Radius of the disc [cells].

    Returns
    -------
    (rows, cols) bool
    """
    if not held.any():
        return held
    near = distance_transform_edt(~held) <= reach
    if near.all():
        return np.ones_like(held)
    closed: NDArray[np.bool_] = held | (distance_transform_edt(near) > reach)
    return closed
