"""Space-domain noise filter: which points are background [W18 2.2.3; W17 5.2.2, 6.2.3].

A point is a signal when its adaptive ellipsoid holds more neighbours than background
noise explains. Domain: space. Columns needed: x, y, z, flags, and afterpulse where
the time domain ran; columns added: noise_class, p_value.

Two tests. ``published`` is the source's: noise where P(K <= k) < 0.95; it keeps 15-26 %
of pure noise. ``tail`` deviates in five points:

- it uses P(K >= k), the probability of a count at least as large as the one found;
- alpha is divided by ``selection``, because an ellipsoid is fitted to the very points
  that it counts. With 20 the share of pure noise kept is 0.00-0.12 % from 0.02 to 1 noise
  points per m3 (``benchmarks/denoise.py``; one draw each, and what is kept comes in
  clusters); without it 0.04-0.62 %;
- only peers are counted: neighbours whose own spacing is at least the point's divided by
  ``peer_ratio`` (:mod:`~spl_batch.kernels.spacing`). Noise a few metres from a surface
  lives on the surface's returns otherwise;
- hysteresis: a point that passes at ``weak_alpha`` only lives if at least ``link_count``
  peers that pass by themselves lie within ``link_m``. Links are not chained, so the
  reach is that of the ellipsoid and the spacing in it, plus one link;
- returns that depend on another one are no neighbours and share its label
  (:mod:`~spl_batch.stages.followers`).

Rules for the borders of the method: with fewer neighbours within the cap than the
settings ask for, those there are shape the ellipsoid, and with fewer than four it is
the sphere; with no noise expected a single neighbour inside makes a signal; under
``tail`` a point with no neighbour inside is background, unless fewer than
:data:`HARDLY_EXPECTED` noise points are expected within the neighbours' cap: clouds whose
vendor has removed the noise, and linear-mode ones, keep their lone returns. Coincident
points are neighbours like any other.
"""

from typing import Final, TypedDict

import numpy as np
from numpy.typing import NDArray

from spl_batch.constants import (
    NOISE_AFTERPULSE,
    NOISE_BACKGROUND,
    NOISE_NOT_ASSESSED,
    NOISE_SIGNAL,
    QUANTA_PER_M,
)
from spl_batch.kernels.ellipsoid import Shape, count_inside
from spl_batch.kernels.kdtree import build
from spl_batch.kernels.poisson import noise_tail_probability
from spl_batch.kernels.spacing import enough_peers, spacings
from spl_batch.model import EXCLUDED, UNFILTERED, PointFlag, PointTable
from spl_batch.stages.followers import LAG_M, dependents, follow
from spl_batch.tiling import quanta
from spl_batch.workflow import FilterSettings

BYTES_PER_POINT: Final = 100
"""Peak memory beside the table [bytes per point of block and halo]."""

AFTERPULSE_MIN: Final = 0.5
"""Probability from which the time domain's afterpulse flag is believed."""

EXACT_TO: Final = 1e-12
"""Tail down to which a diagnostic ``p_value`` is exact."""

HARDLY_EXPECTED: Final = 0.05
"""Noise within the neighbours' cap below which a lone return is a real one [points]."""

PUBLISHED_ALPHA: Final = 0.05
"""[W18 2.2.3]: noise where the cumulative probability is below 95 %."""


class NoiseColumns(TypedDict):
    """Columns that the filter gives for the query points, in table order."""

    noise_class: NDArray[np.uint8]
    p_value: NDArray[np.float32]


def reach_m(settings: FilterSettings) -> float:
    """Halo that the filter needs [m]."""
    if settings.method == "none":
        return 0.0
    if settings.test == "published":
        return max(settings.neighbour_cap_m, settings.axis_cap_m)
    reach = max(settings.neighbour_cap_m, settings.axis_cap_m + settings.spacing_cap_m)
    return reach + LAG_M + (settings.link_m if settings.link_count > 0 else 0.0)


def denoise(
    table: PointTable,
    density: NDArray[np.float64],
    query: NDArray[np.bool_],
    settings: FilterSettings,
    *,
    exact: bool = False,
) -> NoiseColumns:
    """Decide which points are noise.

    Parameters
    ----------
    table : PointTable
        Points of a block and its halo in canonical order.
    density : (n,) float64
        Expected noise at each point [1/m3]; finite, >= 0. It must be right in the
        halo too, as far as links reach.
    query : (n,) bool
        Points to decide.
    settings : FilterSettings
        Method and its parameters.
    exact : bool
        Count on until P < 1e-12, so that ``p_value`` is exact down to there. Without
        it counting stops once the decision stands, and the ``p_value`` of a signal is
        the P of the critical count: an upper bound, the same whatever the tiling.

    Returns
    -------
    NoiseColumns
        For the m query points: ``noise_class`` (m,) uint8 and ``p_value`` (m,)
        float32, P(at least as many neighbours | noise), NaN where not assessed.
    """
    excluded = table.has(EXCLUDED)
    echo = np.zeros(len(table), dtype=np.bool_)
    if "afterpulse" in table:
        echo = (table["afterpulse"] >= AFTERPULSE_MIN) & ~excluded
    noise_class = np.full(len(table), NOISE_NOT_ASSESSED, dtype=np.uint8)
    p_value = np.full(len(table), np.nan, dtype=np.float32)
    if settings.method == "none":
        noise_class[~excluded] = NOISE_SIGNAL
    else:
        dependent = np.zeros(len(table), np.bool_)
        if settings.test != "published":
            dependent = dependents(table) & ~excluded & ~echo
        active = np.flatnonzero(~excluded & ~echo & ~dependent)
        # A parent outside the area of interest is judged for the sake of who follows it.
        beamless = table.has(EXCLUDED | PointFlag.NO_BEAM)
        wanted = _with_parents(table, query & ~table.has(UNFILTERED), dependent)
        asked = (wanted & ~beamless)[active]
        signal, tail = _assess(_relative(table, active), density[active], asked, settings, exact)
        rows = active[asked]
        if settings.test != "published":
            signal |= _hardly_expected(density[rows], settings)
        noise_class[rows] = np.where(signal, NOISE_SIGNAL, NOISE_BACKGROUND)
        p_value[rows] = tail
        noise_class[echo] = NOISE_AFTERPULSE
        noise_class[dependent & ~beamless] = NOISE_SIGNAL
        rows = np.flatnonzero(~excluded)
        kept = table.take(rows)
        noise_class[rows] = follow(kept, dependent[rows], noise_class[rows])
        noise_class[table.has(UNFILTERED) & ~echo] = NOISE_NOT_ASSESSED
    noise_class[echo] = NOISE_AFTERPULSE
    outside = table.has(PointFlag.OUTSIDE_AOI)
    noise_class[outside] = NOISE_NOT_ASSESSED
    p_value[outside] = np.nan
    return {"noise_class": noise_class[query], "p_value": p_value[query]}


