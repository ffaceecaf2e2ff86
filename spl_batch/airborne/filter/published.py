"""Filters of the sources, beside our own: numpy and scipy on a cloud and its halo.

Each has a reach and a verdict on the points asked for; none has a p-value. All lattices lie on
absolute grids, so that a label does not depend on what lies far away. Filters of single shots are
in :mod:`~spl_batch.airborne.filter.shot_filters`.

- :func:`aes`: adaptive ellipsoid searching, the first form [W17 5.2; Eq. 5.4-5.6]. First the N_tot
  points with the least quotient of neighbours in a sphere and expected noise density are noise,
  N_tot being the noise that is expected; then points are noise where the count in the adaptive
  ellipsoid is below 20 % of that in the sphere. The source takes N_tot over its whole data set,
  from a region without signal [W17 Eq. 4.1]. Here points compete within squares of an absolute
  grid; N_tot is the voxel-spherical density times the volume of the cubes that hold points, and
  points that tie with the N_tot-th go with it. The density is the mean of the point's voxel, silent
  parts included; the source takes the one at the top of the beamlet. All flightlines are judged
  together. A point with no other in its sphere is noise.
- :func:`cylinder`: upright cylinder around each point [W17 3.2.2, Eq. 3.2, after Cossio 2009]. The
  points with a height difference below D1 / 2 and a squared horizontal distance below D2 are
  counted. The source gives neither D1, D2 nor the least count: the defaults are ours.
- :func:`multilevel`: [W17 3.2.4, after Swatantran et al. 2016]. First the fullest height bin of
  30 m and the two beside it stay. Then a point stays if its voxel of 3 m and the 26 around it hold
  30 points; then the same with voxels of 1 m and a lower number. Each level counts what the one
  before left, the point itself included. The source says neither over which area the fullest bin is
  sought, nor the last level's number: both are settings. Of equally full bins the lowest counts.
- :func:`voxel`: voxels of 3 m x 3 m x 0.3 m as full as their surroundings' mean [W17 5.4, after
  Tang et al. 2016]. The source says that "the threshold for noise removal was the mean point
  density" and not over which voxels. Here it is the mean count of the *occupied* voxels in the same
  square: over all of them it would be below one point and remove nothing.
"""

import math
from itertools import pairwise
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from spl_batch.airborne.filter.ellipsoid.ellipsoid_ratio import passes_ratio
from spl_batch.airborne.filter.ellipsoid.ellipsoid_shape import Shape
from spl_batch.airborne.filter.filter_interface import Cloud, Verdict, without_p
from spl_batch.airborne.settings import FilterSettings
from spl_batch.constants import QUANTA_PER_M
from spl_batch.lattice.tiles import quanta
from spl_batch.numerics.neighbours.kdtree import build

BATCH: Final = 1 << 14
"""Points whose neighbours are listed at once [count]."""


def aes_reach_m(settings: FilterSettings) -> float:
    """How far the verdict on a point looks [m].

    The ellipsoid's neighbours must have passed the first step. It looks at a whole square, all of
    whose points look one sphere farther.
    """
    second = max(settings.neighbour_cap_m, settings.axis_cap_m, settings.aes.radius_m)
    return second + settings.aes.square * settings.aes.voxel_m + settings.aes.radius_m


def aes(cloud: Cloud, settings: FilterSettings) -> Verdict:
    """Decide about the points asked for."""
    own = settings.aes
    crowded = np.flatnonzero(~_least_crowded(cloud, settings))
    xyz = np.ascontiguousarray(cloud.xyz[crowded])
    shape = Shape(
        neighbours=own.neighbours,
        radius=float(quanta(own.radius_m)),
        floor=float(quanta(settings.eigen_floor_m)),
        axis_cap=float(quanta(settings.axis_cap_m)),
        neighbour_cap=quanta(settings.neighbour_cap_m),
        power=1.0 if settings.axis_power == "eigenvalue" else 0.5,
    )
    signal = np.zeros(len(cloud.xyz), dtype=np.bool_)
    signal[crowded] = passes_ratio(xyz, build(xyz), cloud.asked[crowded], shape, own.ratio_min)
    return without_p(signal[cloud.asked])


