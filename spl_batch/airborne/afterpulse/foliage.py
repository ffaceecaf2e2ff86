r"""Density of the true returns that a beamlet would have among the leaves around it [1/m3].

Domain: space. Returns are a Poisson process whose rate varies with the leaves. A place has counts
:math:`N_0, N_1` of true returns in a wide and a narrow sphere of volumes :math:`V_0, V_1`. The rate
in the narrow one is gamma distributed about that in the wide one:

.. math:: \rho_0 = N_0 / V_0, \quad \rho = \frac{N_1 + \nu}{V_1 + \nu / \rho_0}, \quad
    \nu = \frac{c}{(g - 1)^2}

:math:`g`, the pair correlation, is the density in the narrow sphere over that in the wide one,
around all *parents* near by: places with leaves. It is 1 where leaves are spread evenly, and a
small count is then mostly chance; it grows as clumps get smaller and rarer. A gamma law of that
variance would have :math:`1 / (g - 1)`; but clumps are there or not, and crowns end.

The constants were chosen on simulated clumps of 0.4, 0.8 and 1.5 m and on evenly turbid crowns, at
1, 1/2, 1/4 and 1/8 of the light, with other seeds than the scenes of
``docs/evidence/afterpulses.md``.
"""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.lattice.tiles import cell_index, quanta

KERNELS_M: Final = ((1.5, 1.5), (0.5, 0.5))
"""Horizontal and vertical radii of the kernels: wide as crowns, and small as clumps [m]. Half and
twice move 707 + 911 and 404 + 530 labels."""

OWN: Final = 1.7
"""Other beamlets' returns that one in front in the same beamlet is worth. Half and twice move 134 +
177 and 229 + 254 labels."""

HALF: Final = 0.3
"""g - 1 at which leaves hang half in clumps. Half and twice move 14 + 103 and 4 + 35 labels."""

SHAPE: Final = 0.15
"""c above. Half and twice move 6 + 40 and 2 + 35 labels."""

LEAST: Final = 0.1
"""Returns that a place without any has in the widest sphere. Half and twice move 24 + 19 and 52 +
48 labels."""

CELL_M: Final = KERNELS_M[0][0] / 2.0
"""Columns by which parents are summed over: half of the wide radius [m]."""

CELLS: Final = 3
"""Columns on each side of a place's own whose parents are near by. Half and twice move 24 + 99 and
14 + 73 labels."""

REACH_M: Final = (CELLS + 1) * CELL_M + KERNELS_M[0][0]
"""How far the density at a place looks, its parent at most the widest radius aside [m]."""


def density(counts: NDArray[np.float64], clumping: NDArray[np.float64]) -> NDArray[np.float64]:
    """True returns where a beamlet has returned something in front: (m,) float64 [1/m3].

    ``counts`` (m, 2): kernel sums in :data:`KERNELS_M`; ``clumping`` (m,): g.
    """
    wide, narrow = (volume_m3(*radii) for radii in KERNELS_M)
    around = (counts[:, 0] + LEAST) / wide
    # Both sides times (g - 1)^2: it may be 0, and by chance less.
    unlike = np.maximum(clumping - 1.0, 0.0) ** 2
    found = (counts[:, 1] * unlike + SHAPE) / (narrow * unlike + SHAPE / around)
    return np.asarray(found, np.float64)


def clumped(clumping: NDArray[np.float64]) -> NDArray[np.float64]:
    """Whether leaves hang evenly, 0, or in clumps, towards 1: (m,) float64."""
    more = np.maximum(clumping - 1.0, 0.0)
    return np.asarray(more / (more + HALF), np.float64)


def clumping(
    x: NDArray[np.int64],
    y: NDArray[np.int64],
    parents: NDArray[np.intp],
    weight: NDArray[np.int16],
    counts: NDArray[np.int64],
    rows: NDArray[np.intp],
) -> NDArray[np.float64]:
    """Density in the narrow sphere around parents near by, over that in the wide: (m,) float64.

    ``parents`` (p,) are rows of points, one counts as often as it is named; ``weight`` and
    ``counts`` (p, 2) their weights and kernel sums [count / ``UNIT`` ** 2]; ``rows`` (m,) are the
    points to answer for. 1 where there are no parents.
    """
    edge = quanta(CELL_M)
    first = [int(axis.min()) // edge for axis in (x, y)]
    shape = [int(axis.max()) // edge - low + 1 for axis, low in zip((x, y), first, strict=True)]

    def column(of: NDArray[np.intp]) -> tuple[NDArray[np.int64], ...]:
        return tuple(cell_index(v[of], edge) - low for v, low in zip((x, y), first, strict=True))

    sums = np.zeros((*shape, counts.shape[1]), np.int64)
    np.add.at(sums, column(parents), counts * weight[:, None].astype(np.int64))
    wide, narrow = (volume_m3(*radii) for radii in KERNELS_M)
    around, near = np.moveaxis(_around(sums), -1, 0)
    found = np.divide(near / narrow, around / wide, out=np.ones(shape), where=around > 0)
    out: NDArray[np.float64] = found[column(rows)]
    return out


def _around(sums: NDArray[np.int64]) -> NDArray[np.int64]:
    """Sums over squares of columns, :data:`CELLS` on each side: (nx, ny, 2) int64."""
    for axis in (0, 1):
        until = np.insert(np.cumsum(sums, axis=axis), 0, 0, axis=axis)
        at = np.arange(sums.shape[axis])
        high, low = np.minimum(at + CELLS + 1, len(at)), np.maximum(at - CELLS, 0)
        sums = until.take(high, axis=axis) - until.take(low, axis=axis)
    return sums


def volume_m3(across_m: float, up_m: float) -> float:
    """What the kernel of an ellipsoid holds [m3]; (1 - d^2)^2 has 32 pi / 105 in the unit ball."""
    return 32.0 / 105.0 * math.pi * across_m * across_m * up_m
