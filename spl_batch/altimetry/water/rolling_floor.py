"""Floors that slope or roll, in the boxes of cells and depths of a water column.

A floor that rolls fills several depths of a stretch, and its middle one passes for noise of the
water. But noise is even along the track, and a floor is at another depth in each cell. So noise
is told by the emptier boxes of a depth: the share of a kilometre's boxes that hold few photons
gives the Poisson mean that they belong to. Boxes over what that lets expect are a floor's; what
is left gives the noise anew.
"""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy import special

from spl_batch.altimetry.water.emptiest import sums_around

_FEW: Final = (0, 1, 2, 4, 8)
"""Photons of a box that has few of them; the least that enough boxes show is taken [count]."""

_EMPTIER: Final = 0.25
"""Share of the boxes of a depth that tell its noise, at least."""

_SD: Final = 3.0
_LEAST: Final = 2.0
"""Standard deviations, and photons beside them, that three depths are over what is expected."""

_MOST: Final = 0.5
"""Share of a cell's depths that a floor stands out of, at most."""


def emptier_boxes(
    index: NDArray[np.int64], count: NDArray[Any], full: NDArray[np.bool_], reach: int
) -> NDArray[np.float64]:
    """Poisson mean of the emptier boxes around, not growing with depth: (n, d) float64 [count].

    The probability of at most ``k`` photons is the regularised upper incomplete gamma function
    ``Q(k + 1, mean)``; the mean is where that is the share of boxes found.

    Parameters
    ----------
    index : (n,) int64
        Cell numbers, in order.
    count : (n, d) int
        Photons of each cell and depth.
    full : (n, d) bool
        Boxes that lie in the gate; inf where none does.
    reach : int
        Cells to each side [count].
    """
    boxes = sums_around(index, full, reach).astype(np.int64)
    most = np.arange(2 * reach + 2)
    mean = np.full(count.shape, np.inf)
    for few in reversed(_FEW):
        held = sums_around(index, full & (count <= few), reach).astype(np.int64)
        share = np.minimum(most / np.maximum(most, 1)[:, None], 1.0)
        told = (boxes > 0) & (held >= _EMPTIER * boxes)
        mean[told] = special.gammainccinv(few + 1, share)[boxes[told], held[told]]
    falling: NDArray[np.float64] = np.minimum.accumulate(mean, axis=1)
    return falling


def standing_out(
    count: NDArray[Any], expected: NDArray[np.float64], seen: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Boxes of three depths of one cell that hold more than expected: (n, d) bool.

    Where that is so of most depths of a cell, its noise has grown, and none of them is a floor.

    Parameters
    ----------
    count, expected : (n, d) int, (n, d) float64
        Photons of each cell and depth, and what noise lets expect [count].
    seen : (n, d) bool
        Boxes that the gate reaches.
    """
    held, noise = _with_beside(count), _with_beside(expected)
    over = held > noise + _SD * np.sqrt(noise) + _LEAST
    found: NDArray[np.bool_] = _with_beside(over.astype(np.int64)) > 0
    burst = np.count_nonzero(found & seen, axis=1) > _MOST * np.count_nonzero(seen, axis=1)
    found[burst] = False
    return found


def _with_beside(values: NDArray[Any]) -> NDArray[Any]:
    """Sums of each depth, the one above and the one below it."""
    deep = np.pad(values, ((0, 0), (1, 1)))
    sums: NDArray[Any] = deep[:, :-2] + deep[:, 1:-1] + deep[:, 2:]
    return sums
