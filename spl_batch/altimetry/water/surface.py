"""Water surfaces: the highest layer of signal that is level over 800 m, and refraction below.

Water is level where land is not: photons of 800 m within half a metre of a line of slope
0.0007 or less, whose cells scatter by a wave, in most of its cells, with next to nothing above.

A product locates photons as if light went through air all the way. In water it is slower and bends:
a floor seems deeper than it is, by a third at nadir. The correction is that of C. Parrish et al.
(Remote Sens. 11, 1634, 2019) for a level surface: S = D / cos(t1) is the slant range in air,
R = S n1 / n2 that in water, and a photon is lifted by the height of their difference as vectors.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.constants import QUANTA_PER_M

NO_WATER: Final = int(np.iinfo(np.int32).min)
"""Level of cells that show no water."""

SURFACE_M: Final = 1.0
"""Depth down to which signal is called surface [m]."""

_STEP_CELLS: Final = 5
_REACH_CELLS: Final = 20
"""Cells from one look at the track to the next, and that each takes in to either side [count]."""

_BIN_M: Final = 0.25
_FULL: Final = 0.25
"""Photons of the highest layer that may be a surface, over those of the fullest."""

_NEAR_M: Final = 0.5
_CELL_PHOTONS: Final = 2
_CELLS_SHARE: Final = 0.7
"""Photons of a cell that lie so near show the surface; share of the cells that show it."""

_SLOPE: Final = 0.0007
_ROUGH_M: Final = 0.2
"""Slope, and normalised median scatter of the cells' medians, of what is level [m/m, m]."""

_ABOVE_M: Final = 15.0
_ABOVE_SHARE: Final = 0.1
"""Photons so far above the surface, over those of the surface, at most."""


def water_levels(
    cell: NDArray[np.int64], height: NDArray[np.int32], index: NDArray[np.int64], cell_m: float
) -> NDArray[np.int64]:
    """Water surface of each cell of a window, (c,) int64 [quanta]; ``NO_WATER`` for none.

    ``cell``, ``height``: of each signal photon, in order [quanta]. ``index``: numbers of the cells:
    each look lies at the same cells whatever the window. ``cell_m``: length of a cell [m].
    """
    out = np.full(len(index), NO_WATER)
    z_m = height / QUANTA_PER_M
    for middle in np.flatnonzero(index % _STEP_CELLS == _STEP_CELLS // 2).tolist():
        ends = np.searchsorted(cell, (middle - _REACH_CELLS, middle + _REACH_CELLS + 1))
        some = slice(*ends.tolist())
        line = _level(cell[some] - middle, z_m[some], cell_m)
        if line is not None:
            mine = slice(max(middle - _STEP_CELLS // 2, 0), middle + _STEP_CELLS // 2 + 1)
            at = np.arange(len(index))[mine] - middle
            out[mine] = np.rint((line[0] + line[1] * at * cell_m) * QUANTA_PER_M)
    return out


def _level(
    cell: NDArray[np.int64], z_m: NDArray[np.float64], cell_m: float
) -> tuple[float, float] | None:
    """Height and slope of the water surface around a cell; None where there is none."""
    top = _highest(z_m)
    if top is None:
        return None
    order = np.lexsort((z_m, cell))
    cell, z_m = cell[order], z_m[order]
    least = _CELLS_SHARE * np.count_nonzero(np.bincount(cell + _REACH_CELLS))
    line = np.array([0.0, top])
    for _ in range(2):
        near = np.abs(z_m - line[1] - line[0] * cell * cell_m) <= _NEAR_M
        count = np.bincount(cell[near] + _REACH_CELLS)
        first, shown = np.cumsum(count) - count, np.flatnonzero(count >= _CELL_PHOTONS)
        if len(shown) < max(least, 3):
            return None
        ordered, at_m = z_m[near], (shown - _REACH_CELLS) * cell_m
        middle = first[shown] + (count[shown] - 1) // 2
        heights = (ordered[middle] + ordered[first[shown] + count[shown] // 2]) / 2.0
        line = np.polyfit(at_m, heights, 1)
    off = heights - np.polyval(line, at_m)
    above_m = z_m - np.polyval(line, cell * cell_m)
    over = np.count_nonzero((above_m > SURFACE_M) & (above_m <= _ABOVE_M))
    level = abs(line[0]) <= _SLOPE and 1.4826 * np.median(np.abs(off)) <= _ROUGH_M
    if not level or over > _ABOVE_SHARE * np.count_nonzero(near):
        return None
    return float(line[1]), float(line[0])


def _highest(z_m: NDArray[np.float64]) -> float | None:
    """Height of the highest layer of half a metre that is full enough; None without photons."""
    if not len(z_m):
        return None
    least = float(np.floor(z_m.min() / _BIN_M))
    counts = np.bincount((z_m / _BIN_M - least).astype(np.int64))
    layer = np.convolve(counts, [1, 1, 1], "same")
    b = int(np.flatnonzero(layer >= _FULL * layer.max())[-1])
    # The edge of a full layer is no layer of its own.
    while b and layer[b - 1] > layer[b]:
        b -= 1
    return (least + b + 0.5) * _BIN_M


AIR: Final = 1.00029
WATER: Final = 1.34116
"""Refractive indices that the paper gives, for sea water and 532 nm."""


def refracted(depth_m: NDArray[np.float64], off_nadir_deg: float) -> NDArray[np.float64]:
    """Height that photons below a surface gain, (n,) float64 [m].

    ``depth_m``: depth below the surface as the product has it; at 0 and above nothing moves.
    ``off_nadir_deg``: angle of the ray in air from the vertical.
    """
    air = np.radians(off_nadir_deg)
    water = np.arcsin(AIR * np.sin(air) / WATER)
    apparent = np.maximum(depth_m, 0.0) / np.cos(air)
    up: NDArray[np.float64] = apparent * np.cos(air) - apparent * AIR / WATER * np.cos(water)
    return up
