"""Adaptive ellipsoid searching, the first form [W17 5.2; Eq. 5.4-5.6].

Domain: space. First the N_tot points with the least quotient of neighbours in a sphere and expected
noise density are noise, N_tot being the noise that is expected. Then the rest are examined among
themselves: noise where the count in the adaptive ellipsoid is below 20 % of that in the sphere.

Deviations. The source takes N_tot over its whole data set, from a region without signal [W17 Eq.
4.1]. Here points compete within squares of an absolute grid; N_tot is the voxel-spherical density
times the volume of the cubes that hold points, and points that tie with the N_tot-th go with it.
The density is the mean of the point's voxel, silent parts included; the source takes the one at the
top of the beamlet. All flightlines are judged together. A point with no other in its sphere is
noise. Floor and caps of the ellipsoid are those of
:mod:`~spl_batch.airborne.filter.ellipsoid.ellipsoid_counts`.
"""

from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.filter.ellipsoid.ellipsoid_ratio import passes_ratio
from spl_batch.airborne.filter.ellipsoid.ellipsoid_shape import Shape
from spl_batch.airborne.filter.filter_interface import Cloud, Verdict, without_p
from spl_batch.airborne.filter.published.neighbour_volumes import sphere_counts
from spl_batch.airborne.filter.published.voxel_counts import squares, voxelise
from spl_batch.airborne.settings import FilterSettings
from spl_batch.constants import QUANTA_PER_M
from spl_batch.lattice.tiles import quanta
from spl_batch.numerics.neighbours.kdtree import build

DOMAIN: Final = "space"


def reach_m(settings: FilterSettings) -> float:
    """How far the verdict on a point looks [m].

    The ellipsoid's neighbours must have passed the first step. It looks at a whole square, all of
    whose points look one sphere farther.
    """
    second = max(settings.neighbour_cap_m, settings.axis_cap_m, settings.aes.radius_m)
    return second + settings.aes.square * settings.aes.voxel_m + settings.aes.radius_m


def judge(cloud: Cloud, settings: FilterSettings) -> Verdict:
    """Decide about the points asked for; there is no p-value."""
    aes = settings.aes
    crowded = np.flatnonzero(~_least_crowded(cloud, settings))
    xyz = np.ascontiguousarray(cloud.xyz[crowded])
    shape = Shape(
        neighbours=aes.neighbours,
        radius=float(quanta(aes.radius_m)),
        floor=float(quanta(settings.eigen_floor_m)),
        axis_cap=float(quanta(settings.axis_cap_m)),
        neighbour_cap=quanta(settings.neighbour_cap_m),
        power=1.0 if settings.axis_power == "eigenvalue" else 0.5,
    )
    signal = np.zeros(len(cloud.xyz), dtype=np.bool_)
    signal[crowded] = passes_ratio(xyz, build(xyz), cloud.asked[crowded], shape, aes.ratio_min)
    return without_p(signal[cloud.asked])


def _least_crowded(cloud: Cloud, settings: FilterSettings) -> NDArray[np.bool_]:
    """Points with the least quotients of their square, as many as noise is expected: (n,) bool."""
    aes = settings.aes
    noise = np.zeros(len(cloud.xyz), dtype=np.bool_)
    if not len(noise):
        return noise
    # What takes most memory comes before what is kept beside it.
    square, wanted = _expected(cloud, settings)
    everything = np.ones(len(noise), dtype=np.bool_)
    count = sphere_counts(build(cloud.xyz), everything, quanta(aes.radius_m))
    with np.errstate(divide="ignore", invalid="ignore"):
        quotient = count / cloud.density
    quotient[cloud.density <= 0] = np.inf
    del count
    order = np.lexsort((quotient, square))
    starts = np.searchsorted(square[order], np.arange(len(wanted) + 1))
    for c, (first, last) in enumerate(pairwise(starts)):
        total = min(wanted[c], last - first)
        if total > 0:
            rows = order[first:last]
            noise[rows] = quotient[rows] <= quotient[rows[total - 1]]
    return noise & np.isfinite(quotient)


def _expected(
    cloud: Cloud, settings: FilterSettings
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Square of each point (n,), and the noise expected in each square [count], rounded."""
    aes = settings.aes
    edge = quanta(aes.voxel_m)
    square = squares(cloud.xyz, cloud.anchor, aes.square * edge)
    voxels = voxelise(cloud.xyz, cloud.anchor, (edge, edge, edge))
    mean = np.bincount(voxels.of_point, weights=cloud.density) / voxels.points
    owner = np.zeros(len(mean), dtype=np.int64)
    owner[voxels.of_point] = square
    total = np.bincount(owner, weights=mean) * (edge / QUANTA_PER_M) ** 3
    wanted: NDArray[np.int64] = np.rint(total).astype(np.int64)
    return square, wanted
