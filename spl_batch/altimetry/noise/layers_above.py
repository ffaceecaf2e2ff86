"""What stands above the ground along a track: photons in boxes, and stacks denser than the sky.

Boxes are counted from the ground of their own cell, so that a slope tilts none, and seen over a
patch of track. :mod:`~spl_batch.altimetry.noise.fog` and :mod:`~spl_batch.altimetry.noise.mist`
judge the stacks.
"""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from spl_batch.altimetry.water.emptiest import sums_around
from spl_batch.altimetry.water.layers_of_cells import common_metre
from spl_batch.altimetry.water.level_water import REACH_CELLS
from spl_batch.constants import QUANTA_PER_M

BIN_M: Final = 3
"""Height of a box [m]."""

PATCH_CELLS: Final = 5
"""Cells to each side that a stack is seen over [count]."""

GROUND_CELLS: Final = 50
"""Cells to each side that ground is looked for below what hides it [count]."""

NEAR_M: Final = 1.5
"""What is nearer to the ground belongs to it [m]."""

_SEARCHED: Final = 160
"""Boxes above the ground that are looked at [count]."""

_STACK: Final = 3
"""Boxes that are looked at together [count]."""

_LEAST: Final = 10
"""Photons that show a layer in a patch [count]."""

SD: Final = 3.0
_SURE_SD: Final = 6.0
"""Standard deviations of the sky's noise that a stack, and a layer, exceed."""

_AROUND: Final = 20
"""Half-metres to each side of a surface whose photons tell what chance puts there [count]."""

_CHANCE_SD: Final = 4.0
"""Standard deviations: the fullest of many metres is looked at."""

_SURFACE: Final = (4, 0.3)
"""Photons, and share of a cell's signal, that its fullest metre holds where it is a surface."""


class Foot(NamedTuple):
    """Top of the ground."""

    quanta: NDArray[np.int64]  #: (n,): of each cell [quanta].
    known: NDArray[np.bool_]  #: (n,): whether it is, and in the patch.
    near: NDArray[np.bool_]


class Above(NamedTuple):
    """What stands above the ground of cells."""

    number: NDArray[np.int64]  #: (n,): cells.
    foot: NDArray[np.int64]  #: (n,): box that the ground ends in, from height 0.
    seen: NDArray[np.float64]  #: (n, boxes): photons of the patch, and the area seen [m2].
    seen_m2: NDArray[np.float64]
    sky: NDArray[np.float64]  #: (n, boxes): photons of the sky among them.
    squares: NDArray[np.float64]  #: (n, boxes): squares of the photons of each cell, summed.
    runs: "Runs"

    def cells(self) -> NDArray[np.int64]:
        """Cells of each run's patch, with photons or not: (r,) int64 [count]."""
        at, ends = self.number[self.runs.row], (self.number[:1], self.number[-1:])
        first = np.maximum(at - PATCH_CELLS, ends[0])
        found: NDArray[np.int64] = np.minimum(at + PATCH_CELLS, ends[1]) - first + 1
        return np.maximum(found, 2)


def above(
    index: NDArray[np.int64],
    cell: NDArray[np.intp],
    height: NDArray[np.int32],
    ground: tuple[NDArray[np.int64], NDArray[np.bool_]],
    gate: tuple[NDArray[np.int32], NDArray[np.int32]],
    cell_m: float,
) -> Above:
    """Look at what stands above the ground of the cells that have one.

    Parameters
    ----------
    index : (n,) int64
        Cell numbers, in order.
    cell : (p,) intp
        Row of each photon's cell.
    height : (p,) int32
        Photons [quanta].
    ground : ((n,) int64, (n,) bool)
        Top of the ground of each cell [quanta], and whether the cell is looked at.
    gate : ((n,) int32, (n,) int32)
        Lower and upper end of each cell's gate [quanta].
    """
    n, step = len(index), BIN_M * QUANTA_PER_M
    foot, some = ground[0] // step, ground[1]
    row = height // step - foot[cell]
    inside = some[cell] & (row >= 0) & (row < _SEARCHED)
    counted = np.bincount(cell[inside] * _SEARCHED + row[inside], minlength=n * _SEARCHED)
    boxes = counted.reshape(n, _SEARCHED)
    low, high = (end[:, None] / step - foot[:, None] - np.arange(_SEARCHED) for end in gate)
    area = (np.clip(high, 0.0, 1.0) - np.clip(low, 0.0, 1.0)) * (some[:, None] * cell_m * BIN_M)
    seen, seen_m2 = (sums_around(index, values, PATCH_CELLS) for values in (boxes, area))
    seen[~some] = 0.0
    sky = _sky(seen, seen_m2) * seen_m2
    squares = sums_around(index, boxes**2, PATCH_CELLS)
    return Above(index, foot, seen, seen_m2, sky, squares, _runs(_layers(seen, sky)))


