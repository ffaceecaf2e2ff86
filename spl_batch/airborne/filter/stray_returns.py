"""Stray returns: kept where nothing stands, so that no surface may rest on them.

Domain: space.

The test keeps a stated share of pure noise, in clusters. Off the edge of a survey or over dark
water such a cluster would be the only ground for tens of metres. There kept returns are few beside
refused ones. Our own rule asks twice:

- of columns of the whole height: does anything stand in this place?
- of boxes around the return: does anything stand at this height? A cluster a hundred metres below a
  surface rests on nothing. A floor of a quarry or canyon fills its own box; ground that is seen
  through gaps of a canopy continues, and fills a wider one.

Where clusters of dense noise reach any such number, the ground has to fill the place too
(:mod:`~spl_batch.airborne.filter.drowned_surfaces`).

In clean clouds few returns make a surface. As the filter may be any, the cloud itself gives the
share of pure noise that is kept: by the boxes of which least was kept, which hold noise alone.
"""

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.beams.dependent_returns import dependents
from spl_batch.airborne.filter.drowned_surfaces import (
    SQUARE,
    around,
    below_surfaces,
    dense_noise,
    unfilled,
)
from spl_batch.airborne.noise.haze import CUBE_M
from spl_batch.airborne.settings import FilterSettings
from spl_batch.constants import NOISE_BACKGROUND, NOISE_SIGNAL
from spl_batch.lattice.tables import PointTable
from spl_batch.lattice.tiles import Bounds, quanta

CELL_M: Final = CUBE_M
"""Edge of the cells in which returns are counted [m]."""

KEPT_SHARE: Final = 2.0 * FilterSettings().alpha
"""Twice the share of pure noise that the filter keeps by default: the least that is allowed for."""

NOISE_QUANTILE: Final = 0.1
NOISE_RETURNS: Final = 100
"""Wide boxes with so many returns, most of them refused, give the share of noise that is kept, by
the tenth where least was kept. Without any nothing is known."""


class Box(NamedTuple):
    """Cells around a cell, and the returns in them that noise may explain."""

    reach: int  #: Columns on each side [count]; of layers one above and one below belong to it.
    cluster: int  #: Returns that clusters of noise may have in it [count] ...
    #: ... at most this share of those that were refused in it: clean clouds have no such clusters,
    #: and a box that reaches beyond an edge holds less of both [1/1].
    share: float


COLUMN: Final = Box(1, 12, 0.2)
"""15 m wide, of the whole height."""

BOXES: Final = (Box(1, 30, 0.2), Box(SQUARE, 60, 0.06))
"""15 m and 35 m wide, 15 m high; any surface that fills either is one. In much noise that is
0.13 returns per m2 if the surface is small, and 0.05 if it continues."""

Count = NDArray[np.int64]

GAP: Final = SQUARE
"""Empty cells along an axis that are kept of a wider gap: no box, no square of drowned surfaces and
nothing that floats reaches farther [count]."""


class Bare(NamedTuple):
    """Cells in which kept returns of a table are too few beside the refused ones around them."""

    corner: tuple[int, ...]  #: Lower corner of the lattice [quanta].
    place: tuple[Count, ...]  #: Number of a cell along each axis, gaps closed.
    marked: NDArray[np.bool_]  #: (a, b, c): the cells.
    dense: NDArray[np.float32]  #: (a, b, c): noise where it is dense, 0 elsewhere [1/m3].
    lowest: NDArray[np.bool_]  #: (a, b, c): cells below all surfaces of their columns.
    kept: Count  #: (a, b, c): signals, dependent ones left out [count].
    rows: NDArray[np.int32]  #: (m,): points of the table that were kept or refused.
    cell: NDArray[np.int32]  #: (m,): cell of each of them in ``marked.ravel()``.

    def columns(self, region: Bounds) -> tuple[tuple[Count, Count], tuple[Count, Count]]:
        """Columns that hold points and whose corner lies in a region.

        Their numbers along x and y, and where their corners lie along both [quanta].
        """
        ends = ((region.xmin, region.xmax), (region.ymin, region.ymax))
        numbers, corners = [], []
        for (low, high), corner, place in zip(ends, self.corner, self.place, strict=False):
            index = np.arange(len(place))
            at = corner + index * quanta(CELL_M)
            # Cells without points have the number of the first one.
            chosen = ((place > 0) | (index == 0)) & (low <= at) & (at < high)
            numbers.append(place[chosen])
            corners.append(at[chosen])
        return (numbers[0], numbers[1]), (corners[0], corners[1])

    def count_chances(
        self,
        p_value: NDArray[np.float32],
        owned: NDArray[np.bool_],
        values: Sequence[float],
        counts: NDArray[np.int64],
    ) -> None:
        """Add p-values of noise below all surfaces to a histogram.

        Parameters
        ----------
        p_value : (n,) float32
            Of the table; NaN counts nowhere.
        owned : (n,) bool
            Points that count.
        values : sequence of m floats
            Values up to which p-values are counted, ascending.
        counts : (m + 1,) int64, added to
            Returns up to each value and not up to the one before, and beyond.
        """
        chosen = p_value[self.rows[self.lowest.ravel()[self.cell] & owned[self.rows]]]
        at = np.searchsorted(values, chosen[~np.isnan(chosen)].astype(np.float64))
        counts += np.bincount(at, minlength=len(counts))

    def noise(self, count: int) -> NDArray[np.float32]:
        """Noise around the table's points where it is dense, 0 elsewhere: (n,) [1/m3]."""
        out = np.zeros(count, np.float32)
        if self.dense.any():
            out[self.rows] = self.dense.ravel()[self.cell]
        return out

    def holds(self, noise_class: NDArray[np.uint8]) -> NDArray[np.bool_]:
        """Which signals of the table lie in a marked cell: (n,) bool."""
        out = np.zeros(len(noise_class), np.bool_)
        out[self.rows[self.marked.ravel()[self.cell]]] = True
        out &= noise_class == NOISE_SIGNAL
        return out


