"""Counts by blocks of an absolute grid, and the mean spacing of points where there are any.

Ground cells agree on blocks where they overlap, and counts of parts of a cell add up.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from spl_batch.airborne.ground.scales import BLOCK_M
from spl_batch.numerics.cell_groups import group_by_cell

Float = NDArray[np.float64]
Index = NDArray[np.int64]
Places = NDArray[np.floating[Any]]


class Blocks(NamedTuple):
    """Values of blocks of an absolute grid, row by row.

    Parameters
    ----------
    values : (rows, columns, ...) ndarray
        One or several for each block.
    first : (int, int)
        Row and column of the first block in the grid.
    """

    values: NDArray[Any]
    first: tuple[int, int]

    def numbers(self, x: Places, y: Places) -> tuple[Index, Index]:
        """Row and column of the blocks that hold points, or of the nearest ones."""
        row, column = (
            np.clip(np.floor(v / BLOCK_M).astype(np.int64) - first, 0, size - 1)
            for v, first, size in zip((y, x), self.first, self.values.shape[:2], strict=True)
        )
        return row, column

    def at(self, x: Places, y: Places) -> NDArray[Any]:
        """Values of the blocks that hold points [m], or of the nearest ones."""
        return self.values[self.numbers(x, y)]

    def over(self, first: tuple[int, int], shape: tuple[int, ...]) -> NDArray[Any]:
        """Values of all blocks of a rectangle, by its first row and column: ``shape``."""
        y, x = (BLOCK_M * (one + np.arange(n)) for one, n in zip(first, shape, strict=True))
        return self.at(x[None, :], y[:, None])


def no_counts(x: Float, y: Float, kinds: int) -> Blocks:
    """None yet of some kinds, for all blocks around n > 0 places."""
    bottom, top, left, right = (
        int(np.floor(end / BLOCK_M)) for v in (y, x) for end in (v.min(), v.max())
    )
    counts = np.zeros((top - bottom + 1, right - left + 1, kinds), np.int64)
    return Blocks(counts, (bottom, left))


def spacings_m(x: Float, y: Float) -> Blocks:
    """Mean spacing of n > 0 points in each block and those around, voids left out [m].

    For two more blocks on each side as well; the outermost have no points around, as those farther
    out have none: there it is :data:`BLOCK_M`.
    """
    cells = group_by_cell(x, y, BLOCK_M)
    around = np.pad(np.diff(cells.start).reshape(cells.rows, cells.columns), 2)
    points, held = (
        sum(np.roll(values, (i, j), axis=(0, 1)) for i in (-1, 0, 1) for j in (-1, 0, 1))
        for values in (around, (around > 0).astype(np.int64))
    )
    spacing = BLOCK_M * np.sqrt(np.maximum(held, 1) / np.maximum(points, 1))
    bottom, left = (int(np.floor(v.min() / BLOCK_M)) - 2 for v in (y, x))
    return Blocks(spacing, (bottom, left))


def largest_of(x: Float, y: Float, values: Places, least: float) -> Blocks:
    """Largest value of n > 0 points in each block and those around, or the least one if larger."""
    found = no_counts(x, y, 1)
    most = np.full(found.values.shape[:2], least)
    np.maximum.at(most, found.numbers(x, y), values)
    return Blocks(ndimage.maximum_filter(most, 3), found.first)


def quantiles(counts: NDArray[Any], share: float) -> Float:
    """At which step a share of what is counted is reached, linear within steps: (...).

    Parameters
    ----------
    counts : (..., steps) ndarray
        Counts by steps.
    share : float
        Share of their sum; 0 where that is 0.
    """
    up_to = np.cumsum(counts, axis=-1)
    asked = share * up_to[..., -1:]
    step = np.minimum((up_to < asked).sum(axis=-1, keepdims=True), up_to.shape[-1] - 1)
    before, after = (
        np.take_along_axis(np.insert(up_to, 0, 0, axis=-1), step + k, axis=-1) for k in (0, 1)
    )
    found: Float = (step + (asked - before) / np.maximum(after - before, 1))[..., 0]
    return found
