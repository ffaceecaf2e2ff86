"""Noise that is kept because it lies within the signal, where nothing tells it apart.

Domain: space, on the points that a ground cell owns, after the filter. No source has it. Noise
among the returns of a surface has signal for neighbours, so any filter keeps it. Its number is the
volume of the cubes of :data:`EDGE_M` that hold a kept return, times the noise density there. The
cubes are as thick as the neighbourhood in which our filter keeps half of the noise
(``docs/evidence/noise.md``); ``benchmarks.quality`` prints how near that comes.
"""

from typing import Final

import numpy as np

from spl_batch.airborne.filter.signal_volume import AMOUNT_BITS, pack_cubes, sum_of_largest
from spl_batch.constants import NOISE_SIGNAL
from spl_batch.lattice.row_order import sorted_by_digits
from spl_batch.lattice.tables import PointTable
from spl_batch.lattice.tiles import Bounds, quanta

DOMAIN: Final = "space"

COLUMNS_NEEDED: Final = ("x", "y", "z", "noise_class", "noise_density")

EDGE_M: Final = 1.2
"""Edge of a cube: 0.6 m from a surface half of the noise is kept [m]."""

PARTS: Final = 100_000
"""Parts of a noise return: sums are then those of integers; up to 80 returns in a cube."""


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
    packed = np.empty(len(table), np.int64)
    count = pack_cubes(
        (table["x"], table["y"], table["z"]), table["noise_class"], NOISE_SIGNAL,
        table["noise_density"], (cell.xmin, cell.ymin, cell.xmax, cell.ymax), quanta(EDGE_M),
        EDGE_M**3 * PARTS, packed,
    )  # fmt: skip
    packed = packed[:count]
    width = int(packed.max(initial=0)).bit_length() - AMOUNT_BITS
    by_cube = sorted_by_digits(packed.view(np.uint64), AMOUNT_BITS, max(width, 0))
    return int(sum_of_largest(by_cube.view(np.int64)))
