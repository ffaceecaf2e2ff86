"""Level land with trees: more stands above it than noise can be."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.altimetry.water.emptiest import Photons, emptiest, sums_around
from spl_batch.constants import QUANTA_PER_M

CANOPY_M: Final = 30
"""Height above a level that trees stand in, at most; noise is seen above that [m]."""

_GROWN: Final = 1.5
_SD: Final = 3.0
"""Times the noise above them that trees hold at least, and standard deviations beside that."""

_OVER_M: Final = 4.0
"""Height above a level that a surface over a bright floor does not reach [m]."""

_NEAR_CELLS: Final = 2
"""Cells to each side that trees are looked for with [count]."""

WOOD_CELLS: Final = 10
"""Cells to each side that trees are compared with what is emptiest over [count]."""

_Band = tuple[NDArray[np.int64], NDArray[np.int64]]


def grown_over(
    photons: Photons,
    gate: tuple[NDArray[np.int32], NDArray[np.int32]],
    level: NDArray[np.int32],
    shown: tuple[NDArray[np.bool_], NDArray[np.bool_]],
    half: int,
) -> NDArray[np.bool_]:
    """Cells where more stands above the level than noise can be: plains with trees, (n,) bool.

    Noise is seen above trees; in low gates, which trees may fill, in the emptiest quarter of what
    reaches as high as trees. Below water there is as much noise or more. What stands a little above
    a level may be the surface over a bright floor, and is no wood.

    Light comes from below water alone: where it does, what stands there is mist or a cloud. But
    what begins right above the level is a shore, or the surface over a floor taken for it.

    Parameters
    ----------
    gate : ((n,) int32, (n,) int32)
        Lower and upper end of each cell's gate [quanta].
    level : (n,) int32
        Level surface of each cell [quanta].
    shown : ((n,) bool, (n,) bool)
        Whether there is one, and whether light comes from below it.
    half : int
        Half-thickness of a surface [quanta].
    """
    index, (some, lit) = photons.number, shown
    low, high = (end.astype(np.int64) for end in gate)
    foot = level.astype(np.int64) + half
    canopy = CANOPY_M * QUANTA_PER_M
    # Where the gate ends low above the water, noise is seen in the upper half of what there is.
    middle = foot + np.minimum(canopy, np.maximum(high - foot, 0) // 2)
    over = level.astype(np.int64) + round(_OVER_M * QUANTA_PER_M)
    highest = np.minimum(high, foot + canopy)
    bands = (foot, np.minimum(high, middle)), (middle, high), (over, highest), (foot, over)
    trees, sky, tall, low_down = (_within(photons, some, *band) for band in bands)
    empty = emptiest(photons, (low, highest), level.astype(np.int64), some, WOOD_CELLS)
    grown = _more(index, trees, sky, _NEAR_CELLS) | _more(index, tall, empty, WOOD_CELLS)
    found: NDArray[np.bool_] = grown & some & (~lit | _more(index, low_down, sky, WOOD_CELLS))
    return found


def _within(
    photons: Photons,
    some: NDArray[np.bool_],
    bottom: NDArray[np.int64],
    top: NDArray[np.int64],
) -> _Band:
    """Photons in a band of heights of each of some cells, and its length: (n,) [count, quanta]."""
    inside = (photons.height > bottom[photons.cell]) & (photons.height <= top[photons.cell])
    inside &= some[photons.cell]
    count = np.bincount(photons.cell[inside], minlength=len(photons.number))
    return count, np.where(some, np.clip(top - bottom, 0, None), 0)


def _more(index: NDArray[np.int64], band: _Band, empty: _Band, reach: int) -> NDArray[np.bool_]:
    """Cells around which a band holds more than the noise of another can be, (n,) bool."""
    counts, lengths = (np.stack(both, axis=1) for both in zip(band, empty, strict=True))
    near, noise = sums_around(index, counts, reach).T
    near_m, noise_m = sums_around(index, lengths / QUANTA_PER_M, reach).T
    ratio = near_m / np.maximum(noise_m, 1.0)
    chance = _SD * np.sqrt(near + (noise + 1.0) * ratio**2)
    found: NDArray[np.bool_] = (noise_m > 0) & (near > _GROWN * noise * ratio + chance)
    return found
