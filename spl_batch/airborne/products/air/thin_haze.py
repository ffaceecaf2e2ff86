r"""Layers of haze that are too thin to be taken for noise: they are told.

Domain: space. :mod:`spl_batch.airborne.noise.haze` takes 15 m of even returns for air. A thinner
layer passes the test of noise, stays signal and becomes the surface. A block is a place of 10 m and
:data:`BLOCK` metres of height above the ground. It is *filled* if it holds many more returns than
noise explains, enough of them are kept, and they lie evenly: with n returns in each of its k cells,
2 m wide and half a metre high, so that no return shares one with its own afterpulse,

.. math:: \kappa = k \sum n (n - 1) / (\sum n)^2

is 1 in air, scattered by chance in single places, and above 1 among leaves. Evenly turbid crowns
come so near to 1 in single places, haze in several that lie together at the same height. A tree
that stands in haze makes its place clumped. So the emptier half of the columns of a block is looked
at by itself, too: haze fills them alike, crowns leave gaps. Chosen for what they hold, m columns of
n returns in all differ less than chance has it: by 2/pi of its variance, the part that the lower
half of a normal distribution lacks. So 2 m / (pi n) is added, and air is 1 again. A layer is told,
and nothing is removed. Our own rule: no source has one.
"""

import math
from collections.abc import Iterator
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from spl_batch.airborne.products.air.near_ground import CELL_M, FLOOR_M, HALF_M, SQUARE_M, Placed
from spl_batch.airborne.products.air.place_kernels import count_emptier, count_layers
from spl_batch.lattice.tiles import Bounds, quanta

DOMAIN: Final = "space"

TOP: Final = 120
"""Metres above the floor that are looked at, one by one."""

BLOCK: Final = 4
"""Metres that a block is high."""

WIDE: Final = 2
"""Cells that are one here, each way
[:data:`~spl_batch.airborne.products.air.near_ground.CELL_M`]."""

LOWEST: Final = 2
"""Metre above the floor from which on a block does not reach down to the ground."""

EVEN: Final = 1.1
"""Largest clumping of a filled block: of turbid crowns one in a hundred has less."""

EVEN_EMPTIER: Final = 1.03
"""The same of the emptier half of a block: of turbid crowns one in twenty has less."""

EMPTIER: Final = 0.5
EMPTIER_PER_M3: Final = 0.4
"""Share of the columns that are the emptier ones, and returns that they hold at least: as many as
the whole block [1, 1/m3]."""

LEAST_PER_M3: Final = 0.2
TIMES_NOISE: Final = 4.0
"""Returns of a filled block: enough to show clumps, and many more than noise [1/m3, 1]."""

KEPT: Final = 0.25
"""Least share of them that the filter keeps."""

BESIDE: Final = 3
"""Places that are filled at the same height, of nine."""

PLACES_LEAST: Final = 6
"""Places of one layer, or of one patch of mist, that are told: 600 m2."""

BLOCKS: Final = TOP - BLOCK + 1

_HALVES: Final = round(1.0 / HALF_M)
"""Layers of cells in a metre."""


class Clumping(NamedTuple):
    """How clumped the returns of blocks lie; infinite where they hold too few [1]."""

    whole: NDArray[np.float64]  #: (rows, columns, BLOCKS): from the south-west, by lowest metre.
    emptier: NDArray[np.float64]  #: The same: of the emptier half of its columns alone.


def filled_blocks(placed: Placed, noise_m3: float) -> NDArray[np.bool_]:
    """Blocks of each place that are evenly filled: (rows, columns, BLOCKS) bool.

    The arguments are those of :func:`clumping`.
    """
    whole, emptier = clumping(placed, noise_m3)
    return (whole <= EVEN) | (emptier <= EVEN_EMPTIER)


