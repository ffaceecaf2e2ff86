"""Kept returns of places where nothing stands: no surface may rest on them.

The test keeps a stated share of pure noise, and what it keeps comes in clusters. Where the
survey sees no surface at all, off its edge or over dark water, such a cluster would be the
only ground for tens of metres. There the returns that were kept are few beside those that
were refused; where a surface is seen they are not. Our own rule.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.constants import NOISE_BACKGROUND, NOISE_SIGNAL
from spl_batch.model import PointTable
from spl_batch.tiling import cell_index, quanta

DOMAIN: Final = "space"

COLUMN_M: Final = 5.0
"""Columns in which returns are counted, three by three [m]."""

KEPT_SHARE: Final = 0.002
"""Twice the share of pure noise that the filter keeps by default."""

CLUSTER: Final = 12
"""Returns of a cluster of noise that the filter may keep [count] ..."""

CLUSTER_SHARE: Final = 0.2
"""... at most this share of those that it refused: clean clouds have no such clusters."""


def stray(table: PointTable) -> NDArray[np.bool_]:
    """Kept returns that are too few beside the refused ones around them.

    Parameters
    ----------
    table : PointTable
        Points of a place, in any order, with ``x, y, noise_class``.

    Returns
    -------
    (n,) bool
        True for signals in 15 m x 15 m of which there are fewer than noise explains.
    """
    out = np.zeros(len(table), np.bool_)
    signal = table["noise_class"] == NOISE_SIGNAL
    refused = table["noise_class"] == NOISE_BACKGROUND
    if not (signal.any() and refused.any()):
        return out
    edge = quanta(COLUMN_M)
    i, j = cell_index(table["x"], edge), cell_index(table["y"], edge)
    i, j = i - i.min() + 1, j - j.min() + 1
    shape = (int(i.max()) + 2, int(j.max()) + 2)
    kept, gone = (_around(i[which], j[which], shape) for which in (signal, refused))
    limit = np.minimum(CLUSTER, CLUSTER_SHARE * gone) + KEPT_SHARE * gone
    out[signal] = (kept < limit)[i[signal], j[signal]]
    return out


def _around(
    i: NDArray[np.int64], j: NDArray[np.int64], shape: tuple[int, int]
) -> NDArray[np.int64]:
    """Points in each column and the eight around it."""
    count = np.zeros(shape, np.int64)
    np.add.at(count, (i, j), 1)
    for axis in (0, 1):
        count = count + np.roll(count, 1, axis) + np.roll(count, -1, axis)
    return count
