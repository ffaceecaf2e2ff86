"""Noise photons that pass for signal, counted before a threshold is chosen.

The source takes "the smallest n_s" of Eq. 4.6 for signal, n_s being all photons less the noise
expected [W17 4.1.3]. Noise that lies within canopy or ground passes for signal too, and takes the
places of as many photons of sparse canopy. How many such there are need not be guessed: noise is a
Poisson process that knows nothing of the signal, so a photon of it sees the others as a place
without a photon does (Slivnyak's theorem; Baddeley, *Spatial Point Processes*, 2007, 2.3). Places
strewn evenly over the gate of each cell are scored like photons; the noise expected in the cell,
shared among them, gives the noise expected at every score.

The places are those of Roberts' sequence (M. Roberts, *The Unreasonable Effectiveness of
Quasirandom Sequences*, 2018), numbered by cell: they depend on the cell alone.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import special
from scipy.spatial import cKDTree

from spl_batch.altimetry.filter.likelihood import Ratios
from spl_batch.altimetry.filter.signal import (
    SURE_SD,
    Placed,
    few_strays,
    in_cells,
    is_sure,
    placed,
)
from spl_batch.altimetry.noise.noise_at import noise_at, noise_told
from spl_batch.altimetry.noise.planes import UNIT_QUANTA, planes
from spl_batch.altimetry.photon_table import Cells, Scale
from spl_batch.altimetry.settings import RateSettings, SignalSettings
from spl_batch.lattice.tiles import quanta

SHARE_QUANTA: Final = 1 << 20
"""Expected noise is counted in whole parts of a photon, so that sums have no order [1/photon]."""

_LEAST: Final = 32
_PHOTONS_PER_PLACE: Final = 8
_MOST: Final = 4096
_STEPS: Final = (np.uint64(0xC13FA9A902A6328F), np.uint64(0x91E10DA5C79E7B1D))
"""1 / g and 1 / g^2 of 2^64, g being the plastic number, g^3 = g + 1."""
_HALF: Final = np.uint64(32)
_BATCH: Final = 65_536

LIKE_NOISE: Final = 1e-6
"""Photons that noise alone would give as often as this are no sure signal [probability]."""

LEAST_PHOTONS: Final = 10
"""Photons that are worth a warning, and that are a floor [count]."""

_LEAST_LIKE_SIGNAL: Final = 0.9
"""Part of the noise expected, of the lowest scores, whose photons are counted."""

_MOST_LOST: Final = 0.05
"""Part of the F1 to be expected that the limit on far photons may cost."""


def places(
    cells: Cells, scale: Scale, owned: NDArray[np.bool_], rate: RateSettings
) -> tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.int64], NDArray[np.int64]]:
    """Places over the gates of cells, and the noise that each stands for.

    Parameters
    ----------
    owned : (cells,) bool
        Cells that get places.

    Returns
    -------
    along, height : (p,) int64, (p,) int32
        Places [quanta].
    noise, told : (p,) int64
        Noise photons that each stands for where photons are chosen, and that a reader is told of
        [1 / SHARE_QUANTA].
    """
    mine = np.flatnonzero(owned)
    count = np.clip(cells.count[mine] // _PHOTONS_PER_PLACE, _LEAST, _MOST)
    cell = np.repeat(mine, count)
    inside = np.arange(len(cell)) - np.repeat(np.cumsum(count) - count, count)
    # Unsigned sums and products wrap around: the sequence modulo 1, to 2^-32.
    number = (cells.index[cell] * _MOST + inside).astype(np.uint64)
    part = [(number * step) >> _HALF for step in _STEPS]
    size = quanta(rate.cell_m)
    span = (cells.high - cells.low)[cell].astype(np.uint64) + np.uint64(1)
    along = cells.index[cell] * size + ((part[0] * np.uint64(size)) >> _HALF).astype(np.int64)
    height = cells.low[cell] + ((part[1] * span) >> _HALF).astype(np.int32)
    height = height.astype(np.int32)
    area = cells.gate_m[mine] * rate.cell_m / count
    share = np.repeat(area, count) * SHARE_QUANTA
    each, told = (
        np.rint(density(cell, height, scale) * share).astype(np.int64)
        for density in (noise_at, noise_told)
    )
    return along, height, each, told


def score_places(
    at: tuple[NDArray[np.int64], NDArray[np.int32]],
    photons: tuple[NDArray[np.int64], NDArray[np.int32]],
    scale: Scale,
    prior: NDArray[np.float64],
    settings: tuple[RateSettings, SignalSettings],
    table: Ratios,
) -> NDArray[np.float32]:
    """Mean ln P(noise) that a photon would have at each place, (p,) float32.

    Parameters
    ----------
    at : ((p,) int64, (p,) int32)
        Places along the track and in height [quanta].
    photons : ((n,) int64, (n,) int32)
        Photons of the piece of track and of ``reach_m`` to each side, likewise.
    scale, prior
        As of :func:`spl_batch.altimetry.filter.signal.score`.
    settings : (RateSettings, SignalSettings)
        Cells; aspect and reach.
    table : Ratios
        Likelihoods, those that the photons are scored by.
    """
    rate, signal = settings
    out = np.zeros(len(at[0]), np.float32)
    if not len(photons[0]):
        return out
    own, given = (in_cells(*some, scale, rate) for some in (at, photons))
    for plane in planes(scale, np.unique(own.cell), rate, signal):
        here, others = (placed(some, plane, scale, rate) for some in (own, given))
        mine = plane.own[here.at]
        here = Placed(here.rows[mine], here.uv[mine], here.at[mine], here.alpha[mine])
        anchor = others.uv.min(axis=0)
        # There are eight photons to a place: a tree that is quick to make wins.
        tree = cKDTree(
            (others.uv - anchor).astype(np.float64), compact_nodes=False, balanced_tree=False
        )
        cap = here.farthest(plane).astype(np.float64)
        cell = plane.rows[here.at]
        most, log_prior = scale.neighbours[cell], prior[cell]
        for first in range(0, len(cap), _BATCH):
            rows = slice(first, first + _BATCH)
            scores = _scores(
                tree, here.uv[rows] - anchor, (cap[rows], here.alpha[rows]), log_prior[rows],
                most[rows], table,
            )  # fmt: skip
            out[here.rows[rows]] = scores
    return out


def _scores(
    tree: cKDTree,
    here: NDArray[np.int64],
    plane: tuple[NDArray[np.float64], NDArray[np.float64]],
    log_prior: NDArray[np.float64],
    most: NDArray[np.int64],
    table: Ratios,
) -> NDArray[np.float64]:
    """Scores of places in a plane, (p,) float64; ``plane``: cap and alpha of each."""
    cap, alpha = plane
    wanted = np.arange(1, int(most.max()) + 1)
    # A list of neighbours gives two dimensions, of a single one too.
    distance = np.asarray(tree.query(here, k=wanted, distance_upper_bound=cap.max() + 0.5)[0])
    columns = np.arange(table.within.shape[1])
    area = np.pi * alpha / UNIT_QUANTA**2
    total = np.zeros(len(here))
    for k in range(len(wanted)):
        found = distance[:, k] <= cap
        squared = np.where(found, np.maximum(distance[:, k], 1.0), cap) ** 2
        column = (np.log(squared * area) - table.first) * table.step
        ratio = np.empty(len(column))
        for some, row in ((found, table.within[k]), (~found, table.beyond[k])):
            ratio[some] = np.interp(column[some], columns, row)
        log_noise = np.logaddexp(0.0, ratio + log_prior)
        total -= np.where(k < most, log_noise, 0.0)
    return total / most


def noise_alone(taken: float, noise: float, share: float, neighbours: int) -> float:
    """Probability that noise alone gives as many photons as are taken; 1 where none are.

    A photon passes for signal by its neighbours, so noise passes in clumps of about as many as
    count. Clumps are taken as a Poisson process. Noise is told to the photons that a place stands
    for, so that many are added.

    Parameters
    ----------
    taken, noise : float
        Photons taken, and noise photons expected among them.
    share : float
        Share of noise among all photons, taken or not.
    """
    if not taken:
        return 1.0
    most = noise + _PHOTONS_PER_PLACE * min(share, 1.0)
    return float(special.gammainc(taken / neighbours, most / neighbours))


def noise_seen(
    counts: NDArray[np.float64], noise: NDArray[np.float64], water: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Noise that photons show over noise expected, of each window: (w,) float64.

    The empty window is a sample, and signal what a difference of counts leaves: where photons are
    few, its error is a large part of them. What is least like signal is noise, and is counted; some
    signal is among it, so it is believed as far as chance may have misled the empty window. By a
    water surface that is no sample of the noise.

    Parameters
    ----------
    counts, noise : (w, bins) float64
        Photons by score bin, and noise photons expected.
    water : (w,) float64
        Cells with water [count].
    """
    total = np.cumsum(noise, axis=1)
    low = total <= _LEAST_LIKE_SIGNAL * total[:, -1:]
    seen, expected = (np.where(low, table, 0.0).sum(axis=1) for table in (counts, noise))
    dry = (water == 0) & (expected > 0)
    most = SURE_SD / np.sqrt(np.maximum(total[:, -1], 1.0))
    off = np.clip(seen / np.where(dry, expected, 1.0) - 1.0, -most, most)
    found: NDArray[np.float64] = np.where(dry, np.maximum(1.0 + off, 0.0), 1.0)
    return found


