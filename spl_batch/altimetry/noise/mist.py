"""What may be fog or a low cloud, and may be woods: a reader is told of it.

Fog fills heights as evenly as chance does, along the track and in height; crowns and ground do not.
But woods that are dense and even look like that too, so the photons stay what they are called.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.altimetry.noise.fog import Fog, fog_at
from spl_batch.altimetry.noise.layers_above import (
    BIN_M,
    PATCH_CELLS,
    SD,
    Above,
    Foot,
    even,
    inside,
    shown_around,
    sure,
)
from spl_batch.altimetry.photon_table import Cells
from spl_batch.altimetry.settings import RateSettings
from spl_batch.altimetry.water.emptiest import sums_around
from spl_batch.constants import QUANTA_PER_M

_THICK: Final = 4
"""Boxes that it fills at least: ground on a slope fills some [count]."""

_LONG: Final = 16
"""Cells that show it, of those around; a patch alone shows itself in eleven [count]."""

_CLUMPED: Final = 0.1
_UNEVEN: Final = 0.1
"""Squared coefficients of variation of its density among boxes along the track and in height, at
most."""

HIDDEN_M: Final = 120
"""Where no ground is near, heights count from so far below what is fullest [m]."""


def find_mist(layers: Above, fog: Fog) -> NDArray[np.float32]:
    """What each cell shows: lower and upper end [m], photons; (n, 3) float32, 0 where nothing.

    Parameters
    ----------
    layers : Above
        What stands above the ground.
    fog : Fog
        Clouds that are told apart: they are none of it.
    """
    runs, n = layers.runs, len(layers.number)
    out = np.zeros((n, 3), np.float32)
    some = (runs.stop - runs.first >= _THICK) & sure(layers) & even(layers, _CLUMPED, inner=True)
    some &= _level(layers)
    middle = (layers.foot[runs.row] + (runs.first + runs.stop) // 2) * BIN_M * QUANTA_PER_M
    some &= fog_at(runs.row.astype(np.intp), middle.astype(np.int32), *fog) == 0.0
    some &= shown_around(layers, some)
    some = _long(layers, some)
    more = (runs.total(layers.seen) - runs.total(layers.sky)) / layers.cells()
    for run in np.flatnonzero(some):
        own = out[runs.row[run]]
        ends = (layers.foot[runs.row[run]] + (runs.first[run], runs.stop[run])) * BIN_M
        empty = own[2] == 0.0
        own[0] = ends[0] if empty else min(own[0], ends[0])
        own[1] = ends[1] if empty else max(own[1], ends[1])
        own[2] += more[run]
    return out


def _long(layers: Above, some: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Runs of ``some`` beside what patches show which have no photon in common, (r,) bool."""
    row, number, reach = layers.runs.row, layers.number, 2 * PATCH_CELLS + 1
    shown = np.bincount(row[some], minlength=len(number))[:, None] > 0
    long = shown & (sums_around(number, shown, reach) >= _LONG)
    found: NDArray[np.bool_] = some & (sums_around(number, long, reach)[row, 0] > 0)
    return found


def _level(layers: Above) -> NDArray[np.bool_]:
    """Runs that are as dense in all of their boxes but the ends, (r,) bool."""
    runs = layers.runs
    inner = inside(runs)
    k = np.maximum(np.bincount(runs.which, inner, len(runs.row)), 1.0)
    total, square = (runs.total(values, inner) for values in (layers.seen, layers.seen**2))
    mean = total / k
    variance = np.maximum(square / k - mean**2, 0.0) * (k / np.maximum(k - 1.0, 1.0))
    # Variance of counts is their mean by chance, within a few of its own errors.
    chance = mean * (1.0 + SD * np.sqrt(2.0 / np.maximum(k - 1.0, 1.0)))
    found: NDArray[np.bool_] = variance <= _UNEVEN * mean**2 + chance
    return found


def hidden(
    index: NDArray[np.int64], mode: NDArray[np.int64], ground: Foot
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Where heights count from in cells without ground near by, (n,) int64 [quanta], (n,) bool.

    That is so far below what is fullest around: fog that hides the ground follows it.

    Parameters
    ----------
    index, mode : (n,) int64
        Cells, and the half-metre of the fullest metre of each.
    """
    lone = ~ground.near
    values = np.stack([np.where(lone, mode, 0), lone], axis=1)
    total, count = sums_around(index, values, PATCH_CELLS).T
    middle_m = total / np.maximum(count, 1.0) / 2.0
    foot = np.rint((middle_m - HIDDEN_M) * QUANTA_PER_M).astype(np.int64)
    return foot, lone


def in_mist(
    cells: Cells, along_m: NDArray[np.float64], height_m: NDArray[np.float64], rate: RateSettings
) -> NDArray[np.bool_]:
    """Photons in what a reader is told of, (n,) bool."""
    at = np.floor(along_m / rate.cell_m).astype(np.int64)
    low, high, photons = cells.mist[np.searchsorted(cells.index, at)].T
    inside: NDArray[np.bool_] = (photons > 0.0) & (height_m >= low) & (height_m < high)
    return inside
