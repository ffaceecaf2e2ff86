"""ASPRS class of each point, from its noise class, the ground filter, and the terrain below it.

Domain: space. Runs on the points that a ground cell owns, once its DTM is made.
"""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.ground.water.level import APART_M, NEAR_M
from spl_batch.airborne.settings import VegetationSettings
from spl_batch.constants import (
    CLASS_BUILDING,
    CLASS_GROUND,
    CLASS_HIGH_NOISE,
    CLASS_HIGH_VEGETATION,
    CLASS_LOW_NOISE,
    CLASS_LOW_VEGETATION,
    CLASS_MEDIUM_VEGETATION,
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

COLUMNS_NEEDED: Final = ("x", "y", "z", "noise_class", "ground", "input_class", "flags")
"""And ``wire`` where wires are looked for."""

WIRE_ABOVE_M: Final = 3.0
"""Conductors hang at least so high [m]."""


UNDECIDED: Final = (0, CLASS_UNCLASSIFIED, *range(CLASS_LOW_VEGETATION, CLASS_HIGH_VEGETATION + 1))
"""Classes that make way where vegetation and buildings are asked for."""


class Further(NamedTuple):
    """Classes that are asked for beyond ground, noise and water."""

    building: NDArray[np.bool_] | None = None  #: (n,): points that are of buildings.
    #: Heights from which on the others are vegetation.
    vegetation: VegetationSettings | None = None


NOTHING_FURTHER: Final = Further()


def classify(
    table: PointTable,
    cell: Bounds,
    dtm: NDArray[np.float32],
    further: Further = NOTHING_FURTHER,
) -> NDArray[np.uint8]:
    """ASPRS class of each point of a cell as delivered: (n,) uint8.

    2 ground; 7 noise below the surface, 18 above it; 9 water: the input's, or in a water polygon
    within :data:`~spl_batch.airborne.ground.water.level.NEAR_M` of the DTM, which is the water's
    surface there, or where there is none; its bottom, as whatever else lies deeper or higher, is 1;
    6 where the input has building; 14 where ``wire`` is given and 1, at least :data:`WIRE_ABOVE_M`
    above the surface; 1 the rest. Points that are withheld or outside the area of interest keep the
    input's class. Others that nothing assessed keep it too, but class 2 is only what this project
    found. Of what would be 1, or is vegetation by the input: 6 of a building that was found; 3, 4,
    5 by height above the DTM, where it is not void.

    Where the DTM is void, the median height of the cell's signal stands for the surface; without
    any signal, all noise is above it. Points outside the cell are compared with its nearest rim.
    """
    noise_class, given = table["noise_class"], table["input_class"]
    ground, assessed = table["ground"] > 0, noise_class != NOISE_NOT_ASSESSED
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
    open_to = np.isin(result, UNDECIDED) & ((noise_class == NOISE_SIGNAL) | ~assessed)
    open_to &= ~table.has(EXCLUDED | PointFlag.OUTSIDE_AOI)
    _add(further, result, open_to, np.where(void, -np.inf, height))
    noise = (noise_class == NOISE_BACKGROUND) | (noise_class == NOISE_AFTERPULSE)
    result[noise] = np.where(height[noise] < 0, CLASS_LOW_NOISE, CLASS_HIGH_NOISE)
    untouched = ~assessed & table.has(EXCLUDED | PointFlag.OUTSIDE_AOI)
    result[untouched] = given[untouched]
    return result.astype(np.uint8)


def _add(
    further: Further,
    result: NDArray[np.uint8],
    open_to: NDArray[np.bool_],
    height: NDArray[np.float64],
) -> None:
    """Classes that were asked for, of points that have no other."""
    if further.building is not None:
        result[open_to & further.building] = CLASS_BUILDING
        open_to = open_to & ~further.building
    if further.vegetation is not None:
        heights = further.vegetation
        for least_m, kind in (
            (heights.low, CLASS_LOW_VEGETATION),
            (heights.medium, CLASS_MEDIUM_VEGETATION),
            (heights.high, CLASS_HIGH_VEGETATION),
        ):
            result[open_to & (height >= least_m)] = kind


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
        heights = table["z"][signal]
        surface[void] = np.median(heights) * QUANTUM_M if len(heights) else -np.inf
    return surface, void