def _least_crowded(cloud: Cloud, settings: FilterSettings) -> NDArray[np.bool_]:
    """Points with the least quotients of their square, as many as noise is expected: (n,) bool."""
    noise = np.zeros(len(cloud.xyz), dtype=np.bool_)
    if not len(noise):
        return noise
    # What takes most memory comes before what is kept beside it.
    square, wanted = _expected(cloud, settings)
    count = in_spheres(cKDTree(cloud.xyz), cloud.xyz, quanta(settings.aes.radius_m)) - 1
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
    edge = quanta(settings.aes.voxel_m)
    square = squares(cloud.xyz, cloud.anchor, settings.aes.square * edge)
    voxels = voxelise(cloud.xyz, cloud.anchor, (edge, edge, edge))
    mean = np.bincount(voxels.of_point, weights=cloud.density) / voxels.points
    owner = np.zeros(len(mean), dtype=np.int64)
    owner[voxels.of_point] = square
    total = np.bincount(owner, weights=mean) * (edge / QUANTA_PER_M) ** 3
    wanted: NDArray[np.int64] = np.rint(total).astype(np.int64)
    return square, wanted


def cylinder_reach_m(settings: FilterSettings) -> float:
    """How far the verdict on a point looks [m]."""
    return settings.cylinder.radius_m


def cylinder(cloud: Cloud, settings: FilterSettings) -> Verdict:
    """Decide about the points asked for."""
    own = settings.cylinder
    rows = np.flatnonzero(cloud.asked)
    radius, height = quanta(own.radius_m), quanta(own.height_m)
    enough = in_cylinders(cloud.xyz, rows, radius, height, own.count + 1)
    return without_p(enough)


def multilevel_reach_m(settings: FilterSettings) -> float:
    """How far the verdict on a point looks: the reaches of the three levels add up [m]."""
    levels = settings.multilevel
    return 2.0 * (levels.fine_voxel_m + levels.coarse_voxel_m) + levels.column_m


def multilevel(cloud: Cloud, settings: FilterSettings) -> Verdict:
    """Decide about the points asked for."""
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


def voxel_reach_m(settings: FilterSettings) -> float:
    """How far the verdict on a point looks: its square, and voxels that stick out of it [m]."""
    return settings.voxel.column_m + settings.voxel.edge_m


def voxel(cloud: Cloud, settings: FilterSettings) -> Verdict:
    """Decide about the points asked for."""
    if not len(cloud.xyz):
        return without_p(np.zeros(0, dtype=np.bool_))
    own = settings.voxel
    edges = (quanta(own.edge_m), quanta(own.edge_m), quanta(own.height_m))
    voxels = voxelise(cloud.xyz, cloud.anchor, edges)
    square = _square(cloud, edges, quanta(own.column_m), voxels.of_point)
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


class Voxels(NamedTuple):
    """Occupied voxels of a lattice, m of them."""

    key: NDArray[np.int64]  #: (m,): increasing; x, y and z index in one number.
    points: NDArray[np.int64]  #: (m,): points in each.
    of_point: NDArray[np.int64]  #: (n,): voxel of each point.
    stride: tuple[int, int]  #: Key steps along x and along y; along z it is one.


def lattice_index(
    values: NDArray[np.int32] | NDArray[np.int64], anchor: int, edge: int
) -> NDArray[np.int64]:
    """Index on a lattice that starts at absolute zero.

    Parameters
    ----------
    values : (n,) int
        Coordinates relative to ``anchor`` [quanta].
    anchor : int
        Their absolute origin [quanta].
    edge : int
        Edge of a cell [quanta], > 0.

    Returns
    -------
    (n,) int64
        Relative to the anchor's own cell, so >= 0 for values >= 0.
    """
    index: NDArray[np.int64] = (values.astype(np.int64) + anchor % edge) // edge
    return index


