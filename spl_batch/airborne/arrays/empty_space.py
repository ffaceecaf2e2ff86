"""Noise density of a cloud whose beams are not known, by the cloud's own empty space.

Domain: space. Our own rule, for clouds without trajectory and times: [W18] knows none.

Noise fills the whole range gate evenly; surfaces and leaves do not. A layer of space holds noise
alone where its returns are spread as evenly as chance spreads them: in cubes of the layer their
counts have the variance of Poisson's law. The cloud is cut into squares of :data:`SQUARE_M` and
layers of :data:`LAYER_M`. The density of a square is that of its layers that pass; of those that
hold clearly more than the median layer the returns are taken for signal as well. The lowest and the
highest layer of a square are left out: the gate ends in them.

A square with too little such space takes the density of the nearest with more. So does one at the
rim: slanting beams reach it at some heights only, and its empty layers show nothing. A cloud
without empty space, as one whose vendor has removed the noise, shows nothing.

What this cannot know: where the gate ends, flightlines that overlap only in part of a square, and
noise that changes with height.
"""

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from spl_batch.airborne.arrays.checked import refuse_large
from spl_batch.errors import grouped
from spl_batch.lattice.tiles import quanta

SQUARE_M: Final = 30.0
"""Edge of a square with a density of its own [m]."""

LAYER_M: Final = 5.0
"""Thickness of a layer [m]."""

CUBE_M: Final = (2.5, 15.0)
"""Least and largest edge of the cubes in which returns are counted [m]."""

HELD: Final = 8.0
"""Returns that a column of cubes holds on average, so that chance leaves none that was flown over
empty [count]."""

SQUARE_BYTES: Final = 80
"""Memory of a square, whether it holds points or none [byte]."""

SIGMA: Final = 4.0
"""Deviations from Poisson's law, in standard ones, up to which a layer holds noise alone."""

UNEVEN: Final = 1.5
"""Variance over mean that a layer of noise may have: flightlines overlap in parts of squares."""

LEAST_M: Final = 15.0
"""Height of empty space that a square needs to have a density [m]."""

RIM: Final = 3
"""A square farther in than beams lean, 55 m on 150 m at 20 degrees off nadir, was flown over at
every height [squares]."""


class EmptySpace(NamedTuple):
    """Noise density by place."""

    density: NDArray[np.float64]  #: (n,): at each point [1/m3]; 0 where nothing is known.
    volume_m3: float  #: Empty space in which it was counted [m3]; 0 where there is none.
    share: float  #: Share of the points whose square has a density of its own [0..1].


class _Layers(NamedTuple):
    """Layers of squares that hold returns, square by square, upwards, empty ones among them."""

    square: NDArray[np.int64]  #: (k,): number of the square.
    returns: NDArray[np.int64]  #: (k,): returns in the layer [count].
    squared: NDArray[np.float64]  #: (k,): sum of the squares of those in each cube.
    cubes: NDArray[np.int64]  #: (k,): cubes that were flown over [count].
    inner: NDArray[np.bool_]  #: (k,): whether layers with returns lie above and below.


def empty_space(x: NDArray[np.int64], y: NDArray[np.int64], z: NDArray[np.integer]) -> EmptySpace:
    """Noise density at points, (n,) each [quanta], by the empty space around them."""
    n = len(x)
    if not n:
        return EmptySpace(np.zeros(0), 0.0, 0.0)
    edge = _cube_edge(x, y)
    per_side = max(round(quanta(SQUARE_M) / edge), 1)
    column = np.stack([np.floor_divide(v, edge) for v in (x, y)])
    square = np.floor_divide(column, per_side)
    corner = square.min(axis=1)
    shape = tuple((square.max(axis=1) - corner + 1).tolist())
    squares = math.prod(shape)
    what = f"{grouped(squares)} squares of {SQUARE_M:g} m"
    refuse_large("xyz", what, squares * SQUARE_BYTES, "give a smaller cloud")
    number = (square[0] - corner[0]) * shape[1] + (square[1] - corner[1])
    inside = (column[0] - square[0] * per_side) * per_side + (column[1] - square[1] * per_side)
    layer = np.floor_divide(z.astype(np.int64), quanta(LAYER_M))
    layers = _layers(number, inside, layer - layer.min(), per_side**2)
    cube_m3 = (edge / 1000.0) ** 2 * LAYER_M
    count, volume = _pooled(layers, cube_m3, squares)
    own = volume >= LEAST_M * SQUARE_M**2 * 0.1
    if not own.any():
        return EmptySpace(np.zeros(n), 0.0, 0.0)
    grid = np.where(own, count / np.maximum(volume, 1e-9), 0.0).reshape(shape)
    held = (np.bincount(number, minlength=squares) > 0).reshape(shape)
    within = own.reshape(shape) * ndimage.distance_transform_cdt(np.pad(held, 1))[1:-1, 1:-1]
    deepest = ndimage.maximum_filter(within, 2 * RIM + 1, mode="constant")
    sure = (within > 0) & (within >= np.minimum(deepest, RIM))
    nearest = ndimage.distance_transform_edt(~sure, return_distances=False, return_indices=True)
    filled = grid[tuple(nearest)]
    return EmptySpace(
        filled.reshape(-1)[number], float(volume[own].sum()), float(own[number].mean())
    )