def clumping(placed: Placed, noise_m3: float) -> Clumping:
    """How clumped the returns of blocks lie that hold enough.

    Few are those below :data:`LEAST_PER_M3`, few that are kept, and all where there is no ground.

    Parameters
    ----------
    placed : Placed
        Points of a part of a ground cell.
    noise_m3 : float
        Expected noise [1/m3].
    """
    rows, columns = placed.shape
    small = quanta(SQUARE_M) // quanta(CELL_M)
    parts = small // WIDE
    size, deep = rows * columns * TOP * _HALVES, BLOCK * _HALVES
    sums, cells = np.zeros((size, 3), np.int64), np.zeros((size, parts**2), np.uint16)
    row, column = np.divmod(np.arange(small**2), small)
    count_layers(
        placed.place, placed.within, placed.half_metre, placed.kept, TOP * _HALVES,
        row // WIDE * parts + column // WIDE, cells, sums,
    )  # fmt: skip
    returns, pairs, known = (_high(values.reshape(rows * columns, -1)) for values in sums.T)
    times = TIMES_NOISE * noise_m3
    enough = returns >= BLOCK * SQUARE_M**2 * max(LEAST_PER_M3, times)
    enough &= known >= KEPT * returns
    enough &= placed.grounded[:, None]
    whole = np.where(enough, _clumped(returns, pairs, deep * parts**2), np.inf)
    few = np.zeros((*enough.shape, 2), np.int64)
    half = math.ceil(EMPTIER * parts**2)
    count_emptier(cells, enough, TOP * _HALVES, deep, _HALVES, half, few)
    enough &= few[..., 0] >= BLOCK * half * (SQUARE_M / parts) ** 2 * max(EMPTIER_PER_M3, times)
    chosen = 2.0 * half / (math.pi * np.maximum(few[..., 0], 1))
    found = _clumped(few[..., 0], few[..., 1], deep * half) + chosen
    emptier = np.where(enough, found, np.inf)
    return Clumping(*(value.reshape(rows, columns, -1) for value in (whole, emptier)))


def _clumped(
    returns: NDArray[np.int64], pairs: NDArray[np.int64], cells: int
) -> NDArray[np.float64]:
    """Clumping of some returns with so many ordered pairs in equal cells."""
    return cells * pairs / np.maximum(returns, 1) ** 2.0


def layers(filled: NDArray[np.bool_], core: Bounds) -> list[list[float]]:
    """Layers of haze of a ground cell.

    Parameters
    ----------
    filled : (rows, columns, BLOCKS) bool
        Blocks of the places of the whole cell.
    core : Bounds
        The ground cell [quanta].

    Returns
    -------
    list of [places, low, high, x, y, down]
        Places [count], the median height of their lower and upper end above the ground [m],
        their middle [quanta], and the share of them that are filled down to the ground, as by fog.
    """
    beside = ndimage.convolve(filled.astype(np.int8), np.ones((3, 3, 1), np.int8), mode="constant")
    haze = filled & (beside >= BESIDE)
    low_down, anywhere = (np.asarray(part.any(axis=2)) for part in (filled[:, :, :LOWEST], haze))
    found = []
    for row, column in _groups(anywhere):
        own = haze[row, column]
        low = float(np.median(own.argmax(axis=1))) + FLOOR_M
        high = float(np.median(BLOCKS - 1 - own[:, ::-1].argmax(axis=1))) + BLOCK + FLOOR_M
        down = float(low_down[row, column].mean())
        found.append([float(len(row)), low, high, *_middle(row, column, core), down])
    return found


def mist(low: NDArray[np.bool_], core: Bounds) -> list[list[float]]:
    """Patches of mist of a ground cell.

    Parameters
    ----------
    low : (rows, columns) bool
        Places that are filled just above the ground.
    core : Bounds
        The ground cell [quanta].

    Returns
    -------
    list of [places, x, y]
        Places [count], and their middle [quanta].
    """
    beside = ndimage.convolve(low.astype(np.int8), np.ones((3, 3), np.int8), mode="constant")
    return [
        [float(len(row)), *_middle(row, column, core)]
        for row, column in _groups(low & (beside >= BESIDE))
    ]


def _groups(
    marked: NDArray[np.bool_],
) -> Iterator[tuple[NDArray[np.intp], NDArray[np.intp]]]:
    """Rows and columns of marked places that touch, at corners too, where they are enough."""
    group, number = ndimage.label(marked, np.ones((3, 3)))
    for k in range(1, number + 1):
        row, column = np.nonzero(group == k)
        if len(row) >= PLACES_LEAST:
            yield row, column


def _middle(row: NDArray[np.intp], column: NDArray[np.intp], core: Bounds) -> tuple[float, float]:
    """Middle of some places of a ground cell, x and y [quanta]."""
    edge = quanta(SQUARE_M)
    west, south = -(-core.xmin // edge) * edge, -(-core.ymin // edge) * edge
    x, y = (float(np.mean(at)) * edge + edge / 2 for at in (column, row))
    return west + x, south + y


def _high(values: NDArray[np.int64]) -> NDArray[np.int64]:
    """Sums over the layers of each block: (places, BLOCKS)."""
    total = np.cumsum(np.pad(values, ((0, 0), (1, 0))), axis=1)
    return (total[:, BLOCK * _HALVES :] - total[:, : -BLOCK * _HALVES])[:, ::_HALVES]
