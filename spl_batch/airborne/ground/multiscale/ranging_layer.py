"""How thick a layer of ground returns is: the ranging spread that a ground method reckons with.

What sensors state is an upper figure: bare cells of real surveys scatter by half of it. A layer as
thick as stated takes in grass and moss, one too thin loses returns of the ground. The cloud itself
tells: where a tenth of its cells are as smooth as ranges can be stated to scatter, they are bare,
and their scatter is that of the ranges. Heath and closed forest have too few such cells; there the
least spread is reckoned with, which finds the same terrain in clouds twice as noisy where it is
even. Where the lowest returns step by metres it loses ground under trees: there the stated one
counts.

Each block of an absolute grid is told by itself and the eight around it, which every ground cell
that owns points of it has as a whole. What a cell or a survey is on the average decides nothing:
neighbouring ground cells would decide differently, and the terrain had a step between them. From
even to steep, and from bare to overgrown, the spread goes over by degrees.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from spl_batch.airborne.ground.point_spacing import BLOCK_M, Blocks, no_counts, quantiles
from spl_batch.constants import QUANTA_PER_M
from spl_batch.numerics.cell_groups import Cells, group_by_cell
from spl_batch.numerics.compiled import njit

SIGMA_M: Final = 0.025
"""Least standard deviation of a range that is reckoned with: that of bare cells of real surveys
[m]."""

COVERED: Final = 2.0
"""Told spreads of more than so many of the least one are believed: flightlines show them."""

CELL_M: Final = 1.0
MIN_RETURNS_PER_CELL: Final = 10
EVERY: Final = 5
"""Edge of the cells that are looked at [m], points that they hold, and one in how many it is."""

STEP_M: Final = 0.002
STEPS: Final = 100
"""Steps in which their scatter is counted [m]."""

QUANTILE: Final = 0.1
"""Share of the cells that is bare where there is bare ground."""

CHANCE: Final = 1.15
"""Scatter of bare cells over that quantile, as some twenty returns tell it."""

ROUGH: Final = 1.5
"""Bare cells of a cloud scatter by no more than this times what is stated: more is of plants."""

QUARTER_M: Final = 8.0
STEEP: Final = 0.7
"""Edge of the squares whose lowest returns are compared, half of a block [m], and the rise between
those of a block over that edge at which it is steep: 35 degrees."""

STEEP_SHARE: Final = (0.05, 0.15)
"""Share of the blocks that is steep from which on the stated spread counts in part, and alone."""

_TENTHS_MM = 1e4
"""Spreads that flightlines tell are whole numbers of these to the metre: what single precision
makes of the sensor's own is that again."""

_WHOLE, _STEEP, _TOLD = range(STEPS + 1, STEPS + 4)
"""What is known of a block behind the counts of its cells by their scatter."""

_NO_PLANE = 1e-6 * QUANTA_PER_M**4
"""Places whose scatter, along times across, is smaller lie on a line [quanta^4]."""

Float = NDArray[np.float64]
Index = NDArray[np.int64]


EVERYWHERE: Final = Blocks(np.full((1, 1), SIGMA_M), (0, 0))
"""Ranging spread where flightlines have none: the least one [m]."""


def evidence(x: Float, y: Float, z: Float, told_m: NDArray[np.floating]) -> Blocks:
    """What n > 0 points show of their ranges and their terrain, by blocks, row by row.

    Parts of a cloud that cut no block add up.

    Parameters
    ----------
    x, y, z : (n,) float64
        Points [m].
    told_m : (n,) floating
        Ranging spread of each point's flightline [m].

    Returns
    -------
    Blocks
        Of int64: (rows, columns, STEPS + 4), cells by scatter, whether all four squares of a block
        hold returns, whether it is steep, and the largest spread that is told in it.
    """
    found = no_counts(x, y, STEPS + 4)
    _add_scatter(x, y, z, found)
    _add_squares(x, y, z, told_m, found)
    return found


def _add_squares(
    x: Float, y: Float, z: Float, told_m: NDArray[np.floating], out: Blocks
) -> None:  # fmt: skip
    """Fill in which blocks are whole and steep, and the spread that is told in them."""
    bottom, left = (round(BLOCK_M / QUARTER_M) * corner for corner in out.first)
    rows, columns, _ = out.values.shape
    cells = group_by_cell(x, y, QUARTER_M)
    full = np.flatnonzero(np.diff(cells.start) > 0)
    first = cells.start[full]
    low, told = np.full((2, 2 * rows, 2 * columns), np.nan)
    row, column = np.divmod(full, cells.columns)
    at = (
        row + int(np.floor(y.min() / QUARTER_M)) - bottom,
        column + int(np.floor(x.min() / QUARTER_M)) - left,
    )
    low[at] = np.minimum.reduceat(z[cells.order], first)
    told[at] = np.maximum.reduceat(told_m[cells.order], first)
    low, told = (
        square.reshape(rows, 2, columns, 2).swapaxes(1, 2).reshape(rows, columns, 4)
        for square in (low, told)
    )
    rise = low.max(axis=2) - low.min(axis=2)
    out.values[:, :, _WHOLE] = np.isfinite(rise)
    out.values[:, :, _STEEP] = rise > STEEP * QUARTER_M
    out.values[:, :, _TOLD] = np.rint(_TENTHS_MM * np.fmax.reduce(told, axis=2, initial=0.0))


