"""Which level surfaces are water: those that are more level than land is.

Plains and the crests of hills share a metre of height over hundreds of metres too. They are looked
at like water, since noise below them counts in the same way, but they are none: means over a
hundred metres, which waves leave alone, follow no level line there.
"""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

MEAN_CELLS: Final = 2
"""Cells to each side that waves are averaged over [count]."""

_FEWEST: Final = 15
_MANY: Final = 25
"""Cells with a surface around one that says whether it is water, at least, and of which the whole
departure is allowed [count]."""

SWELL_CELLS: Final = 7
"""The same for swell [count]."""

_NEARLY_ALL: Final = 0.8
_SWELL: Final = 0.4
"""Share of cells with a surface that show swell, and part of its height that such means keep."""

_ALIKE_M: Final = 1.0
"""Surfaces of cells that differ by more are not of the same water [m]."""

_SLOPE: Final = 1e-3
_OFF_M: Final = 0.1
"""Slope of water, and standard deviation of means about their line, at most [m/m, m]."""

_DARK_SLOPE: Final = 5e-4
_DARK_OFF_M: Final = 0.08
"""The same of a surface without light from below: dry flats are hardly as level [m/m, m]."""


def beside(index: NDArray[np.int64], values: NDArray[Any], reach: int) -> NDArray[np.float64]:
    """Values of the cells from -reach to reach of each, (n, 2 reach + 1); NaN where none is."""
    found = np.full((len(index), 2 * reach + 1), np.nan)
    for step in range(-reach, reach + 1):
        at = np.minimum(np.searchsorted(index, index + step), max(len(index) - 1, 0))
        there = index[at] == index + step
        found[there, step + reach] = values[at[there]]
    return found


def is_water(
    index: NDArray[np.int64],
    level_m: NDArray[np.float64],
    below: NDArray[np.bool_],
    lit: NDArray[np.bool_],
    cell_m: float,
    reach: int,
) -> NDArray[np.bool_]:
    """Cells whose surface is water, as half of those around at its height show, (n,) bool.

    A surface shows it that is as level as water, or that lies above a fuller layer.

    Parameters
    ----------
    level_m : (n,) float64
        Surface of each cell; NaN where there is none [m].
    below : (n,) bool
        Cells whose fullest layer lies below their surface: it is a floor.
    lit : (n,) bool
        Cells with light from below their surface.
    reach : int
        Cells to each side [count].
    """
    wet = np.isfinite(level_m)
    shown = wet & (below | _level_lines(index, level_m, lit, cell_m, reach))
    around = beside(index[wet], level_m[wet], reach) - level_m[wet, None]
    alike = np.abs(around) <= _ALIKE_M
    many = (alike & (beside(index[wet], shown[wet], reach) > 0.0)).sum(axis=1)
    water = np.zeros(len(index), np.bool_)
    water[wet] = 2 * many >= alike.sum(axis=1)
    return water


def _level_lines(
    index: NDArray[np.int64],
    level_m: NDArray[np.float64],
    lit: NDArray[np.bool_],
    cell_m: float,
    reach: int,
) -> NDArray[np.bool_]:
    """Cells around which means along the track follow a level line, (n,) bool.

    Means over a hundred metres do on still water. Swell is longer, but averages out over three
    hundred; ground does not.
    """
    wet = np.isfinite(level_m)
    some, level = index[wet], level_m[wet]
    found = np.zeros(len(index), np.bool_)
    if not len(some):
        return found
    (n, slope, still), (_, slow, long), (_, _, every) = (
        _line(some, _mean(some, level, cells), cell_m, reach)
        for cells in (MEAN_CELLS, SWELL_CELLS, 0)
    )
    steepest, off_m = (
        np.where(lit[wet], *both) for both in ((_SLOPE, _DARK_SLOPE), (_OFF_M, _DARK_OFF_M))
    )
    few = _OFF_M * np.minimum(n / _MANY, 1.0)
    calm = (n >= _FEWEST) & (slope <= steepest) & (still <= np.minimum(off_m, few))
    swell = (n >= _NEARLY_ALL * (2 * reach + 1)) & (slow <= steepest) & (long <= off_m)
    found[np.flatnonzero(wet)] = calm | (swell & (long <= _SWELL * every))
    return found


def _mean(index: NDArray[np.int64], values: NDArray[np.float64], reach: int) -> NDArray[np.float64]:
    """Mean of the values of the cells around each, (n,) float64."""
    mean: NDArray[np.float64] = np.nanmean(beside(index, values, reach), axis=1)
    return mean


def _line(
    index: NDArray[np.int64], values: NDArray[np.float64], cell_m: float, reach: int
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    """Cells around each, the steepness of the line through their values, and the deviation from it.

    (n,) each [count, m/m, m].
    """
    off = beside(index, values, reach) - values[:, None]
    there = np.isfinite(off)
    x = np.arange(-reach, reach + 1) * cell_m
    n = there.sum(axis=1)
    weight, off = there / n[:, None], np.where(there, off, 0.0)
    x0, z0 = weight @ x, (weight * off).sum(axis=1)
    xx = np.maximum(weight @ x**2 - x0**2, cell_m**2)
    xz, zz = (weight * off) @ x - x0 * z0, (weight * off**2).sum(axis=1) - z0**2
    return n, np.abs(xz / xx), np.sqrt(np.maximum(zz - xz**2 / xx, 0.0))
