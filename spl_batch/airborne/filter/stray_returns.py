"""Stray returns: kept where nothing stands, so that no surface may rest on them.

The test keeps a stated share of pure noise, in clusters. Off the edge of a survey or over dark
water such a cluster would be the only ground for tens of metres. There kept returns are few beside
refused ones. Our own rule asks twice:

- of columns of the whole height: does anything stand in this place?
- of boxes around the return: does anything stand at this height? A cluster a hundred metres below a
  surface rests on nothing. A floor of a quarry or canyon fills its own box; ground that is seen
  through gaps of a canopy continues, and fills a wider one. At the rim of a swath little was
  refused, so deep below a surface a box must hold :data:`FEW` returns beside its fullest cell in
  any case: one cluster is no surface. As the gate widens downwards, that rim may lie
  :data:`BESIDE_M` outside of all ground.

Where clusters of dense noise reach any such number, the ground has to fill the place too
(:mod:`~spl_batch.airborne.filter.drowned_surfaces`).

In clean clouds few returns make a surface. As the filter may be any, the cloud itself tells the
share of pure noise that is kept: by the boxes of which least was kept, which hold noise alone.
"""

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from spl_batch.airborne.filter.box_counts import (
    cells_held,
    count_in_cells,
    count_values,
    in_marked_cells,
    lowest_and_highest,
)
from spl_batch.airborne.filter.drowned_surfaces import (
    below_surfaces,
    dense_noise,
    unfilled,
)
from spl_batch.constants import NOISE_BACKGROUND, NOISE_SIGNAL
from spl_batch.lattice.tables import PointTable
from spl_batch.lattice.tiles import Bounds, quanta

DOMAIN: Final = "space"

CELL_M: Final = 5.0
"""Edge of the cells in which returns are counted [m]."""

KEPT_SHARE: Final = 0.002
"""Twice the share of pure noise that the filter keeps by default: the least that is allowed for."""

FEW: Final = 10
DEEP: Final = 4
"""So few returns of the widest box, its fullest cell left out, are no surface, where one is near
and so many layers higher: two returns of noise and their afterpulses are [count, cells]."""

BESIDE_M: Final = 55.0
"""How far beside it that surface may stand, in whole cells: a beam 20 degrees off nadir goes so far
aside on 150 m below the ground. What a ground cell reads around itself holds it [m]."""

NOISE_QUANTILE: Final = 0.1
NOISE_RETURNS: Final = 100
NOISE_SHARE: Final = 0.5
"""Wide boxes with so many returns tell the share of noise that is kept, by the tenth where least
was kept. If that is more than half, few boxes hold noise alone, and nothing is known."""


class Box(NamedTuple):
    """Cells around a cell, and the returns in them that noise may explain."""

    reach: int  #: Columns on each side [count]; of layers one above and one below belong to it.
    cluster: int  #: Returns that clusters of noise may have in it [count] ...
    #: ... at most this share of those that were refused in it: clean clouds have no such clusters,
    #: and a box that reaches beyond an edge holds less of both [1/1].
    share: float


COLUMN: Final = Box(1, 12, 0.2)
"""15 m wide, of the whole height."""

BOXES: Final = (Box(1, 30, 0.2), Box(3, 60, 0.06))
"""15 m and 35 m wide, 15 m high; any surface that fills either is one. In much noise that is
0.13 returns per m2 if the surface is small, and 0.05 if it continues."""

Count = NDArray[np.int64]

_KINDS: Final = (NOISE_SIGNAL, NOISE_BACKGROUND)

BOTH_KINDS: Final = 3
"""What :func:`~spl_batch.airborne.filter.box_counts.lowest_and_highest` returns of both."""

_BESIDE: Final = round(BESIDE_M / CELL_M)
"""The same in cells on each side; no box reaches farther [count]."""


class Bare(NamedTuple):
    """Cells in which kept returns are too few beside the refused ones around them."""

    corner: Count  #: (3,) int64: lower corner of the lattice [quanta].
    place: tuple[Count, Count, Count]  #: Number of a cell along each axis, gaps closed.
    marked: NDArray[np.bool_]  #: (a, b, c): the cells.
    dense: NDArray[np.float32]  #: (a, b, c): noise where it is dense, 0 elsewhere [1/m3].
    lowest: NDArray[np.bool_]  #: (a, b, c): cells below all surfaces of their columns.
    kept: Count  #: (a, b, c): signals [count].

    def columns(self, region: Bounds) -> tuple[Count, Count]:
        """Numbers along x and y of the columns whose corner lies in a region, and holds points."""
        x, y = self._within(region)
        return self.place[0][x], self.place[1][y]

    def _within(self, region: Bounds) -> tuple[Count, Count]:
        """Indices of these columns on the lattice."""
        edge, found = quanta(CELL_M), []
        for axis, (low, high) in enumerate(
            ((region.xmin, region.xmax), (region.ymin, region.ymax))
        ):
            index = np.arange(len(self.place[axis]))
            at = self.corner[axis] + index * edge
            # Cells without points have the number of the first one.
            known = (self.place[axis] > 0) | (index == 0)
            found.append(np.flatnonzero(known & (low <= at) & (at < high)))
        return found[0], found[1]

    def corners(self, region: Bounds) -> tuple[Count, Count]:
        """Where the corners of these columns lie along x and y [quanta]."""
        x, y = (
            self.corner[axis] + index * quanta(CELL_M)
            for axis, index in enumerate(self._within(region))
        )
        return x, y

    def count_chances(
        self,
        table: PointTable,
        owned: NDArray[np.bool_],
        values: Sequence[float],
        counts: NDArray[np.int64],
    ) -> None:
        """Add p-values of noise below all surfaces to a histogram.

        Parameters
        ----------
        table : PointTable
            Points with ``x, y, z, noise_class, p_value``.
        owned : (n,) bool
            Those that count.
        values : sequence of m floats
            Values up to which p-values are counted.
        counts : (m + 1,) int64, added to
            Returns up to each value and not up to the one before, and beyond.
        """
        count_values(
            _xyz(table), (table["noise_class"], owned), _KINDS, table["p_value"], self.corner,
            float(quanta(CELL_M)), self.place, self.lowest, np.array(values), counts,
        )  # fmt: skip

    def noise(self, table: PointTable) -> NDArray[np.float32]:
        """Noise around points where it is dense, 0 elsewhere: (n,) [1/m3]."""
        if not self.dense.any():
            return np.zeros(len(table), np.float32)
        number = self._cells(table)
        return np.where(number >= 0, self.dense.ravel()[number], np.float32(0.0))

    def holds(self, table: PointTable) -> NDArray[np.bool_]:
        """Which signals lie in such a cell: (n,) bool."""
        out = np.zeros(len(table), np.bool_)
        in_marked_cells(self._cells(table), self.marked.ravel(), out)
        return out

    def _cells(self, table: PointTable) -> NDArray[np.int32]:
        """Number of the cell of each signal, -1 for other points."""
        nothing = np.zeros((2, *self.marked.shape), np.int64)
        return _count(self.corner, self.place, (nothing[0], nothing[1]), table)


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
    bare = bare_cells(table, spare_above=spare_above)
    return np.zeros(len(table), np.bool_) if bare is None else bare.holds(table)


