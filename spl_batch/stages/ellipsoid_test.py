"""Point-wise test of the adaptive ellipsoid [W18 2.2.3; W17 5.2.2, 6.2.3].

Two tests. ``published`` is the source's: noise where P(K <= k) < 0.95; it keeps 15-26 %
of pure noise. ``tail`` deviates in four points:

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
  reach is that of the ellipsoid and the spacing in it, plus one link.

Rules for the borders of the method: with fewer neighbours within the cap than the
settings ask for, those there are shape the ellipsoid, and with fewer than four it is
the sphere; with no noise expected a single neighbour inside makes a signal; under
``tail`` a point with no neighbour inside is background, unless fewer than
:data:`HARDLY_EXPECTED` noise points are expected within the neighbours' cap: clouds whose
vendor has removed the noise, and linear-mode ones, keep their lone returns. Coincident
points are neighbours like any other.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.constants import QUANTA_PER_M
from spl_batch.kernels.ellipsoid import Shape, count_inside
from spl_batch.kernels.kdtree import build
from spl_batch.kernels.poisson import noise_tail_probability
from spl_batch.kernels.spacing import enough_peers, spacings
from spl_batch.stages.cloud import Cloud, Verdict
from spl_batch.tiling import quanta
from spl_batch.workflow import FilterSettings

DOMAIN: Final = "space"

EXACT_TO: Final = 1e-12
"""Tail down to which a diagnostic ``p_value`` is exact."""

HARDLY_EXPECTED: Final = 0.05
"""Noise within the neighbours' cap below which a lone return is a real one [points]."""

PUBLISHED_ALPHA: Final = 0.05
"""[W18 2.2.3]: noise where the cumulative probability is below 95 %."""


def reach_m(settings: FilterSettings) -> float:
    """How far the test of a point looks [m]."""
    if settings.test == "published":
        return max(settings.neighbour_cap_m, settings.axis_cap_m)
    reach = max(settings.neighbour_cap_m, settings.axis_cap_m + settings.spacing_cap_m)
    return reach + (settings.link_m if settings.link_count > 0 else 0.0)


def judge(cloud: Cloud, settings: FilterSettings, *, exact: bool = False) -> Verdict:
    """Test the points asked for.

    Parameters
    ----------
    cloud : Cloud
        Independent returns of a block and its halo.
    settings : FilterSettings
        Test and its parameters.
    exact : bool
        Count on until P < 1e-12, so that p is exact down to there. Without it counting
        stops once the decision stands, and p of a signal is the P of the critical count:
        an upper bound, the same whatever the tiling.

    Returns
    -------
    Verdict
        Of the points asked for, in their order.
    """
    signal, tail = _assess(cloud.xyz, cloud.density, cloud.asked, settings, exact)
    if settings.test != "published":
        signal |= _hardly_expected(cloud.density[cloud.asked], settings)
    return Verdict(signal, tail.astype(np.float32))


def _hardly_expected(density: NDArray[np.float64], settings: FilterSettings) -> NDArray[np.bool_]:
    """Places where noise is rarer than a lone echo: (n,) bool."""
    ball_m3 = 4.0 / 3.0 * np.pi * settings.neighbour_cap_m**3
    rare: NDArray[np.bool_] = density * ball_m3 < HARDLY_EXPECTED
    return rare


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
