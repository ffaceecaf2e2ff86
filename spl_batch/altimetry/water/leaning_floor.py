"""Floors so steep that they lean within a cell.

A steep floor fills many depths of a cell with few photons each, so no level box holds more than
noise does. Sheared by its slope it is one thin layer again. So the photons of a cell are sheared
by slope after slope and counted by layers, as ground is sought
(:mod:`spl_batch.altimetry.ground.cell_ground`); the layer that holds most beyond what noise lets
expect is a floor, and the depths that it passes through are none of the noise's.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.numerics.compiled import njit

_SLOPES: Final = 10
"""Slopes tried to each side, a tenth apart: the ends of a cell move by a layer from one to the
next [count]."""

STEEP = -1
MEET_M = 2.0
LAYER_M: Final = 1.0
_HALF_M: float = 0.5
_SD: float = 4.0
_LEAST: float = 2.0
"""Thickness of a layer [m]; standard deviations, and photons beside them, that it is over
noise."""


@njit()
def leaning_layers(
    inside_m: NDArray[np.float64],
    depth_m: NDArray[np.float64],
    edges: NDArray[np.int64],
    noise: NDArray[np.float64],
    cell_m: float,
    out: NDArray[np.float64],
) -> None:
    """The leaning layer of each cell that stands out of noise most.

    Parameters
    ----------
    inside_m, depth_m : (p,) float64
        Photons of cells one after the other: place from the middle of the cell, and depth [m].
    edges : (n + 1,) int64
        First photon of each cell.
    noise : (n, d) float64
        Photons of noise that each metre of depth lets expect [count].
    cell_m : float
        Length of a cell [m].
    out : (n, 3) float64
        Receives depth in the middle of the cell [m], slope [m/m], and photons beyond the noise
        expected [count]; NaN where no layer stands out.
    """
    n, depths = noise.shape
    bins = int(depths / _HALF_M) + 2 * int(cell_m)
    count = np.zeros(bins, np.int64)
    total = np.zeros(depths + 1)
    for c in range(n):
        out[c] = np.nan
        first, stop = edges[c], edges[c + 1]
        if stop - first < _LEAST:
            continue
        for d in range(depths):
            total[d + 1] = total[d] + noise[c, d]
        best = 0.0
        for turn in range(2 * _SLOPES + 1):
            # 0, 1, -1, 2, -2, ...: the gentlest first.
            slope = ((turn + 1) // 2 if turn % 2 else -(turn // 2)) / _SLOPES
            half = abs(slope) * cell_m / 2.0
            count[:] = 0
            for i in range(first, stop):
                b = int((depth_m[i] - slope * inside_m[i] + cell_m / 2.0) / _HALF_M)
                if 0 <= b < bins:
                    count[b] += 1
            for b in range(bins - 1):
                held = count[b] + count[b + 1]
                if held < _LEAST:
                    continue
                # A layer of two bins; it passes through depths by its slope.
                middle = (b + 1) * _HALF_M - cell_m / 2.0
                low = max(int(np.floor(middle - _HALF_M - half)), 0)
                high = min(int(np.ceil(middle + _HALF_M + half)), depths)
                if high <= low:
                    continue
                expected = (total[high] - total[low]) / (high - low) * (2.0 * _HALF_M)
                more = held - expected - _SD * np.sqrt(expected) - _LEAST
                if more > best:
                    best = more
                    out[c, 0], out[c, 1], out[c, 2] = middle, slope, held - expected


def confirmed(
    index: NDArray[np.int64], layers: NDArray[np.float64], cell_m: float
) -> NDArray[np.bool_]:
    """Cells whose layer meets that of a cell beside it where they join, (n,) bool."""
    found = np.zeros(len(index), np.bool_)
    beside = np.diff(index) == 1
    ends = layers[:, :1] + layers[:, 1:2] * np.array([-0.5, 0.5]) * cell_m
    meet = beside & (np.abs(ends[:-1, 1] - ends[1:, 0]) <= MEET_M)
    found[:-1] |= meet
    found[1:] |= meet
    with np.errstate(invalid='ignore'):
        return found & (np.abs(layers[:, 1]) >= STEEP)


def depths_of(
    layers: NDArray[np.float64], some: NDArray[np.bool_], depths: int, cell_m: float
) -> NDArray[np.bool_]:
    """Metres of depth that the layers of some cells pass through, (n, depths) bool."""
    half = np.abs(layers[:, 1]) * cell_m / 2.0 + _HALF_M
    d = np.arange(depths)
    with np.errstate(invalid="ignore"):
        low, high = np.floor(layers[:, 0] - half), np.ceil(layers[:, 0] + half)
        return some[:, None] & (d >= low[:, None]) & (d < high[:, None])