def best_thresholds(
    counts: NDArray[np.float64],
    noise: NDArray[np.float64],
    far: NDArray[np.float64],
    far_noise: NDArray[np.float64],
    wanted: NDArray[np.float64],
    false_share: float,
) -> NDArray[np.int64]:
    """Least score bin that is signal, of each window: that of the largest F1 to be expected.

    Of ``above`` photons taken, those are signal that are not expected to be noise, so F1, the
    harmonic mean of precision and recall, is 2 (above - noise) / (above + n_s).

    The limit on far photons may cost a twentieth of that F1: where it would cost more, as under a
    bright sky, it does not count. Far photons that noise explains are no signal anyway, and the F1
    is that of the others. A cliff, a cloud or a surface that was not followed puts signal far from
    where the surface is looked for: where noise does not explain the far photons, all of them
    count.

    Parameters
    ----------
    counts, noise, far, far_noise : (w, bins) float64
        Photons by score bin, and noise photons expected; the same far from the surface.
    wanted, false_share
        As of :func:`spl_batch.altimetry.filter.signal.thresholds`.

    Returns
    -------
    (w,) int64
        From 1 to the number of bins, which takes none.
    """
    tables = (counts, noise, far, far_noise)
    above, below, away, strays = (np.cumsum(table[:, ::-1], axis=1) for table in tables)
    every = _expected_f1(above, below, wanted)
    sure = is_sure(counts, wanted)
    gain = np.where(few_strays(away, above, sure, false_share), every, 0.0)
    costly = sure & (gain.max(axis=1) < (1.0 - _MOST_LOST) * every.max(axis=1))
    best = counts.shape[1] - 1 - every.argmax(axis=1)
    layered = more_far_than_noise(*tables, best)[:, None]
    near = _expected_f1(above - away, below - strays, wanted)
    gain = np.where(costly[:, None], np.where(layered, every, near), gain)
    taken = np.where(gain.max(axis=1) > 0.0, gain.argmax(axis=1) + 1, 0)
    least: NDArray[np.int64] = np.maximum(counts.shape[1] - taken, 1)
    return least


