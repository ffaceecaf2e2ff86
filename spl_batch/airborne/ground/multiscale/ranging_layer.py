"""How thick a layer of ground returns is: the ranging spread that a ground method reckons with.

What sensors state is an upper figure: bare cells of real surveys scatter by half of it. A layer as
thick as stated takes in grass and moss, one too thin loses returns of the ground. The cloud itself
tells: where a fifth of its cells are as smooth as ranges can be stated to scatter, they are bare,
and their scatter is that of the ranges. Heath and closed forest have too few such cells; there the
least spread is reckoned with, which finds the same terrain in clouds twice as noisy where it is
even. Where the lowest returns step by metres it loses ground under trees: there the stated one
counts.
"""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.constants import QUANTA_PER_M
from spl_batch.numerics.cell_groups import Cells, group_by_cell
from spl_batch.numerics.compiled import njit

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

QUARTER_M: Final = 8.0
STEEP: Final = 0.7
"""Edge of the squares whose lowest returns are compared [m], and the rise between those of a block
of four over that edge at which it is steep: 35 degrees."""

STEEP_SHARE: Final = 0.1
"""Share of the blocks that is steep where the stated spread counts."""

_NO_PLANE = 1e-6 * QUANTA_PER_M**4
"""Places whose scatter, along times across, is smaller lie on a line [quanta^4]."""

Float = NDArray[np.float64]
Index = NDArray[np.int64]


class Evidence(NamedTuple):
    """What a cloud shows of its ranges and its terrain; parts that cut no block add up."""

    scatter: NDArray[np.int64]  #: (STEPS + 1,): cells by their scatter about a plane, in steps.
    blocks: int = 0  #: Blocks of four squares with returns in each, and the steep ones of them.
    steep: int = 0

    def __add__(self, other: "Evidence") -> "Evidence":  # type: ignore[override]
        """Of two parts of a cloud."""
        return Evidence(
            self.scatter + other.scatter, self.blocks + other.blocks, self.steep + other.steep
        )


def evidence(x: Float, y: Float, z: Float) -> Evidence:
    """What some points show: (n,) each [m]."""
    return Evidence(scatter_counts(x, y, z), *steep_blocks(x, y, z))


def steep_blocks(x: Float, y: Float, z: Float) -> tuple[int, int]:
    """Blocks of four squares that all hold returns, and those of them that are steep [count]."""
    if not len(x):
        return 0, 0
    cells = group_by_cell(x, y, QUARTER_M)
    full = np.diff(cells.start) > 0
    first = cells.start[:-1][full]
    lowest = np.minimum.reduceat(z[cells.order], first)
    at = cells.order[first]
    block = [np.floor(v[at] / (2.0 * QUARTER_M)).astype(np.int64) for v in (x, y)]
    order = np.lexsort(block)
    column, row = (v[order] for v in block)
    new = np.append(True, (np.diff(column) != 0) | (np.diff(row) != 0))
    start = np.flatnonzero(new)
    whole = np.diff(np.append(start, len(order))) == 4
    rise = np.maximum.reduceat(lowest[order], start) - np.minimum.reduceat(lowest[order], start)
    return int(whole.sum()), int(np.count_nonzero(whole & (rise > STEEP * QUARTER_M)))


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


def reckoned_m(told_m: float, shown: Evidence) -> float:
    """Ranging spread to reckon with [m].

    Parameters
    ----------
    told_m : float
        The largest that flightlines tell [m].
    shown : Evidence
        What the cloud shows, by :func:`evidence`.
    """
    counts = shown.scatter
    if told_m > COVERED * SIGMA_M:
        return told_m
    if told_m <= SIGMA_M or not counts.any():
        return SIGMA_M
    if shown.steep > STEEP_SHARE * shown.blocks:
        return told_m
    before = np.insert(np.cumsum(counts), 0, 0) / counts.sum()
    bare_m = CHANCE * float(np.interp(QUANTILE, before, np.arange(len(before)) * STEP_M))
    return float(np.clip(bare_m, SIGMA_M, told_m)) if bare_m <= CHANCE * told_m else SIGMA_M