def foot(
    index: NDArray[np.int64],
    cell: NDArray[np.intp],
    height: NDArray[np.int32],
    mode: NDArray[np.int64],
    noise: NDArray[np.float64],
) -> Foot:
    """Top of the ground of each cell.

    It is the height that many cells around share, or the fullest metre where that is a layer;
    between such cells it is interpolated.

    Parameters
    ----------
    index, cell, height
        As in :func:`above`.
    mode : (n,) int64
        Half-metre of each cell's fullest metre.
    noise : (n,) float64
        Photons of each cell that are noise, about [count].
    """
    n, half = len(index), QUANTA_PER_M // 2
    common, level = common_metre(index, mode, REACH_CELLS)
    mode = np.where(level, common, mode)
    inside = np.abs(height // half - mode[cell]) <= 1
    there = np.bincount(cell[inside], minlength=n)
    least, share = _SURFACE
    signal = np.bincount(cell, minlength=n) - noise
    around = np.abs(height // half - mode[cell]) <= _AROUND
    beside = np.bincount(cell[around], minlength=n) - there
    chance = beside * (1.5 / _AROUND)
    layer = (there >= np.maximum(least, share * signal)) & (
        there > chance + _CHANCE_SD * np.sqrt(chance) + 2.0
    )
    # One alone in a cloud is chance; ground shows itself in cells beside each other.
    surface = level | (layer & (sums_around(index, layer[:, None], PATCH_CELLS)[:, 0] > 1))
    if not surface.any():
        return Foot(np.zeros(n, np.int64), surface, surface)
    ground, known = _between(index, surface, mode * half + half // 2)
    own = sums_around(index, (surface & (there >= least))[:, None], PATCH_CELLS)[:, 0] > 0
    return Foot(ground + round(NEAR_M * QUANTA_PER_M), known, own)


def _between(
    index: NDArray[np.int64], some: NDArray[np.bool_], values: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Values of some cells, for the others from the two nearest within reach.

    Returns (n,) int64 and, where there is one, (n,) bool.
    """
    own, value = index[some], values[some]
    at = np.searchsorted(own, index)
    side = np.stack([np.clip(at - 1, 0, None), np.minimum(at, len(own) - 1)])
    apart = np.abs(own[side] - index)
    weight = np.where(apart <= GROUND_CELLS, 1.0 / np.maximum(apart, 1e-9), 0.0)
    total = weight.sum(axis=0)
    mean = (weight * value[side]).sum(axis=0) / np.where(total > 0, total, 1.0)
    return np.rint(mean).astype(np.int64), total > 0


def _sky(seen: NDArray[np.float64], seen_m2: NDArray[np.float64]) -> NDArray[np.float64]:
    """Density of the emptiest quarter of what lies above the ground, (n, 1) float64 [1/m2]."""
    whole = seen_m2 > 0.5 * seen_m2.max(axis=1, keepdims=True)
    density = np.sort(np.where(whole, seen / np.where(whole, seen_m2, 1.0), np.inf), axis=1)
    at = np.minimum(whole.sum(axis=1) // 4, _SEARCHED - 1)
    quarter = np.take_along_axis(density, at[:, None], axis=1)
    return np.where(np.isfinite(quarter), quarter, 0.0)


def _layers(seen: NDArray[np.float64], sky: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Bins of stacks that hold more than the sky: (n, bins) bool."""
    stack = np.ones(_STACK)
    many, few = (
        ndimage.convolve1d(values, stack, axis=1, mode="constant") for values in (seen, sky)
    )
    more = many > few + SD * np.sqrt(few + 1.0) + 1.0
    # The stack tells of the bins around its middle; at its ends those are empty.
    layer: NDArray[np.bool_] = more & (seen > sky)
    layer[:, 1:-1] |= layer[:, :-2] & layer[:, 2:]
    return layer


class Runs(NamedTuple):
    """Stacks of bins that hold more than the sky."""

    row: NDArray[np.int64]  #: (r,): cell of each, in order.
    first: NDArray[np.int64]  #: (r,): its first bin, and the one behind its last.
    stop: NDArray[np.int64]
    which: NDArray[np.int64]  #: (b,): run of each bin, and where the bin is.
    at: tuple[NDArray[np.int64], NDArray[np.int64]]

    def total(
        self, values: NDArray[np.float64], some: NDArray[np.bool_] | None = None
    ) -> NDArray[np.float64]:
        """Sums of values of bins, (r,) float64; ``some``: (b,) those of them that count."""
        own = values[self.at] if some is None else np.where(some, values[self.at], 0.0)
        return np.bincount(self.which, own, len(self.row)).astype(np.float64)


def _runs(layer: NDArray[np.bool_]) -> Runs:
    label, number = ndimage.label(layer, structure=[[0, 0, 0], [1, 1, 1], [0, 0, 0]])
    row, column = np.nonzero(layer)
    which = label[row, column] - 1
    first, stop = np.full(number, layer.shape[1]), np.zeros(number, np.int64)
    np.minimum.at(first, which, column)
    np.maximum.at(stop, which, column + 1)
    own = np.zeros(number, np.int64)
    own[which] = row
    return Runs(own, first, stop, which.astype(np.int64), (row, column))


def sure(layers: Above) -> NDArray[np.bool_]:
    """Runs that hold more than the sky could by chance, (r,) bool."""
    runs = layers.runs
    total, noise = runs.total(layers.seen), runs.total(layers.sky)
    found: NDArray[np.bool_] = total > noise + _SURE_SD * np.sqrt(noise + 1.0)
    return found & (total >= _LEAST)


def even(layers: Above, clumped: float, *, inner: bool = False) -> NDArray[np.bool_]:
    """Runs whose photons scatter among the cells of the patch as chance does: (r,) bool.

    Parameters
    ----------
    clumped : float
        Squared coefficient of variation of the density among boxes, at most.
    inner : bool
        Without the boxes at both ends: ground reaches into the lowest.
    """
    runs, k = layers.runs, layers.cells()
    some = inside(runs) if inner else np.ones(len(runs.which), np.bool_)
    count, square, spread = (
        runs.total(values, some) for values in (layers.seen, layers.squares, layers.seen**2)
    )
    boxes = np.maximum(np.bincount(runs.which, some, len(runs.row)), 1.0) * k
    mean = count / boxes
    dispersion = (square - spread / k) / np.maximum(count, 1.0) * (k / (k - 1))
    chance = SD * np.sqrt((2.0 + 1.0 / np.maximum(mean, 1e-9)) / boxes)
    found: NDArray[np.bool_] = dispersion <= 1.0 + clumped * mean + chance
    return found


def inside(runs: Runs) -> NDArray[np.bool_]:
    """Boxes of runs that are neither the first nor the last, (b,) bool."""
    column = runs.at[1]
    found: NDArray[np.bool_] = (column > runs.first[runs.which]) & (
        column < runs.stop[runs.which] - 1
    )
    return found


def shown_around(layers: Above, some: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Runs around which more than half of the patch has one of ``some``, (r,) bool.

    A patch shows itself in the cells beside it too; what one or two of them show is chance.
    """
    row = layers.runs.row
    shown = np.bincount(row[some], minlength=len(layers.number))[:, None] > 0
    found: NDArray[np.bool_] = sums_around(layers.number, shown, PATCH_CELLS)[row, 0] > PATCH_CELLS
    return found