def bare_cells(table: PointTable, *, spare_above: bool = False) -> Bare | None:
    """Cells whose signals are stray; None where there are no two kinds to compare.

    Parameters
    ----------
    table, spare_above
        As in :func:`stray`.
    """
    edge, ends = quanta(CELL_M), np.zeros((3, 2), np.int64)
    if lowest_and_highest(_xyz(table), table["noise_class"], _KINDS, ends) != BOTH_KINDS:
        return None
    first, last = ends[:, 0] // edge, ends[:, 1] // edge
    corner = first * edge
    x, y, z = (np.zeros(count, np.bool_) for count in last - first + 1)
    cells_held(_xyz(table), table["noise_class"], _KINDS, corner, float(edge), (x, y, z))
    place = _close_gaps(x, _BESIDE), _close_gaps(y, _BESIDE), _close_gaps(z, DEEP - 1)
    kept, gone = (np.zeros([int(along[-1]) + 1 for along in place], np.int64) for _ in _KINDS)
    _count(corner, place, (kept, gone), table)
    held = [_in_boxes(kept, gone, box) for box in BOXES]
    occupied = kept + gone > 0
    odds = _kept_of_noise(*(count[occupied] for count in held[-1]))
    bare = _bare_boxes(held, odds)
    width = 2 * BOXES[-1].reach + 1
    beside = held[-1][0] - ndimage.maximum_filter(kept, (width, width, 3), mode="constant")
    bare |= (beside < FEW) & _deep_below((kept > 0) & ~bare)
    if spare_above:
        bare &= ~np.logical_or.accumulate((kept > 0) & ~bare, axis=2)
    else:
        bare |= unfilled(kept, gone)
    bare |= _bare_columns(kept, gone, odds)[:, :, None]
    lowest = below_surfaces((kept > 0) & ~bare)
    return Bare(corner, place, bare, dense_noise(kept, gone), lowest, kept)


def _xyz(table: PointTable) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int32]]:
    return table["x"], table["y"], table["z"]


def _count(
    corner: Count, place: tuple[Count, Count, Count], counts: tuple[Count, Count], table: PointTable
) -> NDArray[np.int32]:
    """Add up the points of both kinds by cell; the cell of each kept one, -1 for others."""
    edge, number = float(quanta(CELL_M)), np.empty(len(table), np.int32)
    kind, (kept, gone) = table["noise_class"], counts
    count_in_cells(_xyz(table), kind, _KINDS, corner, edge, place, kept, gone, number)
    return number


def _close_gaps(occupied: NDArray[np.bool_], reach: int) -> NDArray[np.int64]:
    """Number of each cell along one axis; wider gaps are shortened to what lies beyond reach."""
    held = np.flatnonzero(occupied)
    step = np.minimum(np.diff(held, prepend=held[0]), reach + 1)
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


def _deep_below(standing: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Cells deep below something that stands near, by the number of layers that hold points."""
    width = 2 * _BESIDE + 1
    wide: NDArray[np.bool_] = ndimage.maximum_filter(standing, (width, width, 1), mode="constant")
    below = np.zeros(standing.shape, np.bool_)
    if standing.shape[2] > DEEP:
        higher = np.logical_or.accumulate(wide[:, :, ::-1], axis=2)[:, :, ::-1]
        below[:, :, :-DEEP] = higher[:, :, DEEP:]
    return below


def _bare_columns(kept: Count, gone: Count, odds: float) -> NDArray[np.bool_]:
    """Columns that, with those around them, hold no more than noise explains."""
    near, refused = (_around(count.sum(axis=2), COLUMN.reach, (0, 1)) for count in (kept, gone))
    bare: NDArray[np.bool_] = near < _explained(refused, COLUMN, odds)
    return bare


def _explained(refused: Count, box: Box, odds: float) -> NDArray[np.float64]:
    """Kept returns that noise may leave beside ``refused`` ones [count]."""
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
