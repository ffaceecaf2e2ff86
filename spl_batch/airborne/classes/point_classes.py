"""ASPRS class of each point, from its noise class, the ground filter, and the terrain below it.

Domain: space. Runs on the points that a ground cell owns, once its DTM is made.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.ground.water_level import APART_M, NEAR_M
from spl_batch.constants import (
    CLASS_BUILDING,
    CLASS_GROUND,
    CLASS_HIGH_NOISE,
    CLASS_LOW_NOISE,
    CLASS_UNCLASSIFIED,
    CLASS_WATER,
    CLASS_WIRE,
    NODATA,
    NOISE_AFTERPULSE,
    NOISE_BACKGROUND,
    NOISE_NOT_ASSESSED,
    NOISE_SIGNAL,
    QUANTUM_M,
)
from spl_batch.lattice.tables import EXCLUDED, PointFlag, PointTable
from spl_batch.lattice.tiles import Bounds, inside

DOMAIN: Final = "space"

COLUMNS_NEEDED: Final = ("x", "y", "z", "noise_class", "ground", "input_class", "flags")
"""And ``wire`` where wires are looked for."""

COLUMNS_ADDED: Final = ("classification",)

WIRE_ABOVE_M: Final = 3.0
"""Conductors hang at least so high [m]."""


def classify(table: PointTable, cell: Bounds, dtm: NDArray[np.float32]) -> NDArray[np.uint8]:
    """ASPRS class of each point as delivered.

    Parameters
    ----------
    table : PointTable
        Points of the cell with ``x, y, z, noise_class, ground, input_class, flags``. Points
        outside the cell are compared with the DTM at its nearest rim.
    cell : Bounds
        The ground cell [quanta].
    dtm : (rows, cols) float32
        Its DTM, north up [m]; nodata where there is none.

    Returns
    -------
    (n,) uint8
        2 ground; 7 noise below the surface, 18 above it; 9 water: the input's, or in a
        water polygon within :data:`~spl_batch.airborne.ground.water_level.NEAR_M` of the DTM, which
        is the
        water's surface there, or where there is none; its bottom, as whatever else lies deeper
        or higher, is 1; 6 where the input says building; 14 where ``wire`` is
        given and 1, at least :data:`WIRE_ABOVE_M` above the surface; 1 the rest. Points that
        nothing assessed keep the input's class, except that class 2 is this project's ground only.

    Notes
    -----
    Where the DTM is void, the median height of the cell's signal stands for the surface;
    without any signal, all noise is above it.
    """
    noise_class, given = table["noise_class"], table["input_class"]
    ground, assessed = table["ground"] == 1, noise_class != NOISE_NOT_ASSESSED
    surface, void = _surface_below(table, cell, dtm)
    height = table["z"] * QUANTUM_M - surface
    at_surface = np.abs(height) <= NEAR_M + np.where(ground, APART_M, 0.0)
    water = table.has(PointFlag.WATER) & (void | at_surface)
    result = np.where(
        np.isin(given, (CLASS_BUILDING, CLASS_WATER)) | ~assessed, given, CLASS_UNCLASSIFIED
    )
    # The input's own ground is not what the ground filter found.
    result[result == CLASS_GROUND] = CLASS_UNCLASSIFIED
    result[ground] = CLASS_GROUND
    result[water] = CLASS_WATER
    if "wire" in table:
        clear = (table["wire"] == 1) & (height >= WIRE_ABOVE_M)
        result[clear & (result == CLASS_UNCLASSIFIED)] = CLASS_WIRE
    noise = (noise_class == NOISE_BACKGROUND) | (noise_class == NOISE_AFTERPULSE)
    result[noise] = np.where(height[noise] < 0, CLASS_LOW_NOISE, CLASS_HIGH_NOISE)
    untouched = ~assessed & table.has(EXCLUDED | PointFlag.OUTSIDE_AOI)
    result[untouched] = given[untouched]
    return result.astype(np.uint8)


def _surface_below(
    table: PointTable, cell: Bounds, dtm: NDArray[np.float32]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Height of the surface at each point [m], -inf if nothing is known; where the DTM is void."""
    rows, cols = dtm.shape
    size = (cell.xmax - cell.xmin) // cols
    row = rows - 1 - np.clip((table["y"] - cell.ymin) // size, 0, rows - 1)
    col = np.clip((table["x"] - cell.xmin) // size, 0, cols - 1)
    surface = dtm[row, col].astype(np.float64)
    void = surface == np.float32(NODATA)
    if void.any():
        signal = (table["noise_class"] == NOISE_SIGNAL) & inside(table["x"], table["y"], cell)
        surface[void] = np.median(table["z"][signal]) * QUANTUM_M if signal.any() else -np.inf
    return surface, void
