"""Ground beyond a wall, which tells nothing of the gap before it.

A wall, as a quay's or a platform's, is a step from one cell to the next that is much larger than
what the ground around rises by from cell to cell. So a steep slope, which rises everywhere, is
none. Where ground is so sparse that cells have no neighbours, there are no walls.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

WALL_CELLS: Final = 1.0
"""Height of a wall, at least, in edges of a cell."""

STEEPER: Final = 2.5
"""How much larger a wall's step is than the mean of those around."""

AROUND_CELLS: Final = 17
"""Edge of the square that this mean is of [count]."""

FULL_OF_NINE: Final = 6
"""Cells with ground, of a cell and those around it, from which on it may be at a wall [count]."""

_FINE_CELLS = 1e-3
"""What steps are counted in."""

_NINE = np.ones((3, 3), np.bool_)

Grid = NDArray[np.float64]
Mask = NDArray[np.bool_]


def on_this_side(height: Grid, gaps: Mask, reach: int) -> Mask:
    """Cells that a way leads to from a gap, without a wall and no longer than the reach.

    Parameters
    ----------
    height : (rows, columns) float64
        Of the ground [cells]; NaN without any.
    gaps : (rows, columns) bool
    reach : int
        [cells], straight or diagonal.
    """
    walls = walls_of(height)
    if not walls.any():
        return np.ones_like(gaps)
    # A single cell without ground is no hole in a wall.
    walls |= np.isnan(height) & ndimage.binary_dilation(walls, _NINE)
    return np.asarray(ndimage.binary_dilation(gaps, _NINE, reach, mask=gaps | ~walls))


def walls_of(height: Grid) -> Mask:
    """Cells at the top or the foot of a wall."""
    held = ~np.isnan(height)
    step = ndimage.maximum_filter(np.where(held, height, -np.inf), 3)
    step -= ndimage.minimum_filter(np.where(held, height, np.inf), 3)
    full = held & (_sum_around(held.astype(np.float64), 3) >= FULL_OF_NINE)
    # Whole numbers, so that sums do not depend on where the cells begin.
    whole = np.rint(np.where(full, step, 0.0) / _FINE_CELLS)
    count = _sum_around(full.astype(np.float64), AROUND_CELLS)
    mean = _sum_around(whole, AROUND_CELLS) / np.maximum(count, 1.0)
    return np.asarray(full & (step > WALL_CELLS) & (whole > STEEPER * mean))


def _sum_around(values: Grid, edge: int) -> Grid:
    for axis in (0, 1):
        values = ndimage.convolve1d(values, np.ones(edge), axis, mode="constant")
    return values
