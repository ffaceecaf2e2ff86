"""Where the ground bends: a line is fitted to it, or a parabola.

A line is less noisy, a parabola follows curved ground. A parabola contradicts the line by the
square of their difference over its variance, which is by chance the difference of their variances
(J. Hausman, Econometrica 46, 1978, 2.1), and one on average. Where flat ground is asked cell by
cell, chance bends it now and then; ground that bends does so in the cells around as well.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

_TWICE: Final = 2.0
"""Error of a parabola over the line's, at most: where few photons lie near the middle it swings.
Spread evenly, photons make it 1.5."""

_OWN: Final = 2.0**2
_AROUND: Final = 3.0
_ALONE: Final = 5.0**2
"""How much a parabola contradicts the line: in the cell, in those around on average, and in a
cell alone; [variances]."""

_LEAST2_M2: Final = 1e-8
"""Least variance of the difference [m2]."""


def with_bends(
    index: NDArray[np.int64], fits: NDArray[np.float64], reach: int
) -> NDArray[np.float64]:
    """Ground of each cell by line or parabola, (c, 5) float64.

    Height [m], slope [m/m], standard error of the height [m], photons [count], and by how much
    more than chance the cell's own photons are off it, squared [m2], of either sign.

    Parameters
    ----------
    index : (c,) int64
        Cells, in order.
    fits : (c, 9) float64
        By :func:`spl_batch.altimetry.ground.cell_ground.fit_ground`.
    reach : int
        Cells to each side that are asked [count].
    """
    line, photons, bent, near = fits[:, :3], fits[:, 3], fits[:, 4:7], fits[:, 7:]
    known = bent[:, 2] < _TWICE * line[:, 2]
    chance2 = np.maximum(bent[:, 2] ** 2 - line[:, 2] ** 2, _LEAST2_M2)
    against = np.where(known, (bent[:, 0] - line[:, 0]) ** 2 / chance2, 0.0)
    # A cell alone may be far off; whole numbers, whose sums have no order.
    counted = np.rint(np.minimum(against, _ALONE) * 1e6).astype(np.int64), known.astype(np.int64)
    first = np.searchsorted(index, index - reach)
    stop = np.searchsorted(index, index + reach, side="right")
    total, cells = ((s := np.concatenate([[0], np.cumsum(v)]))[stop] - s[first] for v in counted)
    around = (total - counted[0]) * 1e-6 / np.maximum(cells - 1, 1)
    bends = known & ((against > _ALONE) | ((against > _OWN) & (around > _AROUND)))
    out = np.where(bends[:, None], bent, line)
    off2 = (near[:, 0] - out[:, 0]) ** 2 - np.maximum(near[:, 1] ** 2 - out[:, 2] ** 2, 0.0)
    return np.column_stack([out, photons, off2])
