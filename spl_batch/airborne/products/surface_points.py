"""Points that surfaces rest on: for the ground filter, and for the rasters.

Domain: space. Runs on the points of a ground cell with its margin, once the filter has judged them.
"""

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.filter.drowned_surfaces import lonely
from spl_batch.airborne.filter.stray_returns import Bare, bare_cells, stray
from spl_batch.airborne.ground.water.off_water import off_surface
from spl_batch.airborne.products import surface_rasters
from spl_batch.constants import NOISE_NOT_ASSESSED, NOISE_SIGNAL
from spl_batch.lattice.tables import PointFlag, PointTable


def holds_ground(table: PointTable, bare: Bare | None = None) -> NDArray[np.bool_]:
    """Signal that the ground may rest on: (n,) bool; all points of a cell are at hand.

    ``bare``: where signals of the cell are stray; found from these points without.
    """
    usable = stands(table, bare_cells(table) if bare is None else bare)
    return usable & ~off_surface(table, usable)


def stands(table: PointTable, bare: Bare | None) -> NDArray[np.bool_]:
    """Signal that is not stray, where it lies in water too: (n,) bool."""
    usable: NDArray[np.bool_] = table["noise_class"] == NOISE_SIGNAL
    usable = usable & ~table.has(PointFlag.OUTSIDE_AOI)
    if bare is not None:
        usable &= ~bare.holds(table["noise_class"])
        usable &= ~lonely(table, usable, bare.noise(len(table)))
    return usable


def makes_surfaces(table: PointTable) -> PointTable:
    """Points that a raster may rest on, or that show what was flown.

    A point that no unit has labelled, or that lies outside the area, is none.
    """
    chosen = known(table)
    chosen &= ~stray(table, spare_above=True)
    also = [name for name in surface_rasters.OPTIONAL if name in table]
    return table.select((*surface_rasters.COLUMNS_NEEDED, *also)).take(chosen)


def known(table: PointTable) -> NDArray[np.bool_]:
    """Points of the area that a unit has labelled or that have no beam: (n,) bool."""
    labelled: NDArray[np.bool_] = table["noise_class"] != NOISE_NOT_ASSESSED
    return (labelled | table.has(PointFlag.NO_BEAM)) & ~table.has(PointFlag.OUTSIDE_AOI)
