"""Multi-level filter [W17 3.2.4, after Swatantran et al. 2016].

Domain: space. First the fullest height bin of 30 m and the two beside it stay, 90 m in all. Then a
point stays if its voxel of 3 m and the 26 around it hold 30 points; then the same with voxels of
1 m and a lower number. Each level counts what the one before left, the point itself included.

The source says neither over which area the fullest bin is sought, nor the last level's number: both
are settings with defaults of ours. Bins, squares and voxels lie on absolute grids. Of equally full
bins the lowest counts.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.filter.filter_interface import Cloud, Verdict, without_p
from spl_batch.airborne.filter.published.voxel_counts import (
    lattice_index,
    squares,
    voxelise,
    window_counts,
)
from spl_batch.airborne.settings import FilterSettings
from spl_batch.lattice.tiles import quanta

DOMAIN: Final = "space"


def reach_m(settings: FilterSettings) -> float:
    """How far the verdict on a point looks: the reaches of the three levels add up [m]."""
    levels = settings.multilevel
    return 2.0 * (levels.fine_voxel_m + levels.coarse_voxel_m) + levels.column_m


def judge(cloud: Cloud, settings: FilterSettings) -> Verdict:
    """Decide about the points asked for; there is no p-value."""
    levels = settings.multilevel
    left = _near_fullest_bin(cloud, quanta(levels.column_m), quanta(levels.bin_m))
    left = _in_company(cloud, left, levels.coarse_voxel_m, levels.coarse_count)
    left = _in_company(cloud, left, levels.fine_voxel_m, levels.fine_count)
    signal = np.zeros(len(cloud.xyz), dtype=np.bool_)
    signal[left] = True
    return without_p(signal[cloud.asked])


def _near_fullest_bin(cloud: Cloud, side: int, height: int) -> NDArray[np.intp]:
    """Rows in the fullest height bin of their square, or beside it."""
    if not len(cloud.xyz):
        return np.zeros(0, dtype=np.intp)
    square = squares(cloud.xyz, cloud.anchor, side)
    level = lattice_index(cloud.xyz[:, 2], cloud.anchor[2], height)
    levels = int(level.max()) + 1
    count = np.bincount(square * levels + level, minlength=(int(square.max()) + 1) * levels)
    fullest = np.argmax(count.reshape(-1, levels), axis=1)
    return np.flatnonzero(np.abs(level - fullest[square]) <= 1)


def _in_company(
    cloud: Cloud, rows: NDArray[np.intp], edge_m: float, least: int
) -> NDArray[np.intp]:
    """Those rows whose 27 voxels hold enough of them."""
    if not len(rows):
        return rows
    edge = quanta(edge_m)
    voxels = voxelise(cloud.xyz[rows], cloud.anchor, (edge, edge, edge))
    return rows[window_counts(voxels)[voxels.of_point] >= least]
