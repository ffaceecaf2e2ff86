"""Voxels as full as their surroundings' mean [W17 5.4, after Tang et al. 2016].

Domain: space. Voxels of 3 m x 3 m x 0.3 m; one with fewer points than the mean is noise.

The source says that "the threshold for noise removal was the mean point density" and not over which
voxels. Here it is the mean count of the *occupied* voxels in the same square of an absolute grid:
over all of them it would be below one point and remove nothing, and a label may not depend on what
lies far away.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.filter.filter_interface import Cloud, Verdict, without_p
from spl_batch.airborne.filter.published.voxel_counts import squares, voxelise
from spl_batch.airborne.settings import FilterSettings
from spl_batch.lattice.tiles import quanta

DOMAIN: Final = "space"


def reach_m(settings: FilterSettings) -> float:
    """How far the verdict on a point looks: its square, and voxels that stick out of it [m]."""
    return settings.voxel.column_m + settings.voxel.edge_m


def judge(cloud: Cloud, settings: FilterSettings) -> Verdict:
    """Decide about the points asked for; there is no p-value."""
    if not len(cloud.xyz):
        return without_p(np.zeros(0, dtype=np.bool_))
    voxel = settings.voxel
    edges = (quanta(voxel.edge_m), quanta(voxel.edge_m), quanta(voxel.height_m))
    voxels = voxelise(cloud.xyz, cloud.anchor, edges)
    square = _square(cloud, edges, quanta(voxel.column_m), voxels.of_point)
    occupied = np.bincount(square)
    points = np.bincount(square, weights=voxels.points).astype(np.int64)
    full = voxels.points * occupied[square] >= points[square]
    return without_p(full[voxels.of_point[cloud.asked]])


def _square(
    cloud: Cloud, edges: tuple[int, int, int], side: int, of_point: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Square that holds each voxel's lower corner: (m,) int64."""
    corner = np.zeros((int(of_point.max()) + 1, 3), dtype=np.int64)
    for axis in range(2):
        at = cloud.xyz[:, axis] + np.int64(cloud.anchor[axis])
        corner[of_point, axis] = at // edges[axis] * edges[axis]
    low = corner.min(axis=0)
    return squares((corner - low).astype(np.int32), (int(low[0]), int(low[1]), 0), side)
