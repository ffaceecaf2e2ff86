"""Where a floor is lost: water between places that show one, and none in the profile.

A floor that is steep, rough or faint for the noise around leaves cells empty, as deep water does.
What tells both apart is that it is seen close by on either side, or that photons of the cell itself
show its line (:mod:`spl_batch.altimetry.water.leaning_floor`).
"""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

NEAR_CELLS: Final = 25
"""Cells to either side within which a floor has to be seen [count]."""


class LostFloor(NamedTuple):
    """Cells of water whose floor is lost and is found, and where the lost ones lie [m]."""

    lost: int
    found: int
    from_m: float
    to_m: float


def lost_floor(
    cell: NDArray[np.int64],
    found: NDArray[np.bool_],
    shown: NDArray[np.int64],
    cell_m: float,
) -> LostFloor:
    """Cells of water without a floor that lies there, or close by on both sides.

    Parameters
    ----------
    cell : (n,) int64
        Cells of water, in order.
    found : (n,) bool
        Those whose profile has a floor.
    shown : (m,) int64
        Cells whose photons show the line of one, in any order.
    cell_m : float
        Length of a cell [m].
    """
    lies = np.isin(cell, shown)
    seen = np.unique(np.concatenate([cell[found], cell[lies]]))
    if not len(seen):
        return LostFloor(0, 0, 0.0, 0.0)
    after = np.searchsorted(seen, cell)
    behind = seen[np.minimum(after, len(seen) - 1)] - cell
    before = cell - seen[np.maximum(after - 1, 0)]
    between = (after > 0) & (before <= NEAR_CELLS) & (behind >= 0) & (behind <= NEAR_CELLS)
    lost = np.flatnonzero(~found & (lies | between))
    if not len(lost):
        return LostFloor(0, int(found.sum()), 0.0, 0.0)
    ends = float(cell[lost[0]] * cell_m), float((cell[lost[-1]] + 1) * cell_m)
    return LostFloor(len(lost), int(found.sum()), *ends)
