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

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from spl_batch.altimetry.filter.likelihood import ratios
from spl_batch.altimetry.filter.posterior import noise_posterior
from spl_batch.altimetry.noise.noise_at import below_surface, in_fog, noise_at
from spl_batch.altimetry.noise.noise_rate import (
    ALPHA_MIN,
    CAP_UNITS,
)
from spl_batch.altimetry.noise.windows import of_window
from spl_batch.altimetry.photon_table import Cells, Scale
from spl_batch.altimetry.settings import BaselineSettings, RateSettings, SignalSettings
from spl_batch.altimetry.water.level_water import NO_WATER
from spl_batch.constants import QUANTA_PER_M
from spl_batch.lattice.tiles import quanta

UNIT_QUANTA: Final = 4096
"""Lattice of the scaled plane [quanta per unit]."""

SCORE_BINS: Final = 1600
SURE_SD: Final = 3.0
"""Standard deviations of noise that what is more than chance exceeds."""

_ABOVE_ALL: Final = 2.0**29
"""Farther up than any photon is, and within the lattice [quanta]."""

_BINS_PER_LN: Final = 100.0
_LN_FIRST: Final = -10.0
_NOISE_SHARE: Final = (0.01, 0.999)


def scaled(
    along: NDArray[np.int64], height: NDArray[np.int32], scale: Scale, rate: RateSettings
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.intp]]:
    """Position in the scaled plane, and the row of the photon's cell.

    Parameters
    ----------
    along, height : (n,) int64, (n,) int32
        Photons [quanta].

    Returns
    -------
    u, v : (n,) int64
        Along the track, and height [1/4096 units].
    cell : (n,) intp
        Rows of ``scale``.
    """
    size = quanta(rate.cell_m)
    cell = np.searchsorted(scale.index, along // size)
    inside_m = (along - scale.index[cell] * size) / QUANTA_PER_M
    u = np.rint((scale.start[cell] + inside_m * scale.per_m[cell]) * UNIT_QUANTA)
    v = np.rint(height * (UNIT_QUANTA / (QUANTA_PER_M * scale.unit_m)))
    # A surface lends no photons to what lies below it: that is set off by the farthest neighbour.
    v -= below_surface(cell, height, scale) * np.ceil((CAP_UNITS + 1.0) * UNIT_QUANTA)
    # A cloud lends none to what is around it, and is lent none: it lies above all else.
    v += in_fog(cell, height, scale) * _ABOVE_ALL
    return u.astype(np.int64), v.astype(np.int64), cell


def local_alpha(
    cell: NDArray[np.intp], height: NDArray[np.int32], scale: Scale
) -> NDArray[np.float64]:
    """Noise photons per square unit of the scaled plane where photons are, (n,) float64."""
    wet, cloud = scale.level != NO_WATER, in_fog(cell, height, scale)
    if not (wet.any() or cloud.any()):
        return scale.alpha[cell]
    own = noise_at(cell, height, scale) * scale.unit_m / scale.per_m[cell]
    found: NDArray[np.float64] = np.where(
        wet[cell] | cloud, np.maximum(own, ALPHA_MIN), scale.alpha[cell]
    )
    return found


def farthest(cell: NDArray[np.intp], scale: Scale) -> NDArray[np.int64]:
    """Farthest neighbour that counts, of photons by the row of their cell: (n,) int64 [quanta]."""
    return np.maximum(np.floor(scale.cap[cell] * UNIT_QUANTA), 1.0).astype(np.int64)


def most_cells(scale: Scale, rate: RateSettings) -> int:
    """Cells, as far apart as they may be, that the lattice has room for [count].

    Where photons are few, a segment is long: its positions are int32 from its first one.
    """
    widest = float(scale.per_m.max(initial=0.0)) * rate.cell_m + 2.0 * CAP_UNITS
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
    """
    u, v, cell = scaled(along, height, scale, rate)
    anchor = np.array([u.min(initial=0), v.min(initial=0)])
    uv = np.stack([u - anchor[0], v - anchor[1]], axis=1).astype(np.int32)
    table = ratios(settings.neighbours, settings.contrast_max)
    result = noise_posterior(
        uv,
        query,
        farthest(cell, scale),
        np.pi * local_alpha(cell, height, scale) / UNIT_QUANTA**2,
        prior[cell],
        table.within,
        table.beyond,
        (table.first, table.step),
        scale.neighbours[cell],
    )
    return result.astype(np.float32)


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
