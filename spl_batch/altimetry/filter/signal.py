"""Which photons are signal [W17 4.1.3], and mDBSCAN beside it [W17 3.1.2].

Deviations from the source, with reasons:

* Eq. 4.6 multiplies 20 posteriors, which underflows; their logarithms are added. The mean
  is kept: it orders photons as the product does, and its exponential, the geometric mean
  of the posteriors, is a number between 0 and 1 to show.
* The neighbourhood may be longer than high (``aspect``); 1 is the source's circle.
* "The smallest n_s" is applied along the track, in running windows, since noise, surface
  and cloud change over the thousands of kilometres of a granule.
* By default n_s says how many signal photons there are, not how many are taken:
  :mod:`spl_batch.altimetry.filter.chance`. ``signal.selection: number`` is the source's.
* n_s is a difference of two large numbers. Where it asks for so many photons that noise far
  from any surface would come along, fewer are taken. What noise does is not assumed but
  read off the same scores, in the part of the gate that is far from the surface.
"""

from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from spl_batch.altimetry.filter.likelihood import Ratios, ratios
from spl_batch.altimetry.filter.posterior import noise_posterior
from spl_batch.altimetry.noise.noise_at import below_surface, in_fog, noise_at
from spl_batch.altimetry.noise.planes import ALPHA_MIN, CAP_UNITS, UNIT_QUANTA, Plane, planes
from spl_batch.altimetry.noise.windows import of_window
from spl_batch.altimetry.photon_table import Cells, Scale
from spl_batch.altimetry.settings import BaselineSettings, RateSettings, SignalSettings
from spl_batch.altimetry.water.level_water import NO_WATER
from spl_batch.constants import QUANTA_PER_M
from spl_batch.lattice.tiles import quanta

SCORE_BINS: Final = 1600
SURE_SD: Final = 3.0
"""Standard deviations of noise that what is more than chance exceeds."""

_ABOVE_ALL: Final = 2.0**29
"""Farther up than any photon is, and within the lattice [quanta]."""

_BINS_PER_LN: Final = 100.0
_LN_FIRST: Final = -10.0
_NOISE_SHARE: Final = (0.01, 0.999)


class Photons(NamedTuple):
    """Photons, or places."""

    along: NDArray[np.int64]  #: (n,): along the track [quanta].
    height: NDArray[np.int32]  #: (n,): [quanta].
    cell: NDArray[np.intp]  #: (n,): rows of the scale.


