"""Grey opening of a grid by octagons, for the progressive one of SMRF.

An octagon is a square opened further by a diamond. The least value of a square's window is that
of two runs of cells whose length is a power of two, and such runs double; a diamond grows by a
cross at a time. So each step is the lesser of two or five shifted copies of the grid, which the
compiler turns into vector instructions, and all cost what the radius is, not the area.
"""

import numpy as np
from numpy.typing import NDArray

from spl_batch.numerics.compiled import njit

Grid = NDArray[np.float64]
Cells = NDArray[np.float64]
"""A grid in one row, with a margin on all sides that holds infinity."""


def octagon(radius: int) -> tuple[int, int]:
    """Half-width of the square and radius of the diamond that add up to an octagon.

    Parameters
    ----------
    radius : int
        Radius of the octagon [cells].
    """
    diamond = round(radius * (2 - np.sqrt(2)))
    return radius - diamond, diamond


def opening(surface: Grid, radius: int) -> Grid:
    """Grey opening by a regular octagon; edges are continued level.

    Parameters
    ----------
    surface : (rows, columns) float64
        Heights without gaps [m].
    radius : int
        Radius of the octagon [cells], >= 0.

    Returns
    -------
    (rows, columns) float64
    """
    square, diamond = octagon(radius)
    padded = np.pad(surface, radius, mode="edge")
    _erode(padded, square, diamond, 1.0)
    _erode(padded, square, diamond, -1.0)
    opened: Grid = padded[radius:-radius, radius:-radius] if radius else padded
    return opened


def _erode(grid: Grid, square: int, diamond: int, sign: float) -> None:
    """Erosion (sign 1) or dilation (-1) in place; beyond the edges nothing counts."""
    rows, columns = grid.shape
    margin = max(square, 1)
    wide = columns + 2 * margin
    frame, spare = np.full((2, (rows + 2 * margin) * wide), np.inf)
    inner = (slice(margin, margin + rows), slice(margin, margin + columns))
    np.multiply(grid, sign, out=frame.reshape(-1, wide)[inner])
    for shift in (1, wide) if square else ():
        frame, spare = _by_run(frame, spare, square, shift)
        _fence(frame, wide, margin)
    _fence(spare, wide, margin)
    for _ in range(diamond):  # one call each: in a loop of its own it is not made vectors of
        _by_cross(frame, wide, margin, spare)
        frame, spare = spare, frame
    np.multiply(frame.reshape(-1, wide)[inner], sign, out=grid)


@njit()
def _by_run(frame: Cells, spare: Cells, reach: int, shift: int) -> tuple[Cells, Cells]:
    """Least of 2 ``reach`` + 1 values ``shift`` apart around each; both arrays are written to."""
    length, size = 2 * reach + 1, len(frame)
    run = 1
    while 2 * run <= length:  # frame: the least of so many from each on
        step = run * shift
        _lesser(frame[: size - step], frame[step:], spare[: size - step])
        spare[size - step :] = frame[size - step :]
        frame, spare = spare, frame
        run *= 2
    step = (length - run) * shift
    first = reach * shift
    _lesser(frame[: size - step - first], frame[step : size - first], spare[first : size - step])
    return spare, frame


@njit()
def _lesser(one: Cells, other: Cells, out: Cells) -> None:
    """Lesser of two values each."""
    for i in range(len(out)):
        out[i] = min(other[i], one[i])


@njit()
def _by_cross(frame: Cells, wide: int, margin: int, out: Cells) -> None:
    """Least of a cell and its four neighbours, of all that are within the margin."""
    first, last = margin * wide, len(frame) - margin * wide
    here, left, right = frame[first:last], frame[first - 1 :], frame[first + 1 :]
    above, below = frame[first - wide :], frame[first + wide :]
    inner = out[first:last]
    for i in range(len(inner)):
        across = min(right[i], left[i])
        along = min(below[i], above[i])
        around = min(along, across)
        inner[i] = min(around, here[i])
    for at in range(first, last, wide):
        out[at + margin - 1] = np.inf
        out[at + wide - margin] = np.inf


@njit()
def _fence(frame: Cells, wide: int, margin: int) -> None:
    """Nothing in the margin."""
    frame[: margin * wide] = np.inf
    frame[len(frame) - margin * wide :] = np.inf
    for at in range(margin * wide, len(frame) - margin * wide, wide):
        frame[at : at + margin] = np.inf
        frame[at + wide - margin : at + wide] = np.inf