def voxelise(
    xyz: NDArray[np.int32], anchor: tuple[int, int, int], edges: tuple[int, int, int]
) -> Voxels:
    """Sort points into the voxels of an absolute lattice.

    Parameters
    ----------
    xyz : (n, 3) int32
        Coordinates relative to ``anchor`` [quanta]; >= 0.
    anchor : tuple of int
        Their absolute origin [quanta].
    edges : tuple of int
        Edges of a voxel along x, y, z [quanta], > 0.

    Raises
    ------
    ValueError
        If the region has more voxels than keys.
    """
    index = [lattice_index(xyz[:, a], anchor[a], edges[a]) for a in range(3)]
    # One empty voxel between two columns, so that a stretch of three never runs into the next.
    size = [int(i.max()) + 2 if len(i) else 2 for i in index]
    if size[0] * size[1] * size[2] >= 2**62:
        raise ValueError(f"voxels of {edges} quanta are too small for this region")
    key = (index[0] * size[1] + index[1]) * size[2] + index[2]
    del index  # of a block of millions each array counts
    keys, of_point, count = np.unique(key, return_inverse=True, return_counts=True)
    return Voxels(keys, count, of_point.astype(np.int64), (size[1] * size[2], size[2]))


def squares(xyz: NDArray[np.int32], anchor: tuple[int, int, int], edge: int) -> NDArray[np.int64]:
    """Square of an absolute grid that each point lies in, numbered from zero: (n,) int64."""
    i = lattice_index(xyz[:, 0], anchor[0], edge)
    j = lattice_index(xyz[:, 1], anchor[1], edge)
    _, number = np.unique(i * (int(j.max(initial=0)) + 1) + j, return_inverse=True)
    square: NDArray[np.int64] = number.astype(np.int64)
    return square


def window_counts(voxels: Voxels) -> NDArray[np.int64]:
    """Points in each voxel and the 26 around it: (m,) int64."""
    key = voxels.key
    before = np.concatenate([[0], np.cumsum(voxels.points)])
    total = np.zeros(len(key), dtype=np.int64)
    for i in (-1, 0, 1):
        for j in (-1, 0, 1):
            middle = key + i * voxels.stride[0] + j * voxels.stride[1]
            first = np.searchsorted(key, middle - 1, side="left")
            last = np.searchsorted(key, middle + 1, side="right")
            total += before[last] - before[first]
    return total


def in_spheres(tree: cKDTree, places: NDArray[np.int32], radius: int) -> NDArray[np.int64]:
    """Points of a tree nearer to places than a radius [quanta]: (m,) int64 [count].

    A point at the radius is outside; squares of distances are whole numbers.
    """
    reach = math.sqrt(radius * radius - 0.5)
    return np.asarray(tree.query_ball_point(places, reach, return_length=True), np.int64)


def in_cylinders(
    xyz: NDArray[np.int32], rows: NDArray[np.intp], radius: int, height: int, least: int
) -> NDArray[np.bool_]:
    """Whether upright cylinders around points hold ``least`` points, themselves too: (m,) bool.

    ``radius, height``: of the cylinder, whose centre is the point and whose surface is outside
    [quanta]. Points are listed only where neither the sphere within nor that around it decides.
    """
    out = np.zeros(len(rows), np.bool_)
    if not len(rows):
        return out
    tree = cKDTree(xyz)
    out[:] = in_spheres(tree, xyz[rows], max(min(radius, height // 2), 1)) >= least
    open_ = np.flatnonzero(~out)
    around = math.hypot(radius, height / 2)
    open_ = open_[in_spheres(tree, xyz[rows[open_]], math.ceil(around) + 1) >= least]
    for first in range(0, len(open_), BATCH):
        some = open_[first : first + BATCH]
        near: Any = tree.query_ball_point(xyz[rows[some]], around)
        place = np.repeat(np.arange(len(some)), [len(one) for one in near])
        away = xyz[np.concatenate(near).astype(np.intp)].astype(np.int64) - xyz[rows[some]][place]
        inside = away[:, 0] ** 2 + away[:, 1] ** 2 < radius**2
        inside &= 2 * np.abs(away[:, 2]) < height
        out[some] = np.bincount(place, inside, len(some)) >= least
    return out
