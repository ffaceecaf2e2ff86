"""Progressive opening of a grid by octagons [Zhang et al. 2003; Pingel, Clarke & McBride 2013].

An octagon is a square widened by a diamond. A diamond is a run along one diagonal, widened along
the other, and by a cross, which joins both colours of a chessboard. The greatest value in a run of
cells is that of two shorter ones that overlap, so that runs double: each step takes the greater of
cells that are shifted, in place.

Heights are kept in single precision, half a millimetre at 8 km; rounding keeps their order.
"""

import numpy as np
from numpy.typing import NDArray

from spl_batch.numerics.compiled import njit

Heights = NDArray[np.float32]
Grid = NDArray[np.float64]
Mask = NDArray[np.bool_]


def octagon(radius: int) -> tuple[int, int]:
    """Half-width of the square and radius of the diamond that add up to an octagon.

    Parameters
    ----------
    radius : int
        Radius of the octagon [cells].
    """
    diamond = round(radius * (2 - np.sqrt(2)))
    return radius - diamond, diamond


def object_cells(
    surface: Grid, cell_m: float, slope: float, window_m: float, *, step_m: float = np.inf
) -> Mask:
    """Cells that stand above the progressively opened surface.

    Parameters
    ----------
    surface : (rows, columns) float64
        Lowest heights without gaps [m].
    cell_m : float
        Edge of a cell [m].
    slope : float
        Tolerated slope [rise/run].
    window_m : float
        Largest radius of the window [m].
    step_m : float
        A larger fall from one window to the next is an object's at any radius [m]; the
        source has no such limit, and keeps halls that are low for their width.

    Returns
    -------
    (rows, columns) bool
    """
    last = surface.astype(np.float32)
    found = np.zeros(surface.shape, dtype=np.bool_)
    for radius in range(1, int(np.ceil(window_m / cell_m)) + 1):
        opened = opening(last, radius)
        found |= last - opened > np.float32(min(slope * radius * cell_m, step_m))
        last = opened
    return found


def opening(heights: Heights, radius: int) -> Heights:
    """Opening of a surface, which goes on level beyond its edges, by an octagon.

    Each rounds off what an edge cuts, and what is left is continued by the next one: long halls at
    the edge do not stay.
    """
    size = octagon(radius)
    return _widened(-_widened(-np.pad(heights, 2 * radius, mode="edge"), *size), *size)


def _widened(heights: Heights, square: int, diamond: int) -> Heights:
    """Greatest height in an octagon around each cell that is its radius off the edges.

    ``heights`` is written over.
    """
    rows, columns = (size - 2 * (square + diamond) for size in heights.shape)
    _greatest(heights, 2 * square + 1, 1, 0)
    _greatest(heights, 2 * square + 1, 0, 1)
    if diamond:
        heights = _crossed(heights)
        _greatest(heights, diamond, 1, 1)
        _greatest(heights, diamond, 1, -1)
    left = max(diamond - 1, 0)
    return heights[:rows, left : left + columns]


@njit()
def _greatest(heights: Heights, length: int, down: int, right: int) -> None:
    """Put the greatest of so many cells on the way into the first of them.

    The way leads down, to a side (``right`` -1 or 1) or both, one cell at a time. Where it leaves
    the grid nothing is known. Rows go through all steps together, while they are at hand.
    """
    rows, columns = heights.shape
    beside = np.empty(columns, np.float32)
    for i in range(rows):
        at, run = i, 1
        while run < length:
            step = min(run, length - run)
            run += step
            other = heights[at]
            at -= step * down
            if at < 0:
                break
            if down == 0:
                for c in range(columns):
                    beside[c] = other[c]
                other = beside
            first, shift = max(-step * right, 0), step * right
            last = columns - max(shift, 0)
            _raise_to(heights[at, first:last], other[first + shift : last + shift])


@njit()
def _crossed(heights: Heights) -> Heights:
    """Greatest of each cell that is off the edges and the four beside it."""
    out = np.empty((len(heights) - 2, heights.shape[1] - 2), np.float32)
    for r in range(len(out)):
        above, row, below, found = heights[r], heights[r + 1], heights[r + 2], out[r]
        for c in range(len(found)):
            found[c] = max(row[c], row[c + 1], row[c + 2], above[c + 1], below[c + 1])
    return out


@njit()
def _raise_to(heights: Heights, others: Heights) -> None:
    """Put the greater of two rows into the first."""
    for i in range(len(heights)):
        heights[i] = max(heights[i], others[i])
