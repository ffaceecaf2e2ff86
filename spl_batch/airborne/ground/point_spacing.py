"""Mean spacing of points where there are any: voids are left out.

Points are counted in squares of the absolute lattice, so that ground cells agree where they
overlap, and counts of parts of a cell add up.
"""

import math
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.ground.lowest_layers import count_squares

WIDE_M: Final = 16.0
"""Edge of the squares that tell the occupied area from voids [m]."""

Float = NDArray[np.float64]


class Squares(NamedTuple):
    """Sums over squares of an absolute grid.

    Parameters
    ----------
    sums : (a, b) ndarray
        One for each square.
    first : (int, int)
        Place of the first square in the grid, along either axis.
    """

    sums: NDArray[Any]
    first: tuple[int, int]


def in_squares(x: Float, y: Float) -> Squares:
    """Count n > 0 points in squares of :data:`WIDE_M`, column by column."""
    ends = [int(np.floor(end / WIDE_M)) for v in (x, y) for end in (v.min(), v.max())]
    count = np.zeros((ends[1] - ends[0] + 1, ends[3] - ends[2] + 1), dtype=np.int64)
    count_squares(x, y, WIDE_M, ends[0], ends[2], count)
    return Squares(count, (ends[0], ends[2]))


def spacing_m(x: Float, y: Float) -> float:
    """Mean spacing of points where there are any, voids of :data:`WIDE_M` left out [m].

    Parameters
    ----------
    x, y : (n,) float64
        Places [m]; n > 0.
    """
    return WIDE_M * math.sqrt(np.count_nonzero(in_squares(x, y).sums) / len(x))


def spacing_around_m(x: Float, y: Float, at_x: Float, at_y: Float) -> Float:
    """Mean spacing of points around places; see :func:`spacing_at_m`.

    Parameters
    ----------
    x, y : (n,) float64
        Points [m]; n > 0.
    at_x, at_y : (m,) float64
        Places [m].
    """
    return spacing_at_m(in_squares(x, y), at_x, at_y)


def spacing_at_m(squares: Squares, at_x: Float, at_y: Float) -> Float:
    """Mean spacing of points around places, by the nine squares of :data:`WIDE_M` [m].

    Parameters
    ----------
    squares : Squares
        The points, by :func:`in_squares`.
    at_x, at_y : (m,) float64
        Places [m].

    Returns
    -------
    (m,) float64
        Of the squares with points; :data:`WIDE_M` where none of the nine has any.
    """
    around = spacings(squares)
    # Places farther out have no points around, as the outermost squares have none.
    column = np.floor(at_x / WIDE_M).astype(np.int64) - around.first[0]
    row = np.floor(at_y / WIDE_M).astype(np.int64) - around.first[1]
    at = np.clip(column, 0, len(around.sums) - 1), np.clip(row, 0, len(around.sums[0]) - 1)
    found: Float = around.sums[at]
    return found


def spacings(squares: Squares) -> Squares:
    """Mean spacing of points around squares, and around two more on each side [m].

    Parameters
    ----------
    squares : Squares
        Points, by :func:`in_squares`.
    """
    around = np.pad(squares.sums, 2)
    points, held = (
        sum(np.roll(values, (i, j), axis=(0, 1)) for i in (-1, 0, 1) for j in (-1, 0, 1))
        for values in (around, (around > 0).astype(np.int64))
    )
    spacing = WIDE_M * np.sqrt(np.maximum(held, 1) / np.maximum(points, 1))
    return Squares(spacing, (squares.first[0] - 2, squares.first[1] - 2))


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
