"""Kept returns of places where nothing stands: no surface may rest on them.

The test keeps a stated share of pure noise, and what it keeps comes in clusters. Where the
survey sees no surface at all, off its edge or over dark water, such a cluster would be the
only ground for tens of metres. There the returns that were kept are few beside those that
were refused; where a surface is seen they are not. Our own rule, asked twice:

- of columns of the whole height: does anything stand in this place?
- of boxes around the return: does anything stand at this height? Beside a surface the
  column is full of its returns, and a cluster a hundred metres below it rests on nothing.
  A true floor of a quarry, shaft or canyon fills its own box, however deep it lies; ground
  that is seen through few gaps of a canopy continues, and fills a wider one.

Both count what was refused as well: in clean clouds and at night few returns make a surface.
How much of pure noise is kept, the cloud itself says, as the filter may be any: there are always
boxes that hold noise alone, and in them the least of what was delivered was kept.
"""

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from spl_batch.airborne.filter.box_counts import (
    cells_held,
    count_in_cells,
    in_marked_cells,
    lowest_and_highest,
)
from spl_batch.constants import NOISE_BACKGROUND, NOISE_SIGNAL
from spl_batch.lattice.tables import PointTable
from spl_batch.lattice.tiles import quanta

DOMAIN: Final = "space"

CELL_M: Final = 5.0
"""Edge of the cells in which returns are counted [m]."""

KEPT_SHARE: Final = 0.002
"""Twice the share of pure noise that the filter keeps by default: the least that is allowed for."""

NOISE_QUANTILE: Final = 0.1
NOISE_RETURNS: Final = 100
NOISE_SHARE: Final = 0.5
"""Of the wide boxes with so many returns, the tenth where least was kept tells the share that is
kept of noise. Where that is more than half, few boxes hold noise alone, and nothing is known."""


class Box(NamedTuple):
    """Cells around a cell, and the returns in them that noise may explain.

    Parameters
    ----------
    reach : int
        Columns on each side [count]; of layers one above and one below belong to it.
    cluster : int
        Returns that clusters of noise may have in it [count] ...
    share : float
        ... at most this share of those that were refused in it: clean clouds have no such
        clusters, and a box that reaches beyond an edge holds less of both [1/1].
    """

    reach: int
    cluster: int
    share: float


COLUMN: Final = Box(1, 12, 0.2)
"""15 m wide, of the whole height."""

BOXES: Final = (Box(1, 30, 0.2), Box(3, 60, 0.06))
"""15 m and 35 m wide, 15 m high; any surface that fills either is one. In much noise that is
0.13 returns per m2 if the surface is small, and 0.05 if it continues."""

Count = NDArray[np.int64]


def stray(table: PointTable, *, spare_above: bool = False) -> NDArray[np.bool_]:
    """Kept returns that are too few beside the refused ones around them.

    Parameters
    ----------
    table : PointTable
        Points of a place, in any order, with ``x, y, z, noise_class``.
    spare_above : bool
        Leave alone what lies above a surface, such as a wire of few returns: it is no ground,
        but it is a top.

    Returns
    -------
    (n,) bool
        True for signals in a column or a box with fewer of them than noise explains.
    """
    out = np.zeros(len(table), np.bool_)
    xyz, kind = (table["x"], table["y"], table["z"]), table["noise_class"]
    kinds, edge = (NOISE_SIGNAL, NOISE_BACKGROUND), quanta(CELL_M)
    extent = np.zeros((3, 2), np.int64)
    if lowest_and_highest(xyz, kind, kinds, extent) != 3:
        return out
    lattice = extent // edge
    corner = lattice[:, 0] * edge
    x, y, z = (np.zeros(count, np.bool_) for count in lattice[:, 1] - lattice[:, 0] + 1)
    cells_held(xyz, kind, kinds, corner, float(edge), (x, y, z))
    place = _close_gaps(x), _close_gaps(y), _close_gaps(z)
    kept, gone = (np.zeros([int(along[-1]) + 1 for along in place], np.int64) for _ in kinds)
    number = np.empty(len(table), np.int32)
    count_in_cells(xyz, kind, kinds, corner, float(edge), place, kept, gone, number)
    held = [_in_boxes(kept, gone, box) for box in BOXES]
    occupied = kept + gone > 0
    odds = _kept_of_noise(*(count[occupied] for count in held[-1]))
    bare = _bare_boxes(held, odds)
    if spare_above:
        bare &= ~np.logical_or.accumulate((kept > 0) & ~bare, axis=2)
    bare |= _bare_columns(kept, gone, odds)[:, :, None]
    in_marked_cells(number, bare.ravel(), out)
    return out


def _close_gaps(occupied: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Number of each cell along one axis; gaps wider than any box are shortened to just that."""
    held = np.flatnonzero(occupied)
    step = np.minimum(np.diff(held, prepend=held[0]), max(box.reach for box in BOXES) + 1)
    place = np.zeros(len(occupied), np.int64)
    place[held] = np.cumsum(step)
    return place


def _kept_of_noise(kept: Count, gone: Count) -> float:
    """Twice the kept returns for each that was refused, where noise is alone [1/1].

    Parameters
    ----------
    kept, gone : (n,) int64
        Returns of the widest box around each cell that holds any [count].
    """
    held = kept + gone
    told = held >= NOISE_RETURNS
    share = float(np.quantile(kept[told] / held[told], NOISE_QUANTILE)) if told.any() else 1.0
    return KEPT_SHARE if share > NOISE_SHARE else max(KEPT_SHARE, 2.0 * share / (1.0 - share))


def _bare_boxes(held: Sequence[tuple[Count, Count]], odds: float) -> NDArray[np.bool_]:
    """Cells around which no box holds more than noise explains."""
    bare = np.ones(held[0][0].shape, np.bool_)
    for box, (near, refused) in zip(BOXES, held, strict=True):
        bare &= near < _explained(refused, box, odds)
    return bare


def _bare_columns(kept: Count, gone: Count, odds: float) -> NDArray[np.bool_]:
    """Columns that, with those around them, hold no more than noise explains."""
    near, refused = (_around(count.sum(axis=2), COLUMN.reach, (0, 1)) for count in (kept, gone))
    bare: NDArray[np.bool_] = near < _explained(refused, COLUMN, odds)
    return bare


def _explained(refused: Count, box: Box, odds: float) -> NDArray[np.float64]:
    """Kept returns that noise may leave beside so many refused ones [count]."""
    limit: NDArray[np.float64] = np.minimum(box.cluster, box.share * refused)
    return limit + odds * refused


def _in_boxes(kept: Count, gone: Count, box: Box) -> tuple[Count, Count]:
    """Kept and refused returns of the box around each cell."""
    near, refused = (_around(_around(c, 1, (2,)), box.reach, (0, 1)) for c in (kept, gone))
    return near, refused


def _around(count: Count, reach: int, axes: tuple[int, ...]) -> Count:
    """Points in each cell and those on both sides of it along some axes."""
    for axis in axes:
        count = ndimage.convolve1d(
            count, np.ones(2 * reach + 1, np.int64), axis=axis, mode="constant"
        )
    return count
