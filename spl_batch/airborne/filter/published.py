"""Filters of the sources, beside our own: numpy and scipy on a cloud and its halo.

Each has a reach and a verdict on the points asked for; none has a p-value. All lattices lie on
absolute grids, so that a label does not depend on what lies far away.

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
  before left, the point itself included. The source states neither over which area the fullest bin
  is sought, nor the last level's number: both are settings. Of equally full bins the lowest counts.
- :func:`voxel`: voxels of 3 m x 3 m x 0.3 m as full as their surroundings' mean [W17 5.4, after
  Tang et al. 2016]. The source states that "the threshold for noise removal was the mean point
  density" and not over which voxels. Here it is the mean count of the *occupied* voxels in the same
  square: over all of them it would be below one point and remove nothing.

Filters of single shots work in the time domain; their flag travels with the point:

- ``dcc``: differential cell count [W17 3.2.3; Eq. 3.3 with the correction of
  :mod:`~spl_batch.airborne.beams.differential_cell_count`]. Ranges replace the source's elevations,
  so a bin is as long in a slanting beam as in an upright one.
- ``pixels``: neighbours in the detector [W17 3.2.1, after Zhang et al.]. A return stays if enough
  of the 3 x 3 pixels around its own returned from about its range. The source finds the number, 1
  to 9, numerically for a brightness and a noise, and gives neither it nor the range: both are
  settings.
"""

import math
from itertools import pairwise
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from spl_batch.airborne.beams.differential_cell_count import dcc_keep
from spl_batch.airborne.beams.shot_runs import run_starts
from spl_batch.airborne.filter.cube_counts import cube_counts
from spl_batch.airborne.filter.ellipsoid.ellipsoid_counts import count_inside
from spl_batch.airborne.filter.ellipsoid.ellipsoid_shape import shape_of
from spl_batch.airborne.filter.filter_interface import Cloud, Verdict, without_p
from spl_batch.airborne.settings import FilterSettings
from spl_batch.constants import QUANTA_PER_M
from spl_batch.lattice.tables import ROWS_AT_ONCE, BeamTable, PointTable
from spl_batch.lattice.tiles import quanta
from spl_batch.numerics.compiled import njit
from spl_batch.numerics.neighbours.kdtree import build

OF_SHOTS: Final = ("dcc", "pixels")
"""Names of the filters of single shots."""


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
    xyz, asked = np.ascontiguousarray(cloud.xyz[crowded]), cloud.asked[crowded]
    signal = np.zeros(len(cloud.xyz), dtype=np.bool_)
    if asked.any():
        sphere = np.zeros(len(xyz))
        sphere[asked] = in_spheres(cKDTree(xyz), xyz[asked], quanta(own.radius_m)) - 1
        least = np.ceil(own.ratio_min * sphere)
        inside, _, _ = count_inside(
            xyz, build(xyz), asked & (sphere > 0), np.zeros(len(xyz)),
            shape_of(settings, own.neighbours, own.radius_m), alpha=np.maximum(least, 1.0),
        )  # fmt: skip
        signal[crowded] = (sphere > 0) & (inside >= least)
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
    square, _ = numbered(cloud, (settings.aes.square * edge,) * 2)
    voxel, points = numbered(cloud, (edge,) * 3)
    mean = np.bincount(voxel, weights=cloud.density) / points
    owner = np.zeros(len(mean), dtype=np.int64)
    owner[voxel] = square
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
    return without_p(in_cylinders(cloud.xyz, rows, radius, height, own.count + 1))


def multilevel_reach_m(settings: FilterSettings) -> float:
    """How far the verdict on a point looks: the reaches of the three levels add up [m]."""
    levels = settings.multilevel
    return 2.0 * (levels.fine_voxel_m + levels.coarse_voxel_m) + levels.column_m


def multilevel(cloud: Cloud, settings: FilterSettings) -> Verdict:
    """Decide about the points asked for."""
    levels = settings.multilevel
    left = _near_fullest_bin(cloud, quanta(levels.column_m), quanta(levels.bin_m))
    for edge_m, least in (
        (levels.coarse_voxel_m, levels.coarse_count),
        (levels.fine_voxel_m, levels.fine_count),
    ):
        left = left[cube_counts(cloud.xyz[left], cloud.anchor, quanta(edge_m)) >= least]
    signal = np.zeros(len(cloud.xyz), dtype=np.bool_)
    signal[left] = True
    return without_p(signal[cloud.asked])


def _near_fullest_bin(cloud: Cloud, side: int, height: int) -> NDArray[np.intp]:
    """Rows in the fullest height bin of their square, or beside it."""
    if not len(cloud.xyz):
        return np.zeros(0, dtype=np.intp)
    square, _ = numbered(cloud, (side, side))
    level = _index(cloud, 2, height)
    levels = int(level.max()) + 1
    count = np.bincount(square * levels + level, minlength=(int(square.max()) + 1) * levels)
    fullest = np.argmax(count.reshape(-1, levels), axis=1)
    return np.flatnonzero(np.abs(level - fullest[square]) <= 1)


def voxel_reach_m(settings: FilterSettings) -> float:
    """How far the verdict on a point looks: its square, and voxels that stick out of it [m]."""
    return settings.voxel.column_m + settings.voxel.edge_m