def _expected_f1(
    above: NDArray[np.float64], noise: NDArray[np.float64], wanted: NDArray[np.float64]
) -> NDArray[np.float64]:
    """F1 to be expected of so many photons taken, and so much noise among them: (w, bins)."""
    signal = np.clip(above - noise, 0.0, wanted[:, None])
    found: NDArray[np.float64] = 2.0 * signal / np.maximum(above + wanted[:, None], 1.0)
    return found


def more_far_than_noise(
    counts: NDArray[np.float64],
    noise: NDArray[np.float64],
    far: NDArray[np.float64],
    far_noise: NDArray[np.float64],
    least: NDArray[np.int64],
) -> NDArray[np.bool_]:
    """Windows of whose photons more lie far from the surface than noise explains, (w,) bool.

    By three standard deviations. Noise is told by places; each stands for so many photons at most.

    Parameters
    ----------
    counts, noise, far, far_noise : (w, bins) float64
        As of :func:`best_thresholds`.
    least : (w,) int64
        Least score bin that is taken.
    """
    taken = np.arange(counts.shape[1]) >= least[:, None]
    away, strays = (np.where(taken, table, 0.0).sum(axis=1) for table in (far, far_noise))
    each = _PHOTONS_PER_PLACE * noise.sum(axis=1) / np.maximum(counts.sum(axis=1), 1.0)
    found: NDArray[np.bool_] = away > strays + each + SURE_SD * np.sqrt((1.0 + each) * strays)
    return found
