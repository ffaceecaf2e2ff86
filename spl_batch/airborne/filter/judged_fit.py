"""Whether a filter's verdicts fit where nothing stands: below all surfaces, and high above them.

Domain: space, on the points of a ground cell after the filter. Our own: no source judges its fit.

*Below* all surfaces noise lies alone. There small p-values of the calibrated test are uniform if
its model of the noise holds: noise in clusters, or denser than expected, has too many of them,
thinner noise too few.

*Above*, signal that hangs in the air is none, but for wires, cranes and birds. A signal *floats* if
nothing was kept in the :data:`GAP` layers of cells below it, in its column and the eight around,
while a surface lies farther down in its own column. Roofs and decks hang so beside their edges:
what is thinner than :data:`THICK` layers, and not far thinner spread than what lies below, is a
surface itself.
"""

from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

DOMAIN: Final = "space"

P_VALUES: Final = (0.01, 0.02, 0.05, 0.1, 0.2)
"""Values up to which p-values are counted. Larger ones are not resolved where noise is thin."""

ENOUGH: Final = 200
"""Returns that a value must have by the model, to tell something: p-values of neighbours hang
together, so that chance makes twice the difference that it makes otherwise [count]."""

GAP: Final = 3
"""Layers of 5 m without a signal below what floats: more than crowns leave above their ground."""

THICK: Final = 3
"""Layers from which on what hangs in the air is no roof and no deck."""

THIN: Final = 0.1
"""Signals of a column that are fewer than this share of others in it are no surface."""

Cells = NDArray[np.int64]
Marks = NDArray[np.bool_]


class Uniformity(NamedTuple):
    """How p-values of noise lie between 0 and 1."""

    returns: int  #: Their number.
    times: float  #: Returns up to one of the values over that share of all: the farthest from 1.
    at: float  #: That value.


def uniformity(counts: NDArray[np.int64]) -> Uniformity | None:
    """How far small p-values are from uniform; None where too few returns tell it.

    Parameters
    ----------
    counts : (len(P_VALUES) + 1,) int64
        Returns up to each value and not up to the one before, and beyond all.
    """
    total, value = int(counts.sum()), np.array(P_VALUES)
    times = np.cumsum(counts)[:-1] / (max(total, 1) * value)
    off = np.where(total * value >= ENOUGH, np.abs(np.log(np.maximum(times, 1e-6))), -1.0)
    worst = int(off.argmax())
    return Uniformity(total, float(times[worst]), P_VALUES[worst]) if off[worst] >= 0 else None


def floating(kept: Cells, stray: Marks) -> Cells:
    """Signals that float, by column.

    Parameters
    ----------
    kept : (a, b, c) int64
        Signals of each cell; layers rise along the last axis, gaps of more than :data:`GAP` may be
        closed to that [count].
    stray : (a, b, c) bool
        Cells whose signals are no surface: nothing floats above these.

    Returns
    -------
    (a, b) int64
    """
    layers = np.arange(kept.shape[2])
    solid = np.where(stray, 0, kept)
    # The last layer with a surface below each one, and what stands in a column up to there.
    wide = ndimage.maximum_filter(solid > 0, (3, 3, 1), mode="constant")
    last = np.maximum.accumulate(np.where(wide, layers, -1), axis=2)
    before = np.concatenate([np.full((*kept.shape[:2], 1), -1), last[:, :, :-1]], axis=2)
    stands = np.take_along_axis(np.cumsum(solid, axis=2), np.maximum(before, 0), axis=2)
    hangs = (kept > 0) & (before >= 0) & (layers - before > GAP) & (stands > 0)
    aloft = np.where(np.logical_or.accumulate(hangs, axis=2), kept, 0)
    count = aloft.sum(axis=2)
    below = np.where(hangs.any(axis=2), kept.sum(axis=2) - count, 0)
    thick = np.count_nonzero(aloft, axis=2) >= THICK
    found: Cells = np.where((thick & (below >= THIN * count)) | (count < THIN * below), count, 0)
    return found


def float_facts(
    kept: Cells,
    stray: Marks,
    at: tuple[Any, ...],
    sides: tuple[NDArray[np.int64], NDArray[np.int64]],
) -> dict[str, Any]:
    """What a report says of the signal that floats.

    Parameters
    ----------
    kept : (a, b, c) int64
        Signals of each cell around some columns [count].
    stray : (a, b, c) bool
        As in :func:`floating`.
    at : tuple
        Index of these columns in the first two axes.
    sides : two of (n,) int64
        Their south-western corners along x and y [quanta].

    Returns
    -------
    dict
        ``afloat``: signals that float, all signals, columns with some that float [count]; where
        there are any, the corners of the first and last of these columns along x and y [quanta].
    """
    found = floating(kept, stray)[at]
    held = found > 0
    facts = [int(found.sum()), int(kept.sum(axis=2)[at].sum()), int(np.count_nonzero(held))]
    if held.any():
        for side, axis in zip(sides, (1, 0), strict=True):
            some = side[held.any(axis=axis)]
            facts += [int(some.min()), int(some.max())]
    return {"afloat": facts}