def _cube_edge(x: NDArray[np.int64], y: NDArray[np.int64]) -> int:
    """Edge of the cubes [quanta]: a column of them holds some returns wherever was flown."""
    least, largest = map(quanta, CUBE_M)
    held = len(np.unique(np.floor_divide(x, least) * 2**32 + np.floor_divide(y, least)))
    per_column = len(x) / held
    edge = least * max(np.sqrt(HELD / per_column), 1.0)
    # A whole number of cubes in a square.
    return quanta(SQUARE_M) // max(int(quanta(SQUARE_M) / min(edge, largest)), 1)


def _layers(
    square: NDArray[np.int64], inside: NDArray[np.int64], layer: NDArray[np.int64], columns: int
) -> _Layers:
    """Counts by layer of each square, from the lowest that holds returns to the highest."""
    most = int(layer.max()) + 1
    flown, mine = np.unique(square, return_inverse=True)
    low, high = np.full(len(flown), most), np.zeros(len(flown), np.int64)
    np.minimum.at(low, mine, layer)
    np.maximum.at(high, mine, layer)
    held = np.unique(mine * columns + inside)
    cubes = np.bincount(held // columns)
    start = np.concatenate([[0], np.cumsum(high - low + 1)])
    of = np.repeat(np.arange(len(flown)), high - low + 1)
    slot = start[mine] + layer - low[mine]
    cube = (mine * most + layer) * columns + inside
    _, first, held_by = np.unique(cube, return_index=True, return_counts=True)
    total = np.bincount(slot, minlength=start[-1])
    squared = np.bincount(slot[first], held_by.astype(np.float64) ** 2, minlength=start[-1]).astype(
        np.float64
    )
    level = np.arange(start[-1]) - start[of]
    inner = (level > 0) & (level < (high - low)[of])
    return _Layers(flown[of], total, squared, cubes[of], inner)


def _pooled(
    layers: _Layers, cube_m3: float, squares: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Returns in the empty space of each square [count], and its volume [m3]: (squares,) each."""
    mean = layers.returns / layers.cubes
    spare = np.maximum(layers.cubes - 1, 1)
    # Sum of (c - mean)^2 / mean over cubes is chi-squared with cubes - 1 degrees of freedom.
    spread = np.where(
        layers.returns > 0, layers.squared / np.maximum(mean, 1e-12) - layers.returns, 0.0
    )
    limit = np.maximum(spare + SIGMA * np.sqrt(2.0 * spare), UNEVEN * spare)
    even = layers.inner & (spread <= limit)
    rows = np.flatnonzero(even)
    if not len(rows):
        return np.zeros(squares), np.zeros(squares)
    known, group = np.unique(layers.square[rows], return_inverse=True)
    middle = np.zeros(squares)
    middle[known] = ndimage.median(mean[rows], group, np.arange(len(known)))
    expected = middle[layers.square] * layers.cubes
    even &= layers.returns <= expected + SIGMA * np.sqrt(expected + 1.0)
    enough = np.bincount(layers.square[even], minlength=squares) * LAYER_M >= LEAST_M
    even &= enough[layers.square]
    count = np.bincount(layers.square[even], layers.returns[even], minlength=squares)
    cubes = np.bincount(layers.square[even], layers.cubes[even], minlength=squares)
    return count.astype(np.float64), (cubes * cube_m3).astype(np.float64)
