"""Progressive opening of a grid by octagons [Zhang et al. 2003; Pingel, Clarke & McBride 2013].

An octagon is a square widened by a diamond. A diamond is a run along one diagonal, widened along
the other, and by a cross, which joins both colours of a chessboard. The greatest value in a run of
cells is that of two shorter ones that overlap, so that runs double: each step takes the greater of
cells that are shifted.

Heights are kept in single precision, half a millimetre at 8 km; rounding keeps their order.
"""

import numpy as np
from numpy.typing import NDArray

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
    """Greatest height in an octagon around each cell that is its radius off the edges."""
    heights = _greatest(heights, 2 * square + 1, 1, 0)
    heights = _greatest(heights, 2 * square + 1, 0, 1)
    if diamond:
        across = _greatest(heights[1:-1], 3, 0, 1)
        along = _greatest(heights[:, 1:-1], 3, 1, 0)
        heights = np.maximum(across, along)
        heights = _greatest(heights, diamond, 1, 1)
        heights = _greatest(heights[::-1], diamond, 1, 1)[::-1]
    return heights


def _greatest(heights: Heights, length: int, down: int, right: int) -> Heights:
    """Greatest of so many cells on the way down, to the right or both, put into the first."""
    run = 1
    while run < length:
        step = min(run, length - run)
        rows, columns = len(heights) - step * down, heights.shape[1] - step * right
        heights = np.maximum(heights[:rows, :columns], heights[step * down :, step * right :])
        run += step
    return heights
