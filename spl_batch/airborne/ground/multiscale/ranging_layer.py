"""How thick a layer of ground returns is: the ranging spread that a ground method reckons with.

What sensors state holds errors that neighbouring returns share: bare cells of real surveys scatter
by 2.5 cm where 5 are stated. A layer as thick as stated takes in grass and moss; one too thin loses
returns of the ground under trees where their lowest returns step by metres, and there the stated
spread counts.

Each block of an absolute grid is judged by itself and the eight around it, which every ground cell
that owns points of it has as a whole. What a cell or a survey is on the average decides nothing:
neighbouring ground cells would decide differently, and the terrain had a step between them. From
even to steep the spread goes over by degrees.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from spl_batch.airborne.ground.point_spacing import BLOCK_M, Blocks, no_counts

SIGMA_M: Final = 0.025
"""Least standard deviation of a range that is reckoned with: that of bare cells of real surveys
[m]."""

SHARED_M: Final = float(np.sqrt(0.05**2 - SIGMA_M**2))
"""Standard deviation of what neighbouring returns share, where 5 cm are stated [m]."""

STEEP: Final = 0.7
"""Rise between the lowest returns of a block's quarters, over their edge, at which it is steep: 35
degrees."""

STEEP_SHARE: Final = (0.05, 0.15)
"""Share of the blocks that is steep from which on the stated spread counts in part, and alone."""

Float = NDArray[np.float64]

EVERYWHERE: Final = Blocks(np.full((1, 1), SIGMA_M), (0, 0))
"""Ranging spread where flightlines have none: the least one [m]."""


def reckoned(x: Float, y: Float, z: Float, stated_m: NDArray[np.floating]) -> Blocks:
    """Ranging spread to reckon with, by blocks.

    Parameters
    ----------
    x, y, z : (n,) float64
        Points [m]; n > 0.
    stated_m : (n,) floating
        Ranging spread of each point's flightline [m].

    Returns
    -------
    Blocks
        (rows, columns) float64: what is stated on steep ground, on even ground without the errors
        that neighbours share, variance by variance, and :data:`SIGMA_M` at least [m].
    """
    counts, first = no_counts(x, y, 1)
    rows, columns = counts.shape[:2]
    row, column = (
        np.floor(2.0 * v / BLOCK_M).astype(np.int64) - 2 * corner
        for v, corner in zip((y, x), first, strict=True)
    )
    lowest, most = np.full((2 * rows, 2 * columns), np.inf), np.zeros((rows, columns))
    np.minimum.at(lowest, (row, column), z)
    np.maximum.at(most, (row // 2, column // 2), stated_m)
    quarters = lowest.reshape(rows, 2, columns, 2)
    whole = np.isfinite(quarters).all(axis=(1, 3))
    low, high = quarters.min(axis=(1, 3)), quarters.max(axis=(1, 3))
    steep = whole & (high > low + STEEP * BLOCK_M / 2.0)
    steep_around, around = (
        ndimage.correlate(of.astype(np.float64), np.ones((3, 3)), mode="constant")
        for of in (steep, whole)
    )
    none, alone = STEEP_SHARE
    share = np.clip((steep_around / np.maximum(around, 1.0) - none) / (alone - none), 0.0, 1.0)
    stated = ndimage.maximum_filter(most, 3, mode="constant")
    own = np.sqrt(np.maximum(stated**2 - SHARED_M**2, 0.0))
    return Blocks(np.maximum(SIGMA_M, own + share * (stated - own)), first)
