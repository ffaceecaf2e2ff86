"""How thick a layer of ground returns is: the ranging spread that a ground method reckons with.

What sensors state is an upper figure: bare cells of real surveys scatter by half of it. A layer as
thick as stated takes in grass and moss, one too thin loses returns of the ground. The cloud itself
tells: where a fifth of its cells are as smooth as ranges can be stated to scatter, they are bare,
and their scatter is that of the ranges. Heath and closed forest have too few such cells; there the
least spread is reckoned with, which finds the same terrain in clouds twice as noisy.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.numerics.cell_groups import Cells, group_by_cell

SIGMA_M: Final = 0.025
"""Least standard deviation of a range that is reckoned with: that of bare cells of real surveys
[m]."""

COVERED: Final = 2.0
"""Told spreads of more than so many of the least one are believed: flightlines show them."""

CELL_M: Final = 1.0
FEWEST: Final = 10
EVERY: Final = 5
"""Edge of the cells that are looked at [m], points that they hold, and one in how many it is."""

STEP_M: Final = 0.002
STEPS: Final = 100
"""Steps in which their scatter is counted [m]."""

QUANTILE: Final = 0.2
"""Share of the cells that is bare in a cloud with bare ground."""

CHANCE: Final = 1.15
"""Scatter of bare cells over that quantile, as some twenty returns tell it."""

Float = NDArray[np.float64]


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
    count = np.diff(cells.start)
    squares = np.full(len(count), np.inf)
    if not (count >= fewest).any():
        return squares
    at = [v[cells.order] for v in (x, y, z)]
    first = cells.start[:-1][count > 0]
    each = count[count > 0]
    east, north, up = (v - np.repeat(v[first], each) for v in at)

    def mean(values: Float) -> Float:
        summed: Float = np.add.reduceat(values, first) / each
        return summed

    e, n, u = mean(east), mean(north), mean(up)
    ee, nn, en = mean(east**2) - e * e, mean(north**2) - n * n, mean(east * north) - e * n
    eu, nu, uu = mean(east * up) - e * u, mean(north * up) - n * u, mean(up**2) - u * u
    scale = np.maximum(ee * nn - en * en, 1e-6)
    rest = uu - (nn * eu * eu - 2.0 * en * eu * nu + ee * nu * nu) / scale
    squares[count > 0] = np.where(each >= fewest, rest, np.inf)
    return squares


def scatter_counts(x: Float, y: Float, z: Float) -> NDArray[np.int64]:
    """Cells by their scatter about a plane, in steps, and the rougher ones: (STEPS + 1,) [count].

    One cell of :data:`EVERY` is looked at; counts of parts of a cloud that cut no cell add up.
    """
    column, row = (np.floor(v / CELL_M).astype(np.int64) for v in (x, y))
    some = (column + 2 * row) % EVERY == 0
    counts = np.zeros(STEPS + 1, np.int64)
    if not some.any():
        return counts
    x, y, z = x[some], y[some], z[some]
    cells = group_by_cell(x, y, CELL_M)
    count = np.diff(cells.start)
    told = count >= FEWEST
    squares = off_planes(x, y, z, cells, FEWEST)[told] * count[told] / (count[told] - 3)
    step = np.minimum(np.sqrt(np.maximum(squares, 0.0)) / STEP_M, STEPS).astype(np.int64)
    counts += np.bincount(step, minlength=STEPS + 1)
    return counts


def reckoned_m(told_m: float, counts: NDArray[np.int64]) -> float:
    """Ranging spread to reckon with [m].

    Parameters
    ----------
    told_m : float
        The largest that flightlines tell [m].
    counts : (STEPS + 1,) int64
        Cells by their scatter, by :func:`scatter_counts`.
    """
    if told_m > COVERED * SIGMA_M:
        return told_m
    if told_m <= SIGMA_M or not counts.any():
        return SIGMA_M
    before = np.insert(np.cumsum(counts), 0, 0) / counts.sum()
    shown = CHANCE * float(np.interp(QUANTILE, before, np.arange(len(before)) * STEP_M))
    return float(np.clip(shown, SIGMA_M, told_m)) if shown <= CHANCE * told_m else SIGMA_M