def off_planes(x: Float, y: Float, z: Float, cells: Cells, fewest: int) -> Float:
    """Mean square of points about the plane through those of their cell: (cells,) [m2].

    Parameters
    ----------
    x, y, z : (n,) float64
        Points [m].
    cells : Cells
        Some of them, grouped.
    fewest : int
        Cells of fewer points have infinity.
    """
    squares = np.full(len(cells.start) - 1, np.inf)
    _off_planes(x, y, z, cells.order, cells.start, fewest, squares)
    return squares


@njit()
def _off_planes(
    x: Float, y: Float, z: Float, order: Index, start: Index, fewest: int, out: Float
) -> None:
    """Fill for cells of enough points.

    Whole quanta from the lowest coordinates of a cell are added up: exactly, in whatever order.
    """
    for cell in range(len(start) - 1):
        first, end = start[cell], start[cell + 1]
        n = end - first
        if n < fewest:
            continue
        west, south, low = np.inf, np.inf, np.inf
        for k in range(first, end):
            i = order[k]
            west, south, low = min(west, x[i]), min(south, y[i]), min(low, z[i])
        e, q, u = 0.0, 0.0, 0.0
        ee, eq, qq, eu, qu, uu = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for k in range(first, end):
            i = order[k]
            a = np.rint((x[i] - west) * QUANTA_PER_M)
            b = np.rint((y[i] - south) * QUANTA_PER_M)
            c = np.rint((z[i] - low) * QUANTA_PER_M)
            e, q, u = e + a, q + b, u + c
            ee, eq, qq = ee + a * a, eq + a * b, qq + b * b
            eu, qu, uu = eu + a * c, qu + b * c, uu + c * c
        e, q, u = e / n, q / n, u / n
        ee, eq, qq = ee / n - e * e, eq / n - e * q, qq / n - q * q
        eu, qu, uu = eu / n - e * u, qu / n - q * u, uu / n - u * u
        scale = max(ee * qq - eq * eq, _NO_PLANE)
        rest = uu - (qq * eu * eu - 2.0 * eq * eu * qu + ee * qu * qu) / scale
        out[cell] = rest / QUANTA_PER_M**2


def _add_scatter(x: Float, y: Float, z: Float, out: Blocks) -> None:
    """Add cells by their scatter about a plane, in steps, and the rougher ones.

    One cell of :data:`EVERY` is looked at.
    """
    column, row = (np.floor(v / CELL_M).astype(np.int64) for v in (x, y))
    some = (column + 2 * row) % EVERY == 0
    if not some.any():
        return
    x, y, z = x[some], y[some], z[some]
    cells = group_by_cell(x, y, CELL_M)
    count = np.diff(cells.start)
    told = np.flatnonzero(count >= MIN_RETURNS_PER_CELL)
    count = count[told]
    squares = off_planes(x, y, z, cells, MIN_RETURNS_PER_CELL)[told] * count / (count - 3)
    step = np.minimum(np.sqrt(np.maximum(squares, 0.0)) / STEP_M, STEPS).astype(np.int64)
    at = [
        np.floor(((along + int(np.floor(v.min() / CELL_M))) * CELL_M) / BLOCK_M).astype(np.int64)
        for along, v in zip(np.divmod(told, cells.columns), (y, x), strict=True)
    ]
    np.add.at(out.values, (at[0] - out.first[0], at[1] - out.first[1], step), 1)


def reckoned(shown: Blocks) -> Blocks:
    """Ranging spread to reckon with, by what a cloud shows, as :func:`evidence` has it."""
    around = (3, 3, 1)
    counts = ndimage.correlate(shown.values[:, :, :_TOLD], np.ones(around, int), mode="constant")
    scatter = counts[:, :, : STEPS + 1]
    told_m = ndimage.maximum_filter(shown.values[:, :, _TOLD], around[:2], mode="constant")
    told_m = told_m / _TENTHS_MM
    stated = _share(counts[:, :, _STEEP] / np.maximum(counts[:, :, _WHOLE], 1), *STEEP_SHARE)
    bare_m = CHANCE * STEP_M * quantiles(scatter, QUANTILE)
    believed = 1.0 - _share(bare_m, CHANCE * told_m, ROUGH * told_m)
    sigma_m = SIGMA_M + believed * (np.clip(bare_m, SIGMA_M, np.maximum(told_m, SIGMA_M)) - SIGMA_M)
    sigma_m += stated * (told_m - sigma_m)
    sigma_m[(told_m <= SIGMA_M) | ~scatter.any(axis=2)] = SIGMA_M
    sure = told_m > COVERED * SIGMA_M
    sigma_m[sure] = told_m[sure]
    return Blocks(sigma_m, shown.first)


def _share(value: Float, none: Float | float, all_: Float | float) -> Float:
    """How far values have come from where nothing of something counts to where all does."""
    with np.errstate(divide="ignore", invalid="ignore"):
        share: Float = np.clip((value - none) / (all_ - none), 0.0, 1.0)
    return share
