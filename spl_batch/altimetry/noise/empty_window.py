"""The part of a gate that shows noise alone [W17 4.1.1].

In a long gate that is what lies farther than a buffer from the surface. A gate of a wood by night
may be little higher than the wood: whatever is near to a fixed height is then crown, and crowns
that are taken for noise hide the whole wood. So where the buffer leaves too little, the emptiest
quarter of the gate tells, by the photons of the cells around: a cell's own do not choose what is
counted of them, and chance does not make the noise less than it is.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.altimetry.noise.fog import Fog, extent
from spl_batch.altimetry.noise.gate import STRETCH_CELLS
from spl_batch.altimetry.settings import RateSettings
from spl_batch.altimetry.water.emptiest import QUARTER, Photons, emptiest, mean_height, sums_around
from spl_batch.constants import QUANTA_PER_M
from spl_batch.lattice.tiles import quanta

_MEAN_CELLS: Final = 2
"""Cells to each side whose photons say how high a cell lies [count]."""

_SURE_SD: Final = 3.0

_LEAST_M: Final = 4
"""What is nearer to a water surface is never empty, whatever the gate [m]."""


def empty_window(
    photons: Photons,
    gate: tuple[NDArray[np.int32], NDArray[np.int32]],
    peak: NDArray[np.int64],
    wet: NDArray[np.bool_],
    fog: Fog,
    settings: RateSettings,
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Photons in the empty window of each cell, and its length: (n,) int64 [count, quanta].

    Parameters
    ----------
    gate : ((n,) int32, (n,) int32)
        Lower and upper end [quanta].
    peak : (n,) int64
        Surface [quanta].
    wet : (n,) bool
        Cells with a water surface: noise is counted above it alone.
    fog : Fog
        Clouds, which show no noise.
    """
    buffer = quanta(settings.buffer_m)
    low, high = (end.astype(np.int64) for end in gate)
    over = np.maximum(high - peak, 0)
    edge = np.where(wet, np.clip(over // 2, _LEAST_M * QUANTA_PER_M, buffer), buffer)
    ends = np.stack([np.where(wet, low, peak - edge), peak + edge])
    cloud = extent(fog)
    length = _outside((low, ends[0]), cloud) * ~wet + _outside((ends[1], high), cloud)
    cell, height = photons.cell, photons.height.astype(np.int64)
    away = (height >= ends[1][cell]) | (~wet[cell] & (height < ends[0][cell]))
    away &= (height < cloud[0][cell]) | (height >= cloud[1][cell])
    count = np.bincount(cell[away], minlength=len(low))
    # What a cloud leaves of a gate ends where it begins.
    top = np.where(cloud[1] > cloud[0], np.clip(cloud[0], low, high), high)
    short = ~wet & (length * QUARTER < top - low)
    if short.any():
        middle = mean_height(photons, _MEAN_CELLS)
        found = emptiest(photons, (low, top), middle, short, STRETCH_CELLS)
        full = _fuller(photons.number, found, (count * ~short, length * ~short))
        found = found[0] * ~full, found[1] * ~full
        count, length = (
            np.where(short, *both) for both in zip(found, (count, length), strict=True)
        )
    return count.astype(np.int64), length


def _fuller(
    index: NDArray[np.int64],
    emptiest_quarter: tuple[NDArray[np.int64], NDArray[np.int64]],
    window: tuple[NDArray[np.int64], NDArray[np.int64]],
) -> NDArray[np.bool_]:
    """Cells around which the emptiest quarter holds more than the noise seen near by: (n,) bool.

    Woods on a slope have crowns at every height, and by night a gate that few photons show may seem
    no higher than they are. Long windows within a kilometre then tell what the quarter cannot.

    Parameters
    ----------
    emptiest_quarter, window : ((n,) int64, (n,) int64)
        Photons, and the length that they are counted in [count, quanta].
    """
    own = np.stack([emptiest_quarter[0], emptiest_quarter[1] / QUANTA_PER_M], axis=1)
    near = np.stack([window[0], window[1] / QUANTA_PER_M], axis=1)
    seen, seen_m = sums_around(index, own, _MEAN_CELLS).T
    noise, noise_m = sums_around(index, near, STRETCH_CELLS).T
    ratio = seen_m / np.maximum(noise_m, 1.0)
    chance = _SURE_SD * np.sqrt(seen + (noise + 1.0) * ratio**2)
    found: NDArray[np.bool_] = (noise_m > seen_m) & (seen > noise * ratio + chance)
    return found


def _outside(
    band: tuple[NDArray[np.int64], NDArray[np.int64]],
    cloud: tuple[NDArray[np.int64], NDArray[np.int64]],
) -> NDArray[np.int64]:
    """Length of a band of heights without the cloud in it, (n,) int64 [quanta]."""
    (first, stop), (base, top) = band, cloud
    inside = np.minimum(stop, top) - np.maximum(first, base)
    left: NDArray[np.int64] = np.maximum(stop - first, 0) - np.maximum(inside, 0)
    return left
