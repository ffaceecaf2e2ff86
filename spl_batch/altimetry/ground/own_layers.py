"""Ground of rough land: what a cell's own photons say against its neighbours.

A layer is sought among the photons of three cells, and its height is held against what the cells
around expect; that needs few photons, and ground that a line follows over 60 m. Crevassed ice,
lava and boulders rise and fall by metres within that: the lowest layer of three cells is then the
hollow beside the cell, and its neighbours expect what is not there. Such ground is bare, and a cell
holds dozens of its photons, which are asked here.

It is this project's own rule; [W17] does not say how its ground was extracted.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.numerics.compiled import njit

_QUANTA_PER_M: float = 1000.0
_MISSED: Final = 0.3
"""A layer of three cells with less than this share of the cell's own layer is not its ground."""
_OWN: Final = 5
"""How many times the least photons of a layer a cell's own layer needs [count]."""
_SURE: Final = 10
"""How many times the least photons of a layer a cell needs that no neighbour overrules [count]."""
_ERRORS: Final = 2.0
"""Standard errors of a Poisson count that few photons are allowed [count]."""


@njit()
def held(
    along: NDArray[np.int64],
    height_m: NDArray[np.float64],
    first: NDArray[np.int64],
    stop: NDArray[np.int64],
    centre: NDArray[np.int64],
    layers: NDArray[np.float64],
    reach_m: NDArray[np.float64],
    out: NDArray[np.int64],
) -> None:
    """Photons of each cell that lie in a layer.

    Parameters
    ----------
    along, height_m : (n,) int64, (n,) float64
        Photons in order along the track [quanta, m].
    first, stop : (c,) int64
        Rows of the photons of each cell.
    centre : (c,) int64
        Middle of each cell [quanta].
    layers : (c, 2) float64
        Height at the middle [m] and slope [m/m]; NaN where there is no layer.
    reach_m : (c,) float64
        Farthest that a photon of the layer is from its middle line [m].
    out : (c,) int64
        Receives their number, 0 where there is no layer.
    """
    for c in range(len(first)):
        out[c] = 0
        if np.isnan(layers[c, 0]):
            continue
        for row in range(first[c], stop[c]):
            dx = (along[row] - centre[c]) / _QUANTA_PER_M
            if abs(height_m[row] - layers[c, 0] - layers[c, 1] * dx) <= reach_m[c]:
                out[c] += 1


def not_beside(
    found: NDArray[np.float64],
    own: NDArray[np.float64],
    in_found: NDArray[np.int64],
    in_own: NDArray[np.int64],
    photons_min: int,
) -> NDArray[np.float64]:
    """Layers of three cells, or a cell's own where the cell holds no part of the one of three.

    Parameters
    ----------
    found, own : (c, 2) float64
        Height [m] and slope [m/m] of the lowest layer of three cells, and of the cell alone.
    in_found, in_own : (c,) int64
        Photons of the cell itself in either layer, by :func:`held`.
    photons_min : int
        Least photons of a layer [count].

    Returns
    -------
    (c, 2) float64
    """
    # Sparse ground under dense trees is a small part of its cell by chance as well.
    at_most = in_found + _ERRORS * (np.sqrt(in_found) + 1.0)
    missed = (in_own >= _OWN * photons_min) & (at_most < _MISSED * in_own)
    return np.where((missed & np.isfinite(found[:, 0]))[:, None], own, found)


def overruled_by_none(
    inside: NDArray[np.int64], photons: NDArray[np.int64], photons_min: int
) -> NDArray[np.bool_]:
    """Cells whose own photons outweigh what their neighbours expect: (c,) bool.

    Parameters
    ----------
    inside, photons : (c,) int64
        Photons of a cell in its layer, and all of them.
    photons_min : int
        Least photons of a layer [count].
    """
    sure: NDArray[np.bool_] = (inside >= _SURE * photons_min) & (2 * inside >= photons)
    return sure
