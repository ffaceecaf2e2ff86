r"""Density of the true returns that a beamlet would have among the leaves around it [1/m3].

Domain: space. Returns are a Poisson process whose rate varies with the leaves. A place has counts
:math:`N_k` of true returns in ever smaller spheres of volumes :math:`V_k`. The rate in each is
gamma distributed about that in the one before:

.. math:: \rho_k = \frac{N_k + \nu_k}{V_k + \nu_k / \rho_{k-1}}, \quad \nu_k = \frac{c}{(g_k - 1)^2}

:math:`g_k`, the pair correlation, is the density in sphere k over that in the widest, around all
*parents* near by: places with leaves. It is 1 where leaves are spread evenly, and a small count is
then mostly chance; it grows as clumps get smaller and rarer. In weak light a few evenly spread
pairs are added. A gamma law of that variance would have :math:`1 / (g - 1)`; but clumps are there
or not, and crowns end.

Around parents on a surface (water, brushwood) a flat ellipsoid replaces the widest sphere. Returns
in front in the same beamlet say that light came so far, but also that leaves took some of it: the
rate is :math:`\rho` times a factor between two, by :math:`g` in the smallest sphere.

The constants were chosen on simulated clumps of 0.4, 0.8 and 1.5 m and on evenly turbid crowns, at
1, 1/2, 1/4 and 1/8 of the light, with other seeds than the scenes of
``docs/evidence/afterpulses.md``.
"""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.afterpulse.weighted_counts import MASS, UNIT
from spl_batch.lattice.tiles import cell_index, quanta

KERNELS_M: Final = ((1.5, 1.5), (1.5, 0.2), (0.7, 0.7), (0.5, 0.5))
"""Horizontal and vertical radii of the kernels: wide as crowns, thin, and small as clumps [m]."""

SURFACE_MIN: Final = 2.2
"""Density in the thin kernel over that in the widest, around parents, from which on they lie on a
surface and the thin one takes part: it is above 4 on a level plane, less over a bed, at most 2 in
foliage."""

OWN: Final = 1.7
"""Other beamlets' returns that one in front in the same beamlet is worth."""

SIGHT: Final = (1.1, 0.66)
"""True rate of a beamlet that has a return in front, over the rate by all returns around: where
leaves hang evenly, since its light has found a way so far, and in clumps, which take light."""

HALF: Final = 0.3
"""g - 1 at which it is between the two."""

SHAPE: Final = 0.15
"""c above."""

PAIRS: Final = 6
"""Evenly spread pairs of returns that are added to each sphere around parents [count]."""

CLUMPED_MIN: Final = 0.005
"""Least g - 1: below it chance could turn the sign."""

LEAST: Final = 0.1
"""Returns that a place without any has in the widest sphere."""

CELL_M: Final = 0.75
"""Columns by which parents are summed over [m]."""

CELLS: Final = 3
"""Columns on each side of a place's own whose parents are near by."""

REACH_M: Final = (CELLS + 1) * CELL_M + KERNELS_M[0][0]
"""How far the density at a place looks, its parent at most the widest radius aside [m]."""


def density(counts: NDArray[np.float64], clumping: NDArray[np.float64]) -> NDArray[np.float64]:
    """True returns where a beamlet has returned something in front: (m,) float64 [1/m3].

    ``counts`` (m, k): kernel sums in :data:`KERNELS_M`; ``clumping`` (m, k - 1).
    """
    found = (counts[:, 0] + LEAST) / volume_m3(*KERNELS_M[0])
    near = _against(clumping)
    for k in range(1, len(KERNELS_M)):
        prior = SHAPE / np.maximum(near[:, k - 1] - 1.0, CLUMPED_MIN) ** 2
        found = (counts[:, k] + prior) / (volume_m3(*KERNELS_M[k]) + prior / found)
    even, dense = SIGHT
    found *= even * (dense / even) ** clumped(clumping)
    return found


def clumped(clumping: NDArray[np.float64]) -> NDArray[np.float64]:
    """Whether leaves hang evenly, 0, or in clumps, towards 1: (m,) float64."""
    more = np.maximum(_against(clumping)[:, -1] - 1.0, 0.0)
    return np.asarray(more / (more + HALF), np.float64)


def _against(clumping: NDArray[np.float64]) -> NDArray[np.float64]:
    """Density over that in the thin ellipsoid where parents lie on surfaces: (m, k - 1)."""
    surface = clumping[:, 0] >= SURFACE_MIN
    near = np.where(surface[:, None], clumping / clumping[:, :1].clip(SURFACE_MIN), clumping)
    near[:, 0] = np.where(surface, clumping[:, 0], 1.0)
    return near


def clumping(
    x: NDArray[np.int64],
    y: NDArray[np.int64],
    parents: NDArray[np.intp],
    weight: NDArray[np.int16],
    counts: NDArray[np.int64],
    rows: NDArray[np.intp],
) -> NDArray[np.float64]:
    """Density in each kernel around parents near by, over that in the widest: (m, k - 1) float64.

    ``parents`` (p,) are rows of points, one counts as often as it is named; ``weight`` and
    ``counts`` (p, k) their weights and kernel sums [count / ``UNIT`` ** 2]; ``rows`` (m,) are the
    points to answer for. 1 where there are no parents.
    """
    edge = quanta(CELL_M)
    first = [int(axis.min()) // edge for axis in (x, y)]
    shape = [int(axis.max()) // edge - low + 1 for axis, low in zip((x, y), first, strict=True)]

    def column(of: NDArray[np.intp]) -> tuple[NDArray[np.int64], ...]:
        return tuple(cell_index(v[of], edge) - low for v, low in zip((x, y), first, strict=True))

    sums = np.zeros((*shape, counts.shape[1]), np.int64)
    np.add.at(sums, column(parents), counts * weight[:, None].astype(np.int64))
    volume = np.array([volume_m3(*radii) for radii in KERNELS_M])
    lent = PAIRS * UNIT**3 / volume[1:]
    near = _around(sums)
    found = near[..., 1:] / volume[1:] + lent
    found /= near[..., :1] / volume[0] + lent
    out: NDArray[np.float64] = found[column(rows)]
    return out


def _around(sums: NDArray[np.int64]) -> NDArray[np.int64]:
    """Sums over squares of columns, :data:`CELLS` on each side: (nx, ny, k) int64."""
    for axis in (0, 1):
        until = np.insert(np.cumsum(sums, axis=axis), 0, 0, axis=axis)
        at = np.arange(sums.shape[axis])
        high, low = np.minimum(at + CELLS + 1, len(at)), np.maximum(at - CELLS, 0)
        sums = until.take(high, axis=axis) - until.take(low, axis=axis)
    return sums


def volume_m3(across_m: float, up_m: float) -> float:
    """What the kernel of an ellipsoid holds [m3]."""
    return MASS * 4.0 / 3.0 * math.pi * across_m * across_m * up_m
