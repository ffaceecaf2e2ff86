"""Point-wise test of the adaptive ellipsoid [W18 2.2.3; W17 5.2.2, 6.2.3].

Domain: space.

``published`` is the source's: noise where P(K <= k) < 0.95; it keeps 11-26 % of pure noise.
``calibrated``, the default, deviates in three points:

- the probability of a count at least as large as the one found, ties broken, is compared with what
  pure noise of the same density gives
  (:mod:`~spl_batch.airborne.filter.ellipsoid.null_distribution`), since an ellipsoid is fitted to
  the points that it counts: a share alpha of noise is kept at any density
  (``python -m benchmarks.held --only alpha``);
- only peers count: neighbours whose spacing is at least the point's over ``peer_ratio``
  (:mod:`~spl_batch.airborne.filter.ellipsoid.spacing`), so noise does not live on a surface near
  by;
- hysteresis: a point that passes at ``weak_alpha`` only needs ``link_count`` peers within
  ``link_m`` that pass by themselves. Links are not chained. They may add ``link_share`` of alpha:
  in dense noise they are shorter.

Borders: neighbours within the cap shape the ellipsoid; fewer than four leave the sphere. With no
noise expected, one neighbour inside makes a signal. Except in the published test, a point with none
is background, unless fewer than :data:`HARDLY_EXPECTED` noise points are expected within the cap:
clouds without noise keep their lone returns. Coincident points are neighbours like any other.
"""

from collections.abc import Callable, Iterator
from typing import Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.filter.ellipsoid.ellipsoid_counts import Evidence, evidence
from spl_batch.airborne.filter.ellipsoid.null_distribution import TOLD_TO, null_table
from spl_batch.airborne.filter.ellipsoid.spacing import peer_distances
from spl_batch.airborne.filter.filter_interface import Cloud, Verdict
from spl_batch.airborne.settings import FilterSettings
from spl_batch.lattice.tables import ROWS_AT_ONCE
from spl_batch.lattice.tiles import quanta
from spl_batch.numerics.neighbours.kdtree import build
from spl_batch.numerics.poisson import noise_tail_probability

HARDLY_EXPECTED: Final = 0.05
"""Noise points expected within the neighbours' cap below which a lone return is real [points]."""

Spent = Callable[[NDArray[np.float64]], NDArray[np.float64]]
"""Share of pure noise of given densities [1/m3] that is kept, array for array."""

PUBLISHED_ALPHA: Final = 0.05
"""[W18 2.2.3]: noise where the cumulative probability is below 95 %."""


def reach_m(settings: FilterSettings) -> float:
    """How far the test of a point looks [m]."""
    if settings.test == "published":
        return max(settings.neighbour_cap_m, settings.axis_cap_m)
    reach = max(settings.neighbour_cap_m, settings.axis_cap_m + settings.spacing_cap_m)
    return reach + (settings.link_m if settings.link_count > 0 else 0.0)


def judge(cloud: Cloud, settings: FilterSettings, *, spent: Spent | None = None) -> Verdict:
    """Test the points asked for.

    Counting stops once the decision stands and, calibrated, the score is below :data:`TOLD_TO`: p
    farther down is that of the count where it stopped: an upper bound, the same in any tiling.

    ``spent``: share of pure noise that another test keeps, by noise density, less than alpha. The
    rest of alpha is spent here. ``p_value`` is the share of pure noise that scores no more for
    the calibrated test, P(K >= k) for the published one; a linked point has that of its own
    neighbourhood.
    """
    asked = cloud.asked
    if settings.test == "published":
        found = evidence(cloud.xyz, cloud.density, asked, settings, PUBLISHED_ALPHA)
        signal = noise_tail_probability(found.inside + 1, found.expected) <= PUBLISHED_ALPHA
        return Verdict(signal[asked], found.score[asked].astype(np.float32))
    linked = settings.link_count > 0
    assessed = cloud.around(quanta(settings.link_m), (0, 1, 2)) if linked else asked
    # Of a block of millions each array counts, above all while the tree is built.
    tree = build(cloud.xyz)
    limit = _limits(cloud.density, assessed, settings, spent)
    found = evidence(
        cloud.xyz, cloud.density, assessed, settings, limit,
        at_most=TOLD_TO, scores_only=True, tree=tree,
    )  # fmt: skip
    signal = assessed & (found.score <= limit)
    del limit
    if linked:
        weak, link = _weak(cloud.density, found.score, asked & ~signal, settings, spent)
        _pass_with_peers(signal, weak, link, cloud.xyz, found, settings)
    p_value, table = found.score, null_table(settings)
    del found, tree
    for rows in _batches(asked):
        p_value[rows] = table.p_value(cloud.density[rows], p_value[rows])
    kept = signal[asked] | _hardly_expected(cloud.density[asked], settings)
    return Verdict(kept, p_value[asked].astype(np.float32))


