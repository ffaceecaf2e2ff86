"""Water surfaces: what of a water polygon's returns may carry a terrain model.

Domain: space. Afterpulses of a water surface and returns of its bottom lie below it and are
kept as points; a terrain model of water is its surface.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.model import PointFlag, PointTable
from spl_batch.tiling import cell_index, quanta

DOMAIN: Final = "space"

CELL_M: Final = 5.0
"""Edge of the absolute cells in which the level of the water is taken [m]."""

BELOW_M: Final = 0.25
"""Returns farther below the level are no surface: five ranging spreads [m]."""


def submerged(table: PointTable, usable: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Returns in water polygons that lie below the water's surface.

    The level of a cell is the median height of its usable returns: most of what water
    sends back comes from its surface.

    Parameters
    ----------
    table : PointTable
        Points with ``x, y, z, flags``.
    usable : (n,) bool
        Signal; the level is taken from these.

    Returns
    -------
    (n,) bool
    """
    out = np.zeros(len(table), np.bool_)
    water = np.flatnonzero(usable & table.has(PointFlag.WATER))
    if not len(water):
        return out
    z = table["z"][water].astype(np.int64)
    edge = quanta(CELL_M)
    i, j = cell_index(table["x"][water], edge), cell_index(table["y"][water], edge)
    order = np.lexsort((z, i, j))
    i, j, z = i[order], j[order], z[order]
    starts = np.concatenate([[0], np.flatnonzero((np.diff(i) != 0) | (np.diff(j) != 0)) + 1])
    counts = np.diff(np.append(starts, len(z)))
    level = np.repeat(z[starts + counts // 2], counts)
    out[water[order]] = z < level - quanta(BELOW_M)
    return out
