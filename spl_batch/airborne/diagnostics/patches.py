"""Places that hang together."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

BESIDE = np.ones((3, 3), np.bool_)
"""Squares that touch, at corners too, are one place."""


class Patch(NamedTuple):
    """Squares of a grid that hang together."""

    squares: int  #: Their number [count].
    rows: tuple[int, int]  #: First one, and the one behind the last.
    columns: tuple[int, int]
    marked: NDArray[np.bool_]  #: The squares, of these rows and columns.


def patches(marked: NDArray[np.bool_]) -> list[Patch]:
    """Patches of marked squares of a grid, the largest first."""
    number, count = ndimage.label(marked, BESIDE)
    sizes = np.bincount(number.ravel(), minlength=count + 1)[1:]
    boxes = ndimage.find_objects(number)
    order = np.argsort(-sizes, kind="stable").tolist()
    return [
        Patch(
            int(sizes[k]),
            (boxes[k][0].start, boxes[k][0].stop),
            (boxes[k][1].start, boxes[k][1].stop),
            number[boxes[k]] == k + 1,
        )
        for k in order
    ]


def largest_of_squares(
    at: NDArray[np.int64], edge_m: float
) -> tuple[float, tuple[float, float, float, float]]:
    """Area of squares of an absolute grid [m2], and the box around their largest patch [m].

    ``at`` (n, 2): column and row of each square; at least one.
    """
    squares = np.unique(at, axis=0)
    low = squares.min(axis=0)
    marked = np.zeros(squares.max(axis=0) - low + 1, np.bool_)
    marked[tuple((squares - low).T)] = True
    first = patches(marked)[0]
    west, east = (edge_m * (low[0] + side) for side in first.rows)
    south, north = (edge_m * (low[1] + side) for side in first.columns)
    return len(squares) * edge_m**2, (float(west), float(south), float(east), float(north))