def _pass_with_peers(
    signal: NDArray[np.bool_],
    weak: NDArray[np.intp],
    link: NDArray[np.float64],
    xyz: NDArray[np.int32],
    found: Evidence,
    settings: FilterSettings,
) -> None:
    """Let weak points pass that have enough peers in ``signal``; drops the others' spacings."""
    row = found.tree.points[3]
    chosen = np.zeros(len(signal), np.bool_)
    chosen[weak] = True
    # In the order of the tree, as neighbours share memory.
    slot = np.flatnonzero(chosen[row])
    rows, own = row[slot], found.spacing[slot]
    # A point that does not pass alone is nobody's peer.
    found.spacing[~signal[row]] = -1.0
    signal[rows] = np.isfinite(
        peer_distances(
            found.tree, found.spacing, xyz[rows], own, link[np.searchsorted(weak, rows)],
            settings.link_count, settings.peer_ratio,
        )
    )  # fmt: skip


def _batches(chosen: NDArray[np.bool_]) -> Iterator[NDArray[np.intp]]:
    """Chosen rows, some at a time, as a look-up in a table takes many arrays; at least once."""
    for first in range(0, max(len(chosen), 1), ROWS_AT_ONCE):
        yield first + np.flatnonzero(chosen[first : first + ROWS_AT_ONCE])


def _left(
    spent: Spent | None, settings: FilterSettings, density: NDArray[np.float64]
) -> NDArray[np.float64]:
    """What another test leaves of alpha in noise of some densities: (m,) float64."""
    taken = np.zeros(len(density)) if spent is None else spent(density)
    return settings.alpha - taken


def _limits(
    density: NDArray[np.float64],
    assessed: NDArray[np.bool_],
    settings: FilterSettings,
    spent: Spent | None,
) -> NDArray[np.float64]:
    """Score that passes alone: (n,) float64, 0 for what is not assessed."""
    limit, table = np.zeros(len(density)), null_table(settings)
    for rows in _batches(assessed):
        own = _left(spent, settings, density[rows])
        if settings.link_count > 0:
            own = table.alone(density[rows], own)
        limit[rows] = table.critical(density[rows], own)
    return limit


def _weak(
    density: NDArray[np.float64],
    score: NDArray[np.float64],
    chosen: NDArray[np.bool_],
    settings: FilterSettings,
    spent: Spent | None,
) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """Chosen points that pass with links, and their longest links [quanta]."""
    found, links, table = [], [], null_table(settings)
    for rows in _batches(chosen):
        weak = rows[score[rows] <= table.critical(density[rows], settings.weak_alpha)]
        link = table.link(density[weak], _left(spent, settings, density[weak]))
        found.append(weak)
        # no longer than the halo was made for
        links.append(np.minimum(link, settings.link_m) * quanta(1.0))
    return np.concatenate(found), np.concatenate(links)


def _hardly_expected(density: NDArray[np.float64], settings: FilterSettings) -> NDArray[np.bool_]:
    """Places where noise is rarer than a lone echo: (n,) bool."""
    ball_m3 = 4.0 / 3.0 * np.pi * settings.neighbour_cap_m**3
    rare: NDArray[np.bool_] = density * ball_m3 < HARDLY_EXPECTED
    return rare
