"""Rivers and ponds: short level surfaces between banks, with light from below.

A kilometre of level cells tells a lake from land. A river has a few, and so have a field and the
bottom of a valley. What land has not is a thin level layer with photons of another one, or of light
that water scatters, below it: that tells rivers and ponds, and only those that are seen into. Glass
and crops are as thin and level, but the ground below them goes on at its height: the ground beyond
both ends, not trees on it, has to rise above a river.
"""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.altimetry.water.levelness import beside
from spl_batch.constants import QUANTA_PER_M

_FEWEST: Final = 4
_MAYBE_CELLS: Final = 8
MOST_CELLS: Final = 110
"""Cells of a run, at least, and without light from below [count]; longer ones than the most are
lakes, which need no banks."""

_STEP_M: Final = 0.15
"""From cell to cell a level surface changes by this at most, as photons show it [m]."""

_OFF_M: Final = 0.08
_SLOPE: Final = 1e-3
"""Standard deviation of cells about their line, and its slope, at most [m, m/m]."""

_LAYER_M: Final = 0.5
_THIN_M: Final = 0.3
_THIN: Final = 3.0
_THIN_SD: Final = 3.0
"""Half-thickness of a cell's layer, and of a surface; times as many photons as in as much height
above or below it, and standard deviations beside that, at least [m, m, 1, 1]."""

_DEEP_M: Final = (1.0, 10.0)
_TIMES: Final = 1.5
_SURE_SD: Final = 4.0
"""Where light from below is looked for; times the photons as far above, and standard deviations
beside that [m, 1, 1]."""

_BANK_M: Final = 0.5
"""Height above a river of a level surface that is its bank [m]."""

_SEEN: Final = 3
"""Photons that show the surface over a brighter bottom beside a run [count]."""

_PART: Final = 4
_LEAST: Final = 4
"""A metre of a bank's ground holds this part of the photons of the fullest, and so many, at least
[1, count]."""

BANK_CELLS: Final = 10
"""Cells beyond an end of which one lies higher, or shows the surface over a bottom [count]."""


class Runs(NamedTuple):
    """Runs of cells beside each other whose layers are level."""

    first: NDArray[np.intp]  #: (r,): row of the first cell.
    stop: NDArray[np.intp]  #: (r,): row after the last one.


class Rivers(NamedTuple):
    """Rivers and ponds by cell."""

    level_m: NDArray[np.float64]  #: (n,): their surface [m]; NaN where there is none.
    #: (n,): level between higher banks, with nothing below: a river, or land.
    maybe: NDArray[np.bool_]


def between_banks(
    index: NDArray[np.int64],
    cell: NDArray[np.intp],
    height: NDArray[np.int32],
    layer: NDArray[np.int64],
    cell_m: float,
) -> Rivers:
    """Surface of rivers and ponds, and what may be one.

    Parameters
    ----------
    index : (n,) int64
        Cell numbers, in order.
    cell, height : (p,) intp, (p,) int32
        Row of each photon's cell; photons [quanta].
    layer : (n,) int64
        Half-metre of the highest layer that a cell shows.
    cell_m : float
        Length of a cell [m].
    """
    n = len(index)
    found = Rivers(np.full(n, np.nan), np.zeros(n, np.bool_))
    if not n:
        return found
    level_m = _middle(index, _means(cell, height, layer))
    runs = _runs(index, level_m)
    over_m = height / QUANTA_PER_M - level_m[cell]
    bands = (
        (-_THIN_M, _THIN_M), (_THIN_M, 3.0 * _THIN_M), (-3.0 * _THIN_M, -_THIN_M),
        (-_DEEP_M[1], -_DEEP_M[0]), _DEEP_M,
    )  # fmt: skip
    counts = [np.bincount(cell[(over_m > a) & (over_m <= b)], minlength=n) for a, b in bands]
    surface, above, under, below, sky = (_sums(runs, values) for values in counts)
    lit = below > _TIMES * sky + _SURE_SD * np.sqrt(2.0 * (sky + 1.0))
    beside_it = _THIN * np.maximum(above, under)
    thin = surface > beside_it + _THIN_SD * np.sqrt(surface + _THIN * beside_it)
    level = thin & _level(runs, level_m, cell_m)
    order = np.argsort(cell, kind="stable")
    photons = height[order] / QUANTA_PER_M, np.searchsorted(cell[order], np.arange(n + 1))
    rise_m = _rises(runs, level, index, level_m, photons)
    for i in np.flatnonzero(level & lit & (rise_m > _STEP_M)).tolist():
        first, stop = int(runs.first[i]), int(runs.stop[i])
        found.level_m[first:stop] = level_m[first:stop]
        for end, step in ((first, -1), (stop - 1, 1)):
            more = _over_bottom(index, level_m, photons, end, step)
            found.level_m[more] = level_m[end]
    dark = level & ~lit & (runs.stop - runs.first >= _MAYBE_CELLS)
    for i in np.flatnonzero(dark & np.isfinite(rise_m) & (rise_m > _BANK_M)).tolist():
        found.maybe[runs.first[i] : runs.stop[i]] = True
    return found


