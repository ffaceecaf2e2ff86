"""Places that hang together."""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

WARNED_M2: Final = 500.0
"""Area of a place that is warned of [m2]."""

BESIDE = np.ones((3, 3), np.bool_)
"""Squares that touch, at corners too, are one place."""


class Patch(NamedTuple):
    """Squares of a grid that hang together; its rows go north, its columns east."""

    squares: int  #: Their number [count].
    at: tuple[slice, slice]  #: Rows and columns around them.
    marked: NDArray[np.bool_]  #: The squares, of these rows and columns.

    def box(self, west_m: float, south_m: float, edge_m: float) -> tuple[float, ...]:
        """West, south, east and north [m]; of a grid with this corner and edge of a square."""
        rows, columns = self.at
        return (
            float(west_m + edge_m * columns.start),
            float(south_m + edge_m * rows.start),
            float(west_m + edge_m * columns.stop),
            float(south_m + edge_m * rows.stop),
        )


def patches(marked: NDArray[np.bool_]) -> list[Patch]:
    """Patches of marked squares of a grid, the largest first."""
    number, count = ndimage.label(marked, BESIDE)
    sizes = np.bincount(number.ravel(), minlength=count + 1)[1:]
    boxes = ndimage.find_objects(number)
    order = np.argsort(-sizes, kind="stable").tolist()
    return [Patch(int(sizes[k]), boxes[k], number[boxes[k]] == k + 1) for k in order]


def largest_of_squares(at: NDArray[np.int64], edge_m: float) -> tuple[float, tuple[float, ...]]:
    """Area of squares of an absolute grid [m2], and the box around their largest patch [m].

    ``at`` (n, 2): column and row of each square; at least one.
    """
    squares = np.unique(at, axis=0)
    low = squares.min(axis=0)
    marked = np.zeros((squares.max(axis=0) - low + 1)[::-1], np.bool_)
    marked[tuple((squares - low).T[::-1])] = True
    west_m, south_m = (edge_m * low).tolist()
    return len(squares) * edge_m**2, patches(marked)[0].box(west_m, south_m, edge_m)
