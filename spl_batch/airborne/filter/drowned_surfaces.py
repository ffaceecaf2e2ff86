"""Drowned surfaces: those that do not stand out of dense noise.

Domain: space. Our own. With several returns of noise in each cubic metre, noise that is kept by
chance comes in clusters of dozens, most of all at the edges of a flightline, where the expected
noise is known least. No number of returns in a box distinguishes them from ground. But ground lies
in most columns of a square, clusters in few: a cell is ground only if enough columns of its square
hold a cell that is clearly richer in kept returns. Where none is, the terrain is void.

Near a surface the filter keeps noise above and below it. If dense, it carries a terrain 1 to 2 m
too low. There a return is ground only if more kept ones lie within :data:`NEAR_M` than noise
explains.
"""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree

from spl_batch.airborne.noise.haze import CUBE_M
from spl_batch.airborne.settings import FilterSettings
from spl_batch.lattice.tables import PointTable
from spl_batch.lattice.tiles import quanta
from spl_batch.numerics.poisson import noise_tail_probability

CROWDED: Final = 20
"""Refused returns of a 5 m cell, in the mean of a square, from which on noise is dense: 0.16 per m3
[count]. Half moves 7 + 0 labels, twice nothing."""

RICH: Final = (4, 0.1)
"""Kept returns of a cell that is clearly richer than noise: their least number, and least share of
the refused ones [count, 1/1]."""

SQUARE: Final = 3
"""Columns on each side that are looked at: 35 m, as the wider box of stray returns."""

LAYERS: Final = 2
"""Layers above and below that belong to a column, as ground may rise by 25 m in the square, and
those below the lowest surface that are not searched for noise alone [count]. Half moves nothing,
twice 27 + 0 labels."""

FULL: Final = 0.45
"""Least share of a square's columns that a surface fills; a shore along its middle passes."""

NEAR_M: Final = 0.7
"""How near a surface's returns lie to each other [m]; noise that near moves the terrain less."""

CHANCE: Final = FilterSettings().alpha
"""Share of noise of this density that has as many returns that near: what the filter keeps."""

Cells = NDArray[np.int64]
Marks = NDArray[np.bool_]


def unfilled(kept: Cells, gone: Cells) -> Marks:
    """Cells in dense noise around which no surface fills the place: signals are no ground.

    ``kept, gone``: returns of each 5 m cell that the filter kept, and refused [count].
    """
    least, share = RICH
    rich = (kept >= least) & (kept >= share * gone)
    known = _of_columns(kept + gone > 0)
    lost: Marks = _squared(_of_columns(rich)) < FULL * _squared(known)
    return lost & (dense_noise(kept, gone) > 0)


def dense_noise(kept: Cells, gone: Cells) -> NDArray[np.float32]:
    """Noise around cells where it is dense, 0 elsewhere: (a, b, c) [1/m3].

    The largest mean over a square among the layers around: in its own layer a surface hides noise.
    """
    mean = _squared(gone) / np.maximum(_squared(kept + gone > 0), 1)
    most = ndimage.maximum_filter1d(mean, 2 * LAYERS + 1, axis=2, mode="constant")
    return np.where(most >= CROWDED, most / CUBE_M**3, 0.0).astype(np.float32)


def lonely(
    table: PointTable, usable: NDArray[np.bool_], noise: NDArray[np.float32]
) -> NDArray[np.bool_]:
    """Returns in dense noise that have no more others near by than noise explains.

    Parameters
    ----------
    table : PointTable
        Points with ``x, y, z``.
    usable : (n,) bool
        Those that count as neighbours and are judged.
    noise : (n,) float32
        Of :func:`dense_noise` at each point [1/m3].

    Returns
    -------
    (n,) bool
    """
    out = np.zeros(len(table), np.bool_)
    asked = np.flatnonzero(usable & (noise > 0))
    if not len(asked):
        return out
    # Whole quanta below 2**53 and their squares are exact, so points may come in any order.
    xyz = np.column_stack([table[axis][usable] - table[axis].min() for axis in "xyz"])
    tree = cKDTree(xyz.astype(np.float64))
    own = (noise > 0)[usable]
    near = np.asarray(
        tree.query_ball_point(tree.data[own], float(quanta(NEAR_M)), return_length=True), np.int32
    )
    expected = noise[asked].astype(np.float64) * (4.0 / 3.0 * np.pi * NEAR_M**3)
    out[asked] = noise_tail_probability(near - np.int32(1), expected) > CHANCE
    return out


def below_surfaces(surface: Marks) -> Marks:
    """Cells well below the lowest surface of their column and its neighbours: (a, b, c) bool.

    What was kept there is noise.
    """
    wide = ndimage.maximum_filter(surface, (3, 3, 2 * LAYERS + 1), mode="constant")
    out: Marks = ~np.logical_or.accumulate(wide, axis=2) & wide.any(axis=2, keepdims=True)
    return out


def _of_columns(cells: Marks) -> Marks:
    """Whether a marked cell lies in the column within :data:`LAYERS` of each height."""
    held: Marks = ndimage.maximum_filter1d(cells, 2 * LAYERS + 1, axis=2, mode="constant")
    return held


def _squared(cells: NDArray[Any]) -> Cells:
    """Sum over the square around each cell."""
    return around(cells.astype(np.int64), SQUARE, (0, 1))


def around(count: Cells, reach: int, axes: tuple[int, ...]) -> Cells:
    """Sum of each cell and of those within ``reach`` on both sides of it along some axes."""
    ones = np.ones(2 * reach + 1, np.int64)
    for axis in axes:
        count = ndimage.convolve1d(count, ones, axis=axis, mode="constant")
    return count
