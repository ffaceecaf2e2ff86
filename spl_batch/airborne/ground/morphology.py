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
    heights = surface.astype(np.float32)
    _opened(heights, *octagon(radius), _room(surface.shape, radius), heights)
    return heights


def cut_off(surface: NDArray[np.floating], falls: NDArray[np.floating]) -> Mask:
    """Cells that fall by more than is allowed from one opening to the next.

    Parameters
    ----------
    surface : (rows, columns) floating
        Heights without gaps [m].
    falls : (n,) floating
        What is allowed to the openings by octagons of radius 1, 2 and so on, of what the one before
        has left [m].

    Returns
    -------
    (rows, columns) bool
    """
    found = np.zeros(surface.shape, dtype=np.bool_)
    sizes = np.array([octagon(radius) for radius in range(1, len(falls) + 1)])
    room = _room(surface.shape, len(falls))
    _cut_off(surface.astype(np.float32), sizes, falls.astype(np.float32), room, found)
    return found


def _room(shape: tuple[int, ...], radius: int) -> Heights:
    """Two grids with a margin beyond which no window begins that reaches a cell within."""
    return np.empty((2, shape[0] + 4 * radius, shape[1] + 4 * radius), dtype=np.float32)


@njit()
def _cut_off(
    last: Heights, sizes: NDArray[np.int64], falls: Heights, room: Heights, out: Mask
) -> None:
    """Fill ``out``; ``sizes`` are squares and diamonds of the octagons; the heights are opened."""
    opened = np.empty_like(last)
    for k in range(len(sizes)):
        _opened(last, sizes[k, 0], sizes[k, 1], room, opened)
        for r in range(len(out)):
            _compare(last[r], opened[r], falls[k], out[r])


@njit()
def _compare(last: Heights, opened: Heights, fall: float, out: Mask) -> None:
    """Mark what has fallen by more, and keep the new heights."""
    for c in range(len(out)):
        out[c] |= last[c] - opened[c] > fall
        last[c] = opened[c]


@njit()
def _opened(heights: Heights, square: int, diamond: int, room: Heights, out: Heights) -> None:
    """Fill with the opening; ``room``: two grids with a margin, both are written to."""
    reach = 2 * (square + diamond)
    rows, columns = heights.shape[0] + 2 * reach, heights.shape[1] + 2 * reach
    for r in range(rows):
        _continue(heights[min(max(r - reach, 0), len(heights) - 1)], reach, room[0, r])
    at = _widen(room, 0, rows, columns, square, diamond)
    rows, columns = rows - reach, columns - reach
    for r in range(rows):
        _turn_over(room[at, r, :columns])
    at = _widen(room, at, rows, columns, square, diamond)
    for r in range(len(out)):
        out[r] = room[at, r, : out.shape[1]]


@njit()
def _continue(heights: Heights, margin: int, out: Heights) -> None:
    """A row with the other sign, and level on both sides."""
    last = margin + len(heights)
    for c in range(margin):
        out[c], out[last + c] = -heights[0], -heights[-1]
    for c in range(len(heights)):
        out[margin + c] = -heights[c]


@njit()
def _turn_over(heights: Heights) -> None:
    """Heights with the other sign, in their place."""
    for c in range(len(heights)):
        heights[c] = -heights[c]


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
