"""Noise around raster cells, by the returns that the filter refused.

Domain: space. A top is believed if noise hardly makes the returns around it. Where a swath's edge
crosses a ground cell, noise is several times as dense on one side as on average: a kept clump of it
would stand in the surface model.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.products.cell_values import flown_over, shape_of
from spl_batch.constants import NOISE_BACKGROUND, QUANTUM_M
from spl_batch.lattice.tables import PointTable
from spl_batch.lattice.tiles import Bounds, quanta

SQUARE_M: Final = 10.0
"""Edge of the squares of the absolute grid that have a density of their own [m]."""

CLEARLY: Final = 1.25
"""A square's density counts where it is surely this many times the average's."""

STEP: Final = 1.1
"""Ratio of the densities that are told apart: each is rounded up to the next."""

HELD: Final = 0.25
"""Least part of a square that counts as flown over: the rim of a survey has no density."""


def noise_by_cell(table: PointTable, wide: Bounds, near: Bounds, size: int) -> NDArray[np.float64]:
    """Noise around the raster cells of ``near``, row by row from the south-west [1/m3].

    The central 96 % of the heights of refused returns of ``wide``, which holds ``near``, stand for
    the gate, so that strays do not stretch it; its raster cells with any return stand for the
    ground flown over. A square's own density counts where it is clearly more than the average.
    """
    shape = shape_of(wide, size)
    held = np.zeros(shape[0] * shape[1], np.bool_)
    heights, cells = np.empty(len(table), np.int32), np.empty(len(table), np.int32)
    count = flown_over(
        (table["x"], table["y"], table["z"]), (table["noise_class"], NOISE_BACKGROUND),
        (*wide,), float(size), held, heights, cells,
    )  # fmt: skip
    heights, cells = heights[:count], cells[:count]
    row, col = (np.arange(low, high, size) // size for low, high in (near[1::2], near[::2]))
    if count < 2:
        return np.zeros(len(row) * len(col))
    low, high = np.percentile(heights, (2, 98))
    per_m3 = 0.96 / ((size * QUANTUM_M) ** 2 * max(float(high - low) * QUANTUM_M, 1.0))
    mean = per_m3 * count / np.count_nonzero(held)
    side = max(quanta(SQUARE_M) // size, 1)
    first = wide.ymin // size, wide.xmin // size
    noise, flown = (_by_square(some, first, shape, side) for some in (cells, np.flatnonzero(held)))
    flown = np.maximum(flown, HELD * side * side)
    clear = per_m3 * (noise - 2.0 * np.sqrt(noise)) / flown > CLEARLY * mean
    own = STEP ** np.ceil(np.log(per_m3 * noise[clear] / flown[clear]) / np.log(STEP))
    density = np.full(noise.shape, mean)
    density[clear] = own
    squares = row // side - first[0] // side, col // side - first[1] // side
    found: NDArray[np.float64] = density[np.ix_(*squares)].ravel()
    return found


def _by_square(
    number: NDArray[np.integer], first: tuple[int, int], shape: tuple[int, int], side: int
) -> NDArray[np.float64]:
    """How many of some raster cells lie in each square of the absolute grid."""
    at = [
        (index + begin) // side - begin // side
        for index, begin in zip(np.divmod(number, shape[1]), first, strict=True)
    ]
    squares = tuple(
        (begin + length - 1) // side - begin // side + 1
        for begin, length in zip(first, shape, strict=True)
    )
    found = np.bincount(at[0] * squares[1] + at[1], minlength=squares[0] * squares[1])
    return found.reshape(squares).astype(np.float64)
