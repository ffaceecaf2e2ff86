"""Grey opening of a grid by octagons, for the progressive one of SMRF.

An octagon is a square opened further by a diamond. The least value along a run of cells is that
of two runs whose length is a power of two, and such runs double; so do diamonds: five of them, one
here and one as far as their radius to each side, cover one of twice the radius. A step is the
lesser of a few shifted copies of rows, which the compiler turns into vector instructions, and all
cost what the logarithm of the radius is.

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
    # Beyond this margin no window begins that reaches a cell of the surface.
    room = np.zeros((2, *(size + 4 * radius for size in surface.shape)), dtype=np.float32)
    room[0] = np.pad(surface, 2 * radius, mode="edge")
    for _ in ("erosion", "dilation of what is turned over"):
        _least(room, *octagon(radius))
        np.negative(room[0], out=room[0])
    inner = slice(2 * radius, -2 * radius or None)
    return room[0, inner, inner]


@njit()
def _least(room: Heights, square: int, diamond: int) -> None:
    """Least height in an octagon around each cell of the first of two grids, in place.

    Cells nearer to the edges than its radius are left with anything.
    """
    here, there = room[0], room[1]
    rows, columns = here.shape
    length = 2 * square + 1
    if square:
        for r in range(rows):
            row, other, run = here[r], there[r], 1
            while 2 * run <= length:
                _lesser(row[:-run], row[run:], other[:-run])
                row, other, run = other, row, 2 * run
            rest = length - run
            # Into the other grid at last, whichever of its rows is free.
            _lesser(row[: columns - rest], row[rest:], other[: columns - rest])
            there[r, square:] = other[: columns - square]
        here, there, run = there, here, 1
        while 2 * run <= length:
            for r in range(rows - run):
                _lesser(here[r], here[r + run], there[r])
            here, there, run = there, here, 2 * run
        for r in range(square, rows - square):
            _lesser(here[r - square], here[r + square + 1 - run], there[r])
        here, there = there, here
    reached = 0
    while reached < diamond:
        step = min(max(reached, 1), diamond - reached)
        for r in range(step, rows - step):
            out = there[r]
            _lesser(here[r - step], here[r + step], out)
            _lesser(here[r], out, out)
            _lesser(here[r, 2 * step :], out[step:-step], out[step:-step])
            _lesser(here[r, : -2 * step], out[step:-step], out[step:-step])
        here, there = there, here
        reached += step
    room[0] = here


@njit()
def _lesser(one: Heights, other: Heights, out: Heights) -> None:
    """Lesser of two heights each."""
    for i in range(len(out)):
        out[i] = min(one[i], other[i])
