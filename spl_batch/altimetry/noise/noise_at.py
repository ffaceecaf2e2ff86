"""Noise density at places of a track.

It is told by depth below a water surface, by height in a cloud, and by cell elsewhere.
"""

import numpy as np
from numpy.typing import NDArray

from spl_batch.altimetry.noise.fog import fog_at
from spl_batch.altimetry.photon_table import Scale
from spl_batch.altimetry.water.level_water import DEPTHS, NO_WATER, REACH_CELLS, SURFACE_M
from spl_batch.constants import QUANTA_PER_M

_SURFACE_Q = round(SURFACE_M * QUANTA_PER_M)


def below_surface(
    cell: NDArray[np.intp], height: NDArray[np.int32], scale: Scale
) -> NDArray[np.bool_]:
    """Photons below a water surface and its waves, (n,) bool."""
    level = scale.level[cell].astype(np.int64)
    below: NDArray[np.bool_] = (level != NO_WATER) & (level - height > _SURFACE_Q)
    return below


def in_fog(cell: NDArray[np.intp], height: NDArray[np.int32], scale: Scale) -> NDArray[np.bool_]:
    """Photons in a cloud, (n,) bool."""
    cloud: NDArray[np.bool_] = fog_at(cell, height, scale.fog_low, scale.fog) > 0.0
    return cloud


def noise_at(
    cell: NDArray[np.intp], height: NDArray[np.int32], scale: Scale
) -> NDArray[np.float64]:
    """Noise density that photons are scored by, (n,) float64 [1/m2].

    A water surface and its waves count as the metre below them: what is left of the surface there
    is no signal of its own.
    """
    depth = scale.level[cell].astype(np.int64) - height - _SURFACE_Q
    wet = (scale.level[cell] != NO_WATER) & (depth >= -2 * _SURFACE_Q)
    row = np.clip(depth // QUANTA_PER_M, 0, DEPTHS - 1)
    sky = np.maximum(scale.density[cell], fog_at(cell, height, scale.fog_low, scale.fog))
    found: NDArray[np.float64] = np.where(wet, scale.column[cell, np.where(wet, row, 0)], sky)
    return found


def noise_told(
    cell: NDArray[np.intp], height: NDArray[np.int32], scale: Scale
) -> NDArray[np.float64]:
    """Noise density that a reader is told of, (n,) float64 [1/m2].

    Above a water surface it is that of the sky, and in the first metre below it that metre's own.
    """
    depth = scale.top[cell].astype(np.int64) - height
    within = (scale.level[cell] != NO_WATER) & (np.abs(depth) <= _SURFACE_Q)
    near = np.where(depth < 0, scale.density[cell], scale.first[cell])
    found: NDArray[np.float64] = np.where(within, near, noise_at(cell, height, scale))
    return found


def local_column(
    index: NDArray[np.int64],
    level: NDArray[np.int32],
    column: NDArray[np.float32],
    density: NDArray[np.float64],
) -> NDArray[np.float32]:
    """Noise by depth of each cell: what a kilometre shows, with the sky's noise of the cell.

    By day the sky's noise reaches below the surface too and varies as fast as above it. What the
    water adds is counted over a kilometre; what is less than the sky's is a share of it.

    Parameters
    ----------
    index, level, column : (n,) int64, (n,) int32, (n, DEPTHS) float32
        Cells, and their water as of :class:`Water`.
    density : (n,) float64
        Noise above the surface [1/m2].
    """
    wet = np.flatnonzero(level != NO_WATER)
    local = column.copy()
    total = np.concatenate([[0.0], np.cumsum(density[wet])])
    first = np.searchsorted(index[wet], index[wet] - REACH_CELLS)
    stop = np.searchsorted(index[wet], index[wet] + REACH_CELLS, side="right")
    sky = ((total[stop] - total[first]) / (stop - first))[:, None]
    share = np.minimum(column[wet] / np.maximum(sky, 1e-12), 1.0)
    local[wet] = np.maximum(column[wet] - sky, 0.0) + share * density[wet][:, None]
    return local
