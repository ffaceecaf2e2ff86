"""Fired beamlets against a surface: which were seen, and where the silent ones ended."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.products.reflectance.beamlet_matching import (
    CELL_BITS,
    SILENT,
    Blocks,
    aim_at,
)
from spl_batch.constants import QUANTUM_M
from spl_batch.numerics.compiled import njit

COARSE = 8
"""Cells along one side of the coarse squares that bound heights [count]."""

U_COARSE = np.uint64(COARSE)

STEP_CELLS = 0.5
"""Step of a ray over the ground [cells]."""

MAX_STEPS = 400
"""Longest walk of a ray [count]."""

COSINE_MIN = 0.2
"""Incidence is not corrected for beyond this [1]."""


class Grid(NamedTuple):
    """Square cells from a south-west corner, to which all places are relative."""

    cell_m: float
    height: NDArray[np.float64]  #: (rows, cols): surface of each cell [m]; NaN where there is none.
    slope: NDArray[np.float64]  #: (rows, cols, 2): its gradient to the east and to the north.
    #: (r, c): bounds of the heights in and around each square of ``COARSE`` cells [m].
    low: NDArray[np.float64]
    high: NDArray[np.float64]


@njit()
def trace(
    height: NDArray[np.float64],
    low: NDArray[np.float64],
    high: NDArray[np.float64],
    cell_m: float,
    level: float,
    aim: NDArray[np.float64],
    pattern: NDArray[np.float64],
    wanted: NDArray[np.int64],
    cell: NDArray[np.int64],
) -> None:
    """Cells where the silent beamlets of a shot meet the surface, ``row * cols + col``; else -1.

    The arrays of a :class:`Grid` are looked into by this function alone: what is called for each
    beamlet would count references to them up and down, a third of the time. The walk's bounds are
    looked up from ``level``, a height near the surface [m]; ``aim`` (9,): as :func:`aim_at` has it;
    ``pattern`` (c, 2): place of each channel in the array, NaN for those that there are not; of
    ``wanted`` (c,), first returns, those are traced that are :data:`SILENT`.
    """
    rows, cols = height.shape
    per_m = 1.0 / cell_m
    for c in range(len(wanted)):
        cell[c] = -1
        gx, gy = pattern[c, 0], pattern[c, 1]
        if wanted[c] != SILENT or np.isnan(gx):
            continue
        # Column and row at height z are x0 + x1 * z and y0 + y1 * z, in cells.
        x1 = (aim[3] + aim[5] * gx + aim[7] * gy) * per_m
        y1 = (aim[4] + aim[6] * gx + aim[8] * gy) * per_m
        x0, y0 = aim[0] * per_m - x1 * aim[2], aim[1] * per_m - y1 * aim[2]
        z, end = level, np.inf
        for _ in range(2):
            x, y = x0 + x1 * z, y0 + y1 * z
            if x < 0.0 or y < 0.0 or x >= cols or y >= rows:
                break
            i, j = np.uint64(x) // U_COARSE, np.uint64(y) // U_COARSE
            if np.isnan(high[j, i]):
                break
            z, end = high[j, i], min(end, low[j, i])
        over = max(abs(x1), abs(y1))
        step = STEP_CELLS / over if over > 1e-6 else np.inf
        for _ in range(MAX_STEPS):
            x, y = x0 + x1 * z, y0 + y1 * z
            if 0.0 <= x < cols and 0.0 <= y < rows and z <= height[np.uint64(y), np.uint64(x)]:
                cell[c] = np.int64(y) * cols + np.int64(x)
                break
            if z <= end:
                break
            z = max(z - step, end)


@njit()
def exposure(
    slope: tuple[float, float],
    z: float,
    height: float,
    lean: tuple[float, float],
    constant: float,
    extinction: float,
) -> float:
    """Photo-electrons per reflectance that a beamlet brings from a cell [W17 Eq. 2.1].

    ``slope`` of the cell, met at ``z`` from the sensor's ``height`` [m]; ``lean``: dx/dz, dy/dz of
    the beamlet; ``constant``: of instrument and channel [m2]; ``extinction`` of the air [1/m].
    """
    length = math.sqrt(1.0 + lean[0] * lean[0] + lean[1] * lean[1])
    range_m = (height - z) * length
    amount = constant * (math.exp(-2.0 * extinction * range_m) / (range_m * range_m))
    sx, sy = slope
    cosine = (1.0 - sx * lean[0] - sy * lean[1]) / (length * math.sqrt(1 + sx * sx + sy * sy))
    return amount * max(cosine, COSINE_MIN)


@njit()
def expose_cells(
    shots: tuple[NDArray[np.int64], NDArray[np.float64]],
    blocks: Blocks,
    top: NDArray[np.int64],
    grid: Grid,
    core: tuple[int, int, int, int],
    level: float,
    extinction: float,
    fixed: float,
    silent: NDArray[np.int64],
    fired: NDArray[np.int64],
    seen_cell: NDArray[np.int64],
    seen_amount: NDArray[np.float64],
) -> int:
    """Share out every fired beamlet to the cell of its first return, or where it ended.

    ``shots``: block of each, and its time within that; ``top``: from :func:`match_points`;
    ``core``: first and past-the-last row, first and past-the-last column of the cells wanted, which
    the outputs have; ``level``: a height near the surface [m]; ``fixed``: steps of ``silent`` per
    photo-electron and reflectance. Added to: ``silent``, sum over silent beamlets, and ``fired``,
    beamlets of each cell. Filled: cell and photo-electrons per reflectance of each seen beamlet,
    whose number is returned.
    """
    aim, ends = np.empty(9), np.empty(top.shape[1], np.int64)
    r0, r1, c0, c1 = core
    # Taken out of their tuples once: each look into one counts references up and down.
    height, low, high, cell_m = grid.height, grid.low, grid.high, grid.cell_m
    slope, brightness, pattern = grid.slope, blocks.exposure, blocks.pattern
    cols = np.int64(height.shape[1])
    count = 0
    for s in range(len(top)):
        b = shots[0][s]
        aim_at(blocks, b, shots[1][s], aim)
        trace(height, low, high, cell_m, level, aim, pattern[b], top[s], ends)
        for c in range(top.shape[1]):
            constant = brightness[b, c]
            gx, gy = pattern[b, c, 0], pattern[b, c, 1]
            if constant <= 0.0 or np.isnan(gx):
                continue
            first = top[s, c]
            cell = first & np.int64(CELL_BITS) if first != SILENT else ends[c]
            if cell < 0:
                continue
            row, col = cell // cols, cell % cols
            if row < r0 or row >= r1 or col < c0 or col >= c1:
                continue
            z = (first >> np.int64(32)) * QUANTUM_M if first != SILENT else height[row, col]
            lean = aim[3] + aim[5] * gx + aim[7] * gy, aim[4] + aim[6] * gx + aim[8] * gy
            steep = slope[row, col, 0], slope[row, col, 1]
            amount = exposure(steep, z, aim[2], lean, constant, extinction)
            fired[row - r0, col - c0] += 1
            if first != SILENT:
                seen_cell[count] = (row - r0) * (c1 - c0) + col - c0
                seen_amount[count] = amount
                count += 1
            else:
                silent[row - r0, col - c0] += np.int64(np.rint(amount * fixed))
    return count