def stray(table: PointTable, *, spare_above: bool = False) -> NDArray[np.bool_]:
    """Kept returns that are too few beside the refused ones around them.

    Parameters
    ----------
    table : PointTable
        Points of a region, in any order, with ``x, y, z, noise_class``.
    spare_above : bool
        Leave alone what lies above a surface, such as a wire of few returns: it is no ground,
        but it is a top.

    Returns
    -------
    (n,) bool
        True for signals in a column or a box with fewer of them than noise explains.
    """
    bare = bare_cells(table, spare_above=spare_above)
    if bare is None:
        return np.zeros(len(table), np.bool_)
    return bare.holds(table["noise_class"])


def bare_cells(table: PointTable, *, spare_above: bool = False) -> Bare | None:
    """Cells whose signals are stray; None where there are no two kinds to compare.

    Parameters
    ----------
    table, spare_above
        As in :func:`stray`.
    """
    kind, edge = table["noise_class"], quanta(CELL_M)
    rows = np.flatnonzero((kind == NOISE_SIGNAL) | (kind == NOISE_BACKGROUND))
    signal = kind[rows] == NOISE_SIGNAL
    if signal.all() or not signal.any():
        return None
    first, place, index = [], [], []
    for axis in "xyz":
        at = table[axis][rows] // edge
        first.append(int(at.min()))
        at = at - first[-1]
        place.append(_close_gaps(np.bincount(at) > 0))
        index.append(place[-1][at])
    shape = tuple(int(along[-1]) + 1 for along in place)
    cell = np.ravel_multi_index(index, shape)
    # An afterpulse of noise is no evidence beside it.
    own = signal & ~dependents(table)[rows]
    kept, gone = (
        np.bincount(cell[of], minlength=math.prod(shape)).reshape(shape) for of in (own, ~signal)
    )
    held = [_in_boxes(kept, gone, box) for box in BOXES]
    occupied = kept + gone > 0
    odds = _kept_of_noise(*(count[occupied] for count in held[-1]))
    bare = _bare_boxes(held, odds)
    if spare_above:
        bare &= ~np.logical_or.accumulate((kept > 0) & ~bare, axis=2)
    else:
        bare |= unfilled(kept, gone)
    bare |= _bare_columns(kept, gone, odds)[:, :, None]
    lowest = below_surfaces((kept > 0) & ~bare)
    return Bare(
        tuple(edge * low for low in first), tuple(place), bare, dense_noise(kept, gone), lowest,
        kept, rows.astype(np.int32), cell.astype(np.int32),
    )  # fmt: skip


def _close_gaps(occupied: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Number of each cell along one axis; wider gaps are shortened to :data:`GAP`."""
    held = np.flatnonzero(occupied)
    place = np.zeros(len(occupied), np.int64)
    place[held] = np.cumsum(np.minimum(np.diff(held, prepend=held[0]), GAP + 1))
    return place


def _kept_of_noise(kept: Count, gone: Count) -> float:
    """Twice the kept returns for each that was refused, where noise is alone [1/1].

    ``kept, gone`` (n,): returns of the widest box around each cell that holds any [count].
    """
    held = kept + gone
    emptied = (held >= NOISE_RETURNS) & (gone > kept)
    if not emptied.any():
        return KEPT_SHARE
    share = float(np.quantile(kept[emptied] / held[emptied], NOISE_QUANTILE))
    return max(KEPT_SHARE, 2.0 * share / (1.0 - share))


def _bare_boxes(held: Sequence[tuple[Count, Count]], odds: float) -> NDArray[np.bool_]:
    """Cells around which no box holds more than noise explains."""
    bare = np.ones(held[0][0].shape, np.bool_)
    for box, (near, refused) in zip(BOXES, held, strict=True):
        bare &= near < _explained(refused, box, odds)
    return bare


def _bare_columns(kept: Count, gone: Count, odds: float) -> NDArray[np.bool_]:
    """Columns that, with those around them, hold no more than noise explains."""
    near, refused = (around(count.sum(axis=2), COLUMN.reach, (0, 1)) for count in (kept, gone))
    bare: NDArray[np.bool_] = near < _explained(refused, COLUMN, odds)
    return bare


def _explained(refused: Count, box: Box, odds: float) -> NDArray[np.float64]:
    """Kept returns that noise may leave beside ``refused`` ones [count]."""
    limit: NDArray[np.float64] = np.minimum(box.cluster, box.share * refused)
    return limit + odds * refused


def _in_boxes(kept: Count, gone: Count, box: Box) -> tuple[Count, Count]:
    """Kept and refused returns of the box around each cell."""
    near, refused = (around(around(c, 1, (2,)), box.reach, (0, 1)) for c in (kept, gone))
    return near, refused