def _hardly_expected(density: NDArray[np.float64], settings: FilterSettings) -> NDArray[np.bool_]:
    """Places where noise is rarer than a lone echo: (n,) bool."""
    ball_m3 = 4.0 / 3.0 * np.pi * settings.neighbour_cap_m**3
    rare: NDArray[np.bool_] = density * ball_m3 < HARDLY_EXPECTED
    return rare


def _with_parents(
    table: PointTable, query: NDArray[np.bool_], dependent: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Points to decide, and those that a dependent one of them may follow: (n,) bool."""
    asked = np.flatnonzero(query & dependent)
    if not len(asked):
        return query
    margin = quanta(LAG_M)
    parents = np.ones(len(table), np.bool_)
    for name in "xy":
        values = table[name]
        parents &= (values >= values[asked].min() - margin) & (
            values <= values[asked].max() + margin
        )
    return query | parents


def _relative(table: PointTable, rows: NDArray[np.intp]) -> NDArray[np.int32]:
    """Coordinates relative to their smallest: exact, and small enough for 32 bits."""
    xyz = np.empty((len(rows), 3), dtype=np.int32)
    for axis, name in enumerate("xyz"):
        values = table[name][rows].astype(np.int64, copy=False)
        if len(values):
            xyz[:, axis] = values - values.min()
    return xyz


def _assess(
    xyz: NDArray[np.int32],
    density: NDArray[np.float64],
    asked: NDArray[np.bool_],
    settings: FilterSettings,
    exact: bool,  # noqa: FBT001
) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
    """Signal or not, and P(K >= k), of the points asked for."""
    shape = Shape(
        neighbours=settings.neighbours,
        radius=float(quanta(settings.radius_m)),
        floor=float(quanta(settings.eigen_floor_m)),
        axis_cap=float(quanta(settings.axis_cap_m)),
        neighbour_cap=quanta(settings.neighbour_cap_m),
        power=1.0 if settings.axis_power == "eigenvalue" else 0.5,
    )
    published = settings.test == "published"
    alpha = PUBLISHED_ALPHA if published else settings.alpha / settings.selection
    linked = settings.link_count > 0 and not published
    assessed = _around(xyz, asked, quanta(settings.link_m)) if linked else asked
    stop = min(alpha, EXACT_TO) if exact else alpha
    tree = build(xyz)
    spacing = np.zeros(len(xyz))
    if not published:
        spacing = spacings(tree, settings.spacing_neighbours, quanta(settings.spacing_cap_m))
    count, expected, tail = count_inside(
        xyz,
        tree,
        assessed,
        density / QUANTA_PER_M**3,
        shape,
        alpha=stop,
        spacing=spacing,
        peer_ratio=settings.peer_ratio,
    )
    if published:
        return (noise_tail_probability(count + 1, expected) <= alpha)[asked], tail[asked]
    signal = tail <= alpha
    if linked:
        weak = np.flatnonzero(asked & ~signal & (tail <= settings.weak_alpha))
        signal[weak] = _linked(xyz, spacing, assessed & signal, weak, settings)
    return signal[asked], tail[asked]


def _linked(
    xyz: NDArray[np.int32],
    spacing: NDArray[np.float64],
    strong: NDArray[np.bool_],
    weak: NDArray[np.intp],
    settings: FilterSettings,
) -> NDArray[np.bool_]:
    """Weak points with enough strong peers around them."""
    return enough_peers(
        build(xyz[strong]),
        spacing[strong],
        xyz[weak],
        spacing[weak],
        quanta(settings.link_m),
        settings.link_count,
        settings.peer_ratio,
    )


def _around(xyz: NDArray[np.int32], asked: NDArray[np.bool_], margin: int) -> NDArray[np.bool_]:
    """Points that may lie within ``margin`` of one asked for: those in the grown box of all."""
    if not asked.any():
        return asked
    low, high = xyz[asked].min(axis=0) - margin, xyz[asked].max(axis=0) + margin
    around: NDArray[np.bool_] = np.all((xyz >= low) & (xyz <= high), axis=1)
    return around
