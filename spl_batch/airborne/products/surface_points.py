"""Points that surfaces rest on: for the ground filter, and for the rasters.

Domain: space. Runs on the points of a ground cell with its margin, once the filter has judged them.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.filter.stray_returns import stray
from spl_batch.airborne.ground.water_level import off_surface
from spl_batch.airborne.products import surface_rasters
from spl_batch.constants import NOISE_NOT_ASSESSED, NOISE_SIGNAL
from spl_batch.lattice.tables import PointFlag, PointTable

DOMAIN: Final = "space"


def holds_ground(table: PointTable) -> NDArray[np.bool_]:
    """Signal that the ground may rest on: (n,) bool.

    Parameters
    ----------
    table : PointTable
        ``x, y, z, flags, noise_class``.
    """
    usable: NDArray[np.bool_] = table["noise_class"] == NOISE_SIGNAL
    usable = usable & ~table.has(PointFlag.OUTSIDE_AOI) & ~stray(table)
    return usable & ~off_surface(table, usable)


def makes_surfaces(table: PointTable) -> PointTable:
    """Points that a raster may rest on, or that say how much noise there is.

    A point that no unit has labelled, or that lies outside the area, is none.

    Parameters
    ----------
    table : PointTable
        ``x, y, z, flags, noise_class, ground``, and what intensity is made of where it is there.
    """
    known = (table["noise_class"] != NOISE_NOT_ASSESSED) | table.has(PointFlag.NO_BEAM)
    stands = ~stray(table, spare_above=True)
    optional = (*surface_rasters.COLUMNS_OF_INTENSITY, "afterpulse")
    also = [name for name in optional if name in table]
    return table.select((*surface_rasters.COLUMNS_NEEDED, *also)).take(
        known & ~table.has(PointFlag.OUTSIDE_AOI) & stands
    )
