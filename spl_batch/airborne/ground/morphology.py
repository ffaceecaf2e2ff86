"""Grey opening of a grid by octagons, for the progressive one of SMRF.

An octagon is a square widened by a diamond. The greatest value in a run of cells is that of two
runs whose length is a power of two, and such runs double. A diamond is a run along one diagonal,
widened along the other, and by a cross, which joins both colours of a chessboard. Each step takes
the greater of rows that are shifted, which the compiler turns into vector instructions; a window
costs what the logarithm of its radius is.

Heights are kept in single precision, half a millimetre at 8 km; rounding keeps their order.
"""

import numpy as np
from numpy.typing import NDArray

from spl_batch.numerics.compiled import njit

Heights = NDArray[np.float32]


def octagon(radius: int) -> tuple[int, int]:
    """Half-width of the square and radius of the diamond that add up to an octagon.

    Parameters
    ----------
    radius : int
        Radius of the octagon [cells].
    """
    diamond = round(radius * (2 - np.sqrt(2)))
    return radius - diamond, diamond


def opening(surface: Heights, radius: int) -> Heights:
    """Grey opening by a regular octagon; edges are continued level.

    Parameters
    ----------
    surface : (rows, columns) float32
        Heights without gaps [m].
    radius : int
        Radius of the octagon [cells], >= 0.

    Returns
    -------
    (rows, columns) float32
    """
    rows, columns = surface.shape
    # Beyond this margin no window begins that reaches a cell of the surface.
    room = np.empty((2, rows + 4 * radius, columns + 4 * radius), dtype=np.float32)
    room[0] = np.pad(surface, 2 * radius, mode="edge")
    return _open(room, *octagon(radius))[:rows, :columns]


@njit()
def _open(room: Heights, square: int, diamond: int) -> Heights:
    """Opening of the first of two grids, in the upper left corner; both are written to."""
    rows, columns = room.shape[1:]
    reach = 2 * (square + diamond)
    _turn_over(room[0], room[0])
    at = _widen(room, 0, rows, columns, square, diamond)
    rows, columns = rows - reach, columns - reach
    _turn_over(room[at, :rows, :columns], room[at, :rows, :columns])
    opened: Heights = room[_widen(room, at, rows, columns, square, diamond)]
    return opened


@njit()
def _turn_over(heights: Heights, out: Heights) -> None:
    """Heights with the other sign."""
    for r in range(len(heights)):
        for c in range(heights.shape[1]):
            out[r, c] = -heights[r, c]


@njit()
def _widen(room: Heights, at: int, rows: int, columns: int, square: int, diamond: int) -> int:
    """Greatest height in an octagon around each cell that is its radius off the edges.

    Parameters
    ----------
    room : (2, a, b) float32
        Two grids; both are written to.
    at : int
        Grid whose upper left corner has the heights.
    rows, columns : int
        Shape of these.
    square, diamond : int
        What the octagon is made of.

    Returns
    -------
    int
        Grid whose upper left corner has the results.
    """
    if square:
        length = 2 * square + 1
        at = _along(room, at, rows, columns, length, 0, 1)
        columns -= length - 1
        at = _along(room, at, rows, columns, length, 1, 0)
        rows -= length - 1
    if diamond:
        here, there = room[at], room[1 - at]
        for r in range(rows - 2):
            _greatest(
                here[r, 1 : columns - 1], here[r + 1, : columns - 2], here[r + 1, 1 : columns - 1],
                here[r + 1, 2:columns], here[r + 2, 1 : columns - 1], there[r],
            )  # fmt: skip
        at, rows, columns = 1 - at, rows - 2, columns - 2
        at = _along(room, at, rows, columns, diamond, 1, 1)
        rows, columns = rows - diamond + 1, columns - diamond + 1
        at = _along(room, at, rows, columns, diamond, 1, -1)
    return at


@njit()
def _along(
    room: Heights, at: int, rows: int, columns: int, length: int, down: int, right: int
) -> int:
    """Greatest of so many cells in a direction, the first of them in the upper left corner."""
    run = 1
    while run < length:
        step = min(run, length - run)
        here, there = room[at], room[1 - at]
        high, wide = rows - down * step, columns - abs(right) * step
        one, other = max(-right * step, 0), max(right * step, 0)
        for r in range(high):
            _greater(
                here[r, one : one + wide], here[r + down * step, other : other + wide],
                there[r, :wide],
            )  # fmt: skip
        at, rows, columns, run = 1 - at, high, wide, run + step
    return at


@njit()
def _greater(one: Heights, other: Heights, out: Heights) -> None:
    """Greater of two heights each."""
    for i in range(len(out)):
        out[i] = max(one[i], other[i])


@njit()
def _greatest(
    up: Heights, left: Heights, here: Heights, right: Heights, down: Heights, out: Heights
) -> None:
    """Greatest of five heights each."""
    for i in range(len(up)):
        along, across = max(up[i], down[i]), max(left[i], right[i])
        around = max(along, across)
        out[i] = max(around, here[i])