def voxel(cloud: Cloud, settings: FilterSettings) -> Verdict:
    """Decide about the points asked for."""
    if not len(cloud.xyz):
        return without_p(np.zeros(0, dtype=np.bool_))
    own, side = settings.voxel, quanta(settings.voxel.column_m)
    edge = quanta(own.edge_m)
    of_point, points = numbered(cloud, (edge, edge, quanta(own.height_m)))
    # The square that holds the voxel's lower corner.
    corner = [(cloud.xyz[:, k] + np.int64(cloud.anchor[k])) // edge * edge // side for k in (0, 1)]
    square = np.empty(len(points), np.int64)
    square[of_point], _ = _numbers(corner)
    occupied = np.bincount(square)
    held = np.bincount(square, weights=points).astype(np.int64)
    full = points * occupied[square] >= held[square]
    return without_p(full[of_point[cloud.asked]])


def _index(cloud: Cloud, axis: int, edge: int) -> NDArray[np.int64]:
    """Cell of each point along an axis, on the lattice from absolute zero: (n,), from 0 on."""
    index: NDArray[np.int64] = (
        cloud.xyz[:, axis].astype(np.int64) + cloud.anchor[axis] % edge
    ) // edge
    return index


def numbered(cloud: Cloud, edges: tuple[int, ...]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Number of each point's cell of an absolute lattice, and the points in each: (n,), (m,).

    ``edges``: of a cell along x, y and perhaps z [quanta], > 0.
    """
    return _numbers([_index(cloud, axis, edge) for axis, edge in enumerate(edges)])


def _numbers(index: list[NDArray[np.int64]]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Different combinations of indices numbered from 0 on: of each point, and how often each is.

    Raises ValueError if there are more of them than keys.
    """
    above = [along - along.min(initial=0) for along in index]
    size = [int(along.max(initial=0)) + 1 for along in above]
    try:
        key = np.ravel_multi_index(above, size)
    except ValueError:
        raise ValueError(f"{size} voxels are too many for a region; choose larger ones") from None
    _, number, count = np.unique(key, return_inverse=True, return_counts=True)
    return number.astype(np.int64), count


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
    for first in range(0, len(open_), ROWS_AT_ONCE):
        some = open_[first : first + ROWS_AT_ONCE]
        near: Any = tree.query_ball_point(xyz[rows[some]], around)
        place = np.repeat(np.arange(len(some)), [len(one) for one in near])
        away = xyz[np.concatenate(near).astype(np.intp)].astype(np.int64) - xyz[rows[some]][place]
        inside = away[:, 0] ** 2 + away[:, 1] ** 2 < radius**2
        inside &= 2 * np.abs(away[:, 2]) < height
        out[some] = np.bincount(place, inside, len(some)) >= least
    return out


def shot_noise(
    table: PointTable, beams: BeamTable, settings: FilterSettings, gate_m: float, columns: int
) -> NDArray[np.bool_]:
    """Returns that a filter of single shots calls noise: (n,) bool.

    Parameters
    ----------
    table : PointTable
        Rows of one stretch, sorted by gps_time.
    beams : BeamTable
        Their beams; rows without a known one are not called noise.
    settings : FilterSettings
        Filter, one of :data:`OF_SHOTS`.
    columns : int
        Beamlets along a side of the array [count].
    """
    noise = np.zeros(len(table), dtype=np.bool_)
    rows = np.flatnonzero(beams.known)
    keep = np.empty(len(rows), dtype=np.bool_)
    starts = run_starts(table["gps_time"][rows])
    if settings.method == "dcc":
        bins = settings.dcc.coarse_bin_m, settings.dcc.fine_bin_m
        _keep_by_bins(starts, beams.range_m[rows], gate_m, *bins, keep)
    else:
        pixel = table["channel"][rows].astype(np.int64) - 1
        own = settings.pixels
        _keep_by_pixels(starts, beams.range_m[rows], pixel, columns, own.range_m, own.count, keep)
    noise[rows] = ~keep
    return noise


@njit()
def _keep_by_bins(starts, range_m, gate_m, coarse_m, fine_m, keep):  # type: ignore[no-untyped-def]
    """Which returns lie in a bin of their shot that holds signal: fills (n,) bool."""
    for m in range(len(starts) - 1):
        rows = slice(starts[m], starts[m + 1])
        dcc_keep(range_m[rows], gate_m, coarse_m, fine_m, keep[rows])


@njit()
def _keep_by_pixels(starts, range_m, pixel, columns, reach_m, least, keep):  # type: ignore[no-untyped-def]
    """Which returns enough of the 3 x 3 pixels around share: fills (n,) bool.

    ``pixel``: by rows of the array; without a known one, below 0, a return stays.
    """
    for m in range(len(starts) - 1):
        for i in range(starts[m], starts[m + 1]):
            seen = np.zeros(9, dtype=np.bool_)
            for j in range(starts[m], starts[m + 1]):
                if pixel[j] < 0 or abs(range_m[j] - range_m[i]) > reach_m:
                    continue
                row = pixel[j] // columns - pixel[i] // columns + 1
                column = pixel[j] % columns - pixel[i] % columns + 1
                if 0 <= row < 3 and 0 <= column < 3:
                    seen[3 * row + column] = True
            keep[i] = pixel[i] < 0 or seen.sum() >= least


def of_shots(cloud: Cloud, settings: FilterSettings) -> Verdict:  # noqa: ARG001
    """What the shots gave the points asked for; nothing is looked at around them."""
    return without_p(~cloud.shot_noise[cloud.asked])
