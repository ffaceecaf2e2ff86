"""How long a neighbourhood is, and how many neighbours count, by what a cell shows of the scene."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.altimetry.noise.windows import of_window
from spl_batch.altimetry.photon_table import Cells
from spl_batch.altimetry.settings import RateSettings, SignalSettings
from spl_batch.altimetry.water.level_water import NO_WATER

_RISE_M: Final = 4.0
"""How far ground may rise along the neighbours that count [m]."""

_THIN_M: Final = 100.0
"""Height of gate whose noise is less than the signal where fewer neighbours do [m]."""

_FEWEST: Final = 10
"""Neighbours that count at least [count]."""


def aspects(cells: Cells, signal: SignalSettings) -> NDArray[np.float64]:
    """Along-track over vertical extent of a neighbourhood in each cell, (n,) float64.

    Ground of slope s leaves a neighbourhood that is longer over high than 1 / s. Nothing is longer
    than a water surface allows, which is level.
    """
    longest = max(signal.aspect, signal.water_aspect)
    slope = np.maximum(cells.slope.astype(np.float64), 1.0 / longest)
    wet = cells.level != NO_WATER
    aspect: NDArray[np.float64] = np.where(wet, longest, np.maximum(1.0 / slope, signal.aspect))
    return aspect


def neighbours(
    cells: Cells, density: NDArray[np.float64], rate: RateSettings, signal: SignalSettings
) -> NDArray[np.int64]:
    """Neighbours that count in each cell, (n,) int64 [count].

    As many signal photons lie along so much track that the ground rises by a few metres there.
    Fewer than ten tell no sparse signal from noise, and where noise is dense all are needed.

    Parameters
    ----------
    density : (n,) float64
        Noise of each [1/m2].
    """
    length = np.full(len(density), rate.cell_m)
    values = np.stack([cells.count.astype(np.float64), density * cells.gate_m * length, length])
    at, (count, noise, along_m) = of_window(cells.index, values, rate, signal.window_m)
    per_m = (np.maximum(count - noise, 0.0) / along_m)[at]
    slope = np.maximum(cells.slope.astype(np.float64), 1e-3)
    thin = per_m > _THIN_M * density
    wanted = np.where(thin, np.rint(_RISE_M * per_m / slope), signal.neighbours)
    dry = np.clip(wanted, min(_FEWEST, signal.neighbours), signal.neighbours)
    wet = min(signal.water_neighbours, signal.neighbours)
    return np.where(cells.level != NO_WATER, wet, dry).astype(np.int64)
