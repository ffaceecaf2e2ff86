"""How much noise is kept because it lies within the signal, where nothing tells it apart.

Domain: space. Runs on the points that a ground cell owns, once the filter has judged them.

A source is silent on it. Among the returns of a surface the neighbours of a noise return are
signal, and any filter by neighbours keeps it. Counted is what noise is expected to put into the
cubes of :data:`EDGE_M` that hold a kept return: their volume by the density of noise there. They
are as thick as a surface's neighbourhood in which half of the noise is kept, by our own filter at
its defaults (``benchmarks.near_surface``); how near that comes ``benchmarks.quality`` prints.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.constants import NOISE_SIGNAL
from spl_batch.model import PointTable
from spl_batch.tiling import Bounds, quanta

DOMAIN: Final = "space"

COLUMNS_NEEDED: Final = ("x", "y", "z", "noise_class", "noise_density")

EDGE_M: Final = 1.2
"""Edge of a cube: 0.6 m from a surface half of the noise is kept [m]."""

PARTS: Final = 100_000
"""A noise return is counted in so many parts, so that sums are those of integers."""

_BITS: Final = 23
"""Of a number that are for the parts, up to 80 returns in a cube; the others tell the cube."""


def within_signal(table: PointTable, cell: Bounds) -> int:
    """Noise expected in the cubes of an absolute lattice that hold kept returns.

    Parameters
    ----------
    table : PointTable
        Points of the cell and of :data:`EDGE_M` around it, :data:`COLUMNS_NEEDED`.
    cell : Bounds
        A cube counts where its south-western corner lies [quanta].

    Returns
    -------
    int
        Returns, in :data:`PARTS` [1/PARTS].
    """
    edge = quanta(EDGE_M)
    kept = (table["noise_class"] == NOISE_SIGNAL) & np.isfinite(table["noise_density"])
    for axis, low, high in (("x", cell.xmin, cell.xmax), ("y", cell.ymin, cell.ymax)):
        corner = table[axis] // edge * edge
        kept &= (corner >= low) & (corner < high)
    if not kept.any():
        return 0
    parts = np.rint(table["noise_density"][kept].astype(np.float64) * (EDGE_M**3 * PARTS))
    packed = _cubes(table, kept, edge) << _BITS
    packed |= np.minimum(parts, (1 << _BITS) - 1).astype(np.int64)
    packed.sort()
    # of a cube whose returns have several densities the largest counts
    last = np.append(packed[1:] >> _BITS != packed[:-1] >> _BITS, True)
    return int((packed[last] & ((1 << _BITS) - 1)).sum())


def _cubes(table: PointTable, kept: NDArray[np.bool_], edge: int) -> NDArray[np.int64]:
    """One number for each cube: (m,)."""
    number = np.zeros(int(np.count_nonzero(kept)), np.int64)
    for name in "xyz":
        axis = table[name][kept] // edge
        low, high = int(axis.min()), int(axis.max())
        number *= high - low + 1
        number += axis - low
    return number