def _means(
    cell: NDArray[np.intp], height: NDArray[np.int32], layer: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Mean height of each cell's layer, (n,) float64 [m]."""
    half = QUANTA_PER_M // 2
    middle = (layer * half + half // 2).astype(np.float64)
    for reach_m in (2.0 * _LAYER_M, _LAYER_M):
        off = height - middle[cell]
        near = np.abs(off) <= reach_m * QUANTA_PER_M
        total = np.bincount(cell[near], np.rint(off[near]), len(layer))
        middle += np.rint(total / np.maximum(np.bincount(cell[near], minlength=len(layer)), 1))
    found: NDArray[np.float64] = middle / QUANTA_PER_M
    return found


def _middle(index: NDArray[np.int64], level_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Median of each cell and those beside it where both are there, (n,) float64 [m]."""
    three = beside(index, level_m, 1)
    whole = np.isfinite(three).all(axis=1)
    found: NDArray[np.float64] = np.where(whole, np.sort(three, axis=1)[:, 1], level_m)
    return found


def _over_bottom(
    index: NDArray[np.int64],
    level_m: NDArray[np.float64],
    photons: tuple[NDArray[np.float64], NDArray[np.intp]],
    end: int,
    step: int,
) -> list[int]:
    """Rows of cells beyond an end of a run that show its surface over a brighter bottom.

    ``photons``: heights by cell [m], and where each cell's begin; ``step``: 1 or -1.
    """
    height_m, edges = photons
    found: list[int] = []
    for at in range(end + step, end + step * (BANK_CELLS + 1), step):
        inside = 0 <= at < len(index) and abs(index[at] - index[end]) == abs(at - end)
        if not inside or level_m[at] > level_m[end] + _STEP_M:
            break
        off = height_m[edges[at] : edges[at + 1]] - level_m[end]
        if np.count_nonzero(np.abs(off) <= _THIN_M) < _SEEN:
            break
        found.append(at)
    return found


def _runs(index: NDArray[np.int64], level_m: NDArray[np.float64]) -> Runs:
    """Runs of cells that differ by little from one to the next."""
    joined = (np.diff(index) == 1) & (np.abs(np.diff(level_m)) <= _STEP_M)
    edges = np.concatenate([[0], np.flatnonzero(~joined) + 1, [len(index)]])
    first, stop = edges[:-1], edges[1:]
    some = (stop - first >= _FEWEST) & (stop - first <= MOST_CELLS)
    return Runs(first[some], stop[some])


def _sums(runs: Runs, values: NDArray[np.int64]) -> NDArray[np.float64]:
    """Sums over each run, its first and last cell left out: (r,) float64."""
    total = np.concatenate([[0], np.cumsum(values)])
    found: NDArray[np.float64] = (total[runs.stop - 1] - total[runs.first + 1]).astype(np.float64)
    return found


def _level(runs: Runs, level_m: NDArray[np.float64], cell_m: float) -> NDArray[np.bool_]:
    """Runs that follow a level line, (r,) bool."""
    found = np.zeros(len(runs.first), np.bool_)
    for i, (first, stop) in enumerate(zip(*(v.tolist() for v in runs), strict=True)):
        z = level_m[first + 1 : stop - 1] if stop - first > _FEWEST else level_m[first:stop]
        x = (np.arange(len(z)) - (len(z) - 1) / 2.0) * cell_m
        slope = float(x @ z / (x @ x))
        off = z - z.mean() - slope * x
        error = float(np.sqrt(off @ off / max(len(z) - 2, 1) / (x @ x)))
        found[i] = abs(slope) <= _SLOPE + 2.0 * error and np.sqrt(off @ off / len(z)) <= _OFF_M
    return found


def _rises(
    runs: Runs,
    asked: NDArray[np.bool_],
    index: NDArray[np.int64],
    level_m: NDArray[np.float64],
    photons: tuple[NDArray[np.float64], NDArray[np.intp]],
) -> NDArray[np.float64]:
    """Height over each run that ground reaches beyond both of its ends, (r,) float64 [m].

    An end beyond which nothing is seen does not count; infinite where both are so, and where
    nothing is ``asked``. ``photons``: heights by cell [m], and where each cell's begin.
    """
    height_m, edges = photons
    found = np.full(len(runs.first), np.inf)
    for i in np.flatnonzero(asked).tolist():
        for end, step in ((int(runs.first[i]), -1), (int(runs.stop[i]) - 1, 1)):
            beyond = range(end + step, end + step * (BANK_CELLS + 1), step)
            rise_m = [
                _ground_m(height_m[edges[at] : edges[at + 1]]) - level_m[end]
                for at in beyond
                if 0 <= at < len(index) and abs(index[at] - index[end]) <= BANK_CELLS
            ]
            if np.isfinite(rise_m).any():
                found[i] = min(found[i], np.nanmax(rise_m))
    return found


def _ground_m(height_m: NDArray[np.float64]) -> float:
    """Height of the lowest metre that holds a good part of a cell's photons [m]; NaN if none."""
    if not len(height_m):
        return np.nan
    half = np.floor(height_m / _LAYER_M).astype(np.int64)
    lowest = half.min(initial=0)
    metre = np.convolve(np.bincount(half - lowest), [1, 1])
    many = metre >= max(metre.max() / _PART, _LEAST)
    return float((int(many.argmax()) + lowest) * _LAYER_M) if many.any() else np.nan


def above_rivers(
    index: NDArray[np.int64], level_m: NDArray[np.float64], river_m: NDArray[np.float64], reach: int
) -> NDArray[np.bool_]:
    """Cells with a level surface higher than a river or pond within reach: its banks, (n,) bool."""
    found = np.zeros(len(index), np.bool_)
    if np.isfinite(river_m).any():
        lowest = np.nan_to_num(beside(index, river_m, reach), nan=np.inf).min(axis=1)
        found = level_m > lowest + _BANK_M
    return found