def in_cells(
    along: NDArray[np.int64], height: NDArray[np.int32], scale: Scale, rate: RateSettings
) -> Photons:
    """Photons with the rows of their cells."""
    return Photons(along, height, np.searchsorted(scale.index, along // quanta(rate.cell_m)))


class Placed(NamedTuple):
    """Photons in a plane."""

    rows: NDArray[np.intp]  #: (p,): those of all that lie in it.
    uv: NDArray[np.int64]  #: (p, 2): along the track, and height [1/4096 units].
    at: NDArray[np.intp]  #: (p,): rows of the plane's cells.
    alpha: NDArray[np.float64]  #: (p,): noise photons per square unit.

    def farthest(self, plane: Plane) -> NDArray[np.int64]:
        """Farthest neighbour that counts, (p,) int64 [1/4096 units]."""
        return np.maximum(np.floor(plane.cap[self.at] * UNIT_QUANTA), 1.0).astype(np.int64)


def placed(photons: Photons, plane: Plane, scale: Scale, rate: RateSettings) -> Placed:
    """Photons, or places, of the cells of a plane where they lie in it."""
    along, height, cell = photons
    size = quanta(rate.cell_m)
    at = plane.row_of(len(scale.index))[cell]
    rows = np.flatnonzero(at >= 0)
    cell, at, z = cell[rows], at[rows], height[rows]
    inside_m = (along[rows] - scale.index[cell] * size) / QUANTA_PER_M
    u = plane.start[at] + np.rint(inside_m * plane.per_m[at] * UNIT_QUANTA).astype(np.int64)
    below = below_surface(cell, z, scale)
    start, end = scale.bed[cell].T
    bed = start + (end - start) * inside_m / rate.cell_m
    v = np.rint((z / QUANTA_PER_M - np.where(below, bed, 0.0)) * (UNIT_QUANTA / plane.unit_m))
    # A surface lends no photons to what lies below it: that is set off by the farthest neighbour.
    v -= below * _ABOVE_ALL
    # A cloud lends none to what is around it, and is lent none: it lies above all else.
    cloud = in_fog(cell, z, scale)
    v += cloud * _ABOVE_ALL
    wet = scale.level[cell] != NO_WATER
    alpha = plane.alpha[at]
    if wet.any() or cloud.any():
        own = np.maximum(noise_at(cell, z, scale) * plane.unit_m / plane.per_m[at], ALPHA_MIN)
        alpha = np.where(wet | cloud, own, alpha)
    return Placed(rows, np.stack([u, v.astype(np.int64)], axis=1), at, alpha)


def most_cells(scale: Scale, rate: RateSettings, signal: SignalSettings) -> int:
    """Cells, as far apart as they may be, that the lattice has room for [count].

    Where photons are few, a segment is long: its positions are int32 from its first one.
    """
    every = np.arange(len(scale.index))
    most = max((float(p.per_m.max()) for p in planes(scale, every, rate, signal)), default=0.0)
    widest = most * rate.cell_m + 2.0 * CAP_UNITS
    # Half of the room, so that the reach to either side fits in as well.
    return max(int(2**30 / (widest * UNIT_QUANTA)), 1)


def log_prior(
    cells: Cells, scale: Scale, rate: RateSettings, window_m: float
) -> NDArray[np.float64]:
    """Logarithm of P(signal) / P(noise) of each cell, from its running window: (n,) float64."""
    counted = np.stack([cells.count.astype(np.float64), scale.noise])
    at, sums = of_window(scale.index, counted, rate, window_m)
    total, noise = sums[:, at]
    share = np.clip(noise / np.maximum(total, 1.0), *_NOISE_SHARE)
    ratio: NDArray[np.float64] = np.log((1.0 - share) / share)
    return ratio


def score(
    along: NDArray[np.int64],
    height: NDArray[np.int32],
    query: NDArray[np.bool_],
    scale: Scale,
    prior: NDArray[np.float64],
    rate: RateSettings,
    settings: SignalSettings,
    table: Ratios | None = None,
) -> NDArray[np.float32]:
    """Mean ln P(noise) of the query photons, (q,) float32; all within the reach are given.

    Parameters
    ----------
    along, height : (n,) int64, (n,) int32
        Photons of a piece of track and of ``reach_m`` to each side [quanta].
    query : (n,) bool
        Photons whose score is wanted.
    prior : (cells,) float64
        From :func:`log_prior`.
    rate, settings : RateSettings, SignalSettings
        Cells; neighbours and contrasts.
    table : Ratios, optional
        Other likelihoods than those of the settings.
    """
    out = np.zeros(len(along), np.float32)
    table = table or ratios(settings.neighbours, settings.contrast_max)
    photons = in_cells(along, height, scale, rate)
    for plane in planes(scale, np.unique(photons.cell[query]), rate, settings):
        here = placed(photons, plane, scale, rate)
        own = query[here.rows] & plane.own[here.at]
        cell = plane.rows[here.at]
        result = noise_posterior(
            (here.uv - here.uv.min(axis=0)).astype(np.int32),
            own,
            here.farthest(plane),
            np.pi * here.alpha / UNIT_QUANTA**2,
            prior[cell],
            table.within,
            table.beyond,
            (table.first, table.step),
            scale.neighbours[cell],
        )
        out[here.rows[own]] = result
    return out[query]


def score_bins(score: NDArray[np.float32]) -> NDArray[np.int64]:
    """Bin of each score; the higher, the more like signal: (n,) int64."""
    depth = np.log(np.maximum(-score.astype(np.float64), 1e-30))
    bins = np.floor((depth - _LN_FIRST) * _BINS_PER_LN)
    return np.clip(bins, 0, SCORE_BINS - 1).astype(np.int64)


def thresholds(
    counts: NDArray[np.int64],
    far: NDArray[np.int64],
    wanted: NDArray[np.float64],
    false_share: float,
) -> NDArray[np.int64]:
    """Least score bin that is signal, of each window.

    Parameters
    ----------
    counts, far : (w, bins) int64
        Photons by score bin, and those of them far from the surface.
    wanted : (w,) float64
        n_s, signal photons estimated [count].
    false_share : float
        Most that noise far from the surface may contribute.

    Returns
    -------
    (w,) int64
        From 1 to the number of bins, which takes none.
    """
    above = np.cumsum(counts[:, ::-1], axis=1)
    fine = above <= np.maximum(wanted, 0.0)[:, None]
    sure = is_sure(counts, wanted)
    fine &= few_strays(np.cumsum(far[:, ::-1], axis=1), above, sure, false_share)
    # The widest choice that is fine; a count below it may not be, by chance, and need not.
    taken = np.where(fine.any(1), fine.shape[1] - np.argmax(fine[:, ::-1], axis=1), 0)
    least: NDArray[np.int64] = np.maximum(counts.shape[1] - taken, 1)
    return least


def is_sure(counts: NDArray[Any], wanted: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Windows whose signal is more than chance makes of the noise, (w,) bool."""
    noise = np.maximum(counts.sum(axis=1) - wanted, 1.0)
    sure: NDArray[np.bool_] = wanted > SURE_SD * np.sqrt(noise)
    return sure


def few_strays(
    far: NDArray[Any], above: NDArray[Any], sure: NDArray[np.bool_], false_share: float
) -> NDArray[np.bool_]:
    """Whether photons far from the surface are few among those taken, (w, bins) bool.

    Where there is signal, a single one tells of no rate: it takes no stretch away.
    """
    few: NDArray[np.bool_] = far <= np.maximum(false_share * above, sure[:, None])
    return few


def mean_density(
    cells: Cells, scale: Scale, rate: RateSettings, settings: SignalSettings
) -> NDArray[np.float64]:
    """Photons per square metre in the running window of each cell, (n,) float64.

    On the scaled axis a cell is longer by its noise rate over the reference.
    """
    stretch = scale.stretch if settings.mdbscan.scaled else np.ones(len(scale.index))
    area = cells.gate_m * rate.cell_m * stretch
    counted = np.stack([cells.count.astype(np.float64), area])
    at, sums = of_window(scale.index, counted, rate, settings.window_m)
    mean: NDArray[np.float64] = sums[0, at] / np.maximum(sums[1, at], 1e-9)
    return mean


def mdbscan(
    along: NDArray[np.int64],
    height: NDArray[np.int32],
    scale: Scale,
    mean: NDArray[np.float64],
    rate: RateSettings,
    settings: BaselineSettings,
) -> NDArray[np.bool_]:
    """Signal by mDBSCAN, (n,) bool: in the ellipse of a photon that has enough in its own.

    Parameters
    ----------
    along, height : (n,) int64, (n,) int32
        Photons of a piece of track and of two semi-axes to each side [quanta].
    mean : (cells,) float64
        From :func:`mean_density` [1/m2].
    rate, settings : RateSettings, BaselineSettings
        Cells; the ellipse and the factor.
    """
    size = quanta(rate.cell_m)
    cell = np.searchsorted(scale.index, along // size)
    inside_m = (along - scale.index[cell] * size) / QUANTA_PER_M
    stretched_m = scale.stretched_m[cell] + inside_m * scale.stretch[cell]
    s_m = stretched_m if settings.scaled else along / QUANTA_PER_M
    plane = np.stack([s_m / settings.along_m, height / QUANTA_PER_M / settings.height_m], axis=1)
    if not len(plane):
        return np.zeros(0, np.bool_)
    inside = cKDTree(plane).query_ball_point(plane, 1.0, return_length=True)
    area_m2 = np.pi * settings.along_m * settings.height_m
    core: NDArray[np.bool_] = np.asarray(inside >= settings.factor * mean[cell] * area_m2)
    if not core.any():
        return core
    nearest, _ = cKDTree(plane[core]).query(plane, distance_upper_bound=np.nextafter(1.0, 2.0))
    signal: NDArray[np.bool_] = np.asarray(nearest <= 1.0)
    return signal


def baseline_reach_m(scale: Scale, settings: BaselineSettings) -> float:
    """Along-track distance beyond which no photon matters to mDBSCAN [m]."""
    if not settings.scaled or not len(scale.stretch):
        return 2.0 * settings.along_m
    return 2.0 * settings.along_m / float(scale.stretch.min())
