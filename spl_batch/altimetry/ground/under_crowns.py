"""Ground under closed woods: a faint layer below crowns that are fuller.

Where little light gets through, the fullest sheared layer of a cell lies in the crowns, and chooses
a slope that is none of the ground's. Ground is clear of what is below it, though, and goes on from
cell to cell. Such a layer well below is the ground. Where it is not found, photons lie below what
is called ground: they tell that it may be wrong, and by how much.
"""

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.altimetry.water.emptiest import sums_around

_DROP_M: Final = 3.0
"""How far the layer lies below what else is the ground, at least [m]."""

_CROWNS: Final = 0.3
"""Share of the photons that lie in what else is the ground, at most: bare land has most there."""

_SHARE: Final = 0.3
"""Photons of the layer over those of that, at least."""

_MEET: Final = 2.0
_MET: Final = 3
"""Thicknesses within which the lines of two cells meet, and cells around that meet it, at least."""

_UNDER_M: Final = 2.0
_DEEPEST_M: Final = 30.0
"""Depth below the ground at which photons contradict it [m]."""

_DOUBT: Final = 0.3
"""Such photons over those at the ground that put it in doubt."""


def deeper(
    index: NDArray[np.int64],
    layers: tuple[NDArray[np.float64], NDArray[np.float64]],
    held: tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]],
    thick: NDArray[np.float64],
    reach: int,
    cell_m: float,
) -> NDArray[np.bool_]:
    """Cells whose clear layer is the ground, and not the one found, (c,) bool.

    Parameters
    ----------
    index : (c,) int64
        Cells, in order.
    layers : ((c, 2) float64, (c, 2) float64)
        Height [m] and slope [m/m] of the layer found, and of the clear one; NaN without one.
    held : four times (c,) int64
        Photons of the layer found, of the clear one, within a whole thickness of the former, and
        all [count].
    thick : (c,) float64
        Thickness of the layers [m].
    reach : int
        Cells to each side that are asked [count].
    """
    found, clear = layers
    here, there, near, every = held
    met = np.zeros(len(index), np.int64)
    for step in (*range(-reach, 0), *range(1, reach + 1)):
        at = np.minimum(np.searchsorted(index, index + step), max(len(index) - 1, 0))
        slope = (clear[at, 1] + clear[:, 1]) / 2.0
        off = np.abs(clear[at, 0] - slope * step * cell_m - clear[:, 0])
        met += (index[at] == index + step) & (off <= _MEET * thick)
    crowns = (near < _CROWNS * every) & (there >= _SHARE * here)
    lower: NDArray[np.bool_] = (found[:, 0] - clear[:, 0] >= _DROP_M) & crowns & (met >= _MET)
    return lower


def doubt_m(
    index: NDArray[np.int64],
    row: NDArray[np.intp],
    over_m: NDArray[np.float64],
    reach: int,
) -> NDArray[np.float64]:
    """How far the ground may lie too high, (c,) float64 [m]; 0 where nothing tells of it.

    That is the mean depth of the photons below it, over the cells around. Bare land holds most of
    the photons, and noise by day or crevasses below it put it in no doubt.

    Parameters
    ----------
    index : (c,) int64
        Cells, in order.
    row, over_m : (n,) intp, (n,) float64
        Row of each photon's cell, and its height over the ground there [m]; NaN without one.
    reach : int
        Cells to each side that tell of it [count].
    """
    known = np.isfinite(over_m)
    row, over_m = row[known], over_m[known]
    near = np.abs(over_m) < _DEEPEST_M
    under = near & (over_m < -_UNDER_M)
    at = np.abs(over_m) <= _UNDER_M / 2.0
    n = len(index)
    counted = (
        np.bincount(row[under], minlength=n),
        np.bincount(row[at], minlength=n),
        np.bincount(row[near], minlength=n),
        np.bincount(row[under], -over_m[under], n),
    )
    many, ground, every, depth = sums_around(index, np.stack(counted, axis=1), reach).T
    doubted = (many > _DOUBT * ground) & (ground < _CROWNS * every)
    return np.where(doubted, depth / np.maximum(many, 1.0), 0.0)


def doubt_told(columns: Mapping[str, NDArray[Any]], cell_m: float) -> dict[str, float]:
    """Cells whose ground is in doubt, where they lie, and how far it may be too high [m].

    Parameters
    ----------
    columns : mapping
        A profile, with its cells in order.
    cell_m : float
        Length of a cell [m].
    """
    own = columns["doubt"] > 0.0
    cell = columns["cell"][own]
    return {
        "cells": float(len(cell)),
        "from_m": float(cell[0] * cell_m) if len(cell) else 0.0,
        "to_m": float((cell[-1] + 1) * cell_m) if len(cell) else 0.0,
        "depth_m": float(np.median(columns["doubt"][own])) if len(cell) else 0.0,
    }
