"""Fired beamlets against a surface: which were seen, and where the silent ones ended."""

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from spl_batch.constants import QUANTUM_M

COARSE = 8
"""Cells along one side of the coarse squares that bound heights [count]."""

STEP_CELLS = 0.5
"""Step of a ray over the ground [cells]."""

MAX_STEPS = 400
"""Longest walk of a ray [count]."""

COSINE_MIN = 0.2
"""Incidence is not corrected for beyond this [1]."""

SILENT = -(1 << 63)
"""First return of a beamlet that has none. Others are a word: the height [quanta] in the upper
half, in the lower the number of the cell, ``row * cols + col``."""

CELL_BITS = 0xFFFF_FFFF
"""Lower half of a first return."""


class Blocks(NamedTuple):
    """Blocks of shots of several flightlines, by time of their first shot.

    Parameters
    ----------
    begin_s : (m,) float64
        Half a period before the first shot fired, ascending [s].
    t0_s, prf_hz : (m,) float64
        Clock of the shots.
    first, last : (m,) int64
        First and last shot fired.
    middle, half : (m,) float64
        A shot's time within its block is ``(shot - middle) / half``.
    anchor : (m, 3) float64
        Relative to the grid's corner; z is a height [m].
    coefficient : (m, TERMS, 2) float64
        Where beamlets meet the reference plane, relative to the anchor [m].
    origin : (m, 2, 3) float64
        Sensor relative to the anchor, and its motion [m].
    pattern : (m, c, 2) float64
        Place of each channel in the array.
    exposure : (m, c) float64
        Photo-electrons per reflectance of each channel, times square of range [m2].
    offset : (m,) int64
        Number of the first shot among all shots.
    """

    begin_s: NDArray[np.float64]
    t0_s: NDArray[np.float64]
    prf_hz: NDArray[np.float64]
    first: NDArray[np.int64]
    last: NDArray[np.int64]
    middle: NDArray[np.float64]
    half: NDArray[np.float64]
    anchor: NDArray[np.float64]
    coefficient: NDArray[np.float64]
    origin: NDArray[np.float64]
    pattern: NDArray[np.float64]
    exposure: NDArray[np.float64]
    offset: NDArray[np.int64]


class Grid(NamedTuple):
    """Square cells from a south-west corner, to which all places are relative.

    Parameters
    ----------
    cell_m : float
        Edge [m].
    height : (rows, cols) float64
        Surface of each cell [m]; NaN where there is none.
    slope : (rows, cols, 2) float64
        Its gradient to the east and to the north.
    low, high : (r, c) float64
        Bounds of the heights in and around each square of ``COARSE`` cells [m].
    """

    cell_m: float
    height: NDArray[np.float64]
    slope: NDArray[np.float64]
    low: NDArray[np.float64]
    high: NDArray[np.float64]


@njit(nogil=True, cache=True, inline="always")
def _aim(blocks: Blocks, b: np.int64, tau: float, out: NDArray[np.float64]) -> None:
    """Sensor [m], dx/dz and dy/dz of the array's middle, and their change with g: (9,)."""
    for k in range(3):
        out[k] = blocks.anchor[b, k] + blocks.origin[b, 0, k] + tau * blocks.origin[b, 1, k]
    scale = 1.0 / (blocks.anchor[b, 2] - out[2])
    a = blocks.coefficient[b]
    for k in range(2):
        path = a[0, k] + tau * (a[1, k] + tau * (a[2, k] + tau * a[3, k]))
        out[3 + k] = (blocks.anchor[b, k] + path - out[k]) * scale
        out[5 + k] = (a[4, k] + tau * a[5, k]) * scale
        out[7 + k] = (a[6, k] + tau * a[7, k]) * scale


@njit(nogil=True, cache=True)
def _miss2(
    blocks: Blocks, b: np.int64, shot: np.int64, c: int, x: float, y: float, z: float,
    aim: NDArray[np.float64],
) -> float:  # fmt: skip
    """Squared horizontal distance at which a beamlet passes a point [m2]."""
    _aim(blocks, b, (shot - blocks.middle[b]) / blocks.half[b], aim)
    gx, gy = blocks.pattern[b, c, 0], blocks.pattern[b, c, 1]
    dx = aim[0] + (aim[3] + aim[5] * gx + aim[7] * gy) * (z - aim[2]) - x
    dy = aim[1] + (aim[4] + aim[6] * gx + aim[8] * gy) * (z - aim[2]) - y
    return float(dx * dx + dy * dy)


@njit(nogil=True, cache=True)
def match_points(
    time_s: NDArray[np.float64],
    channel: NDArray[np.uint8],
    place: tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int32]],
    rows: NDArray[np.intp],
    cells: tuple[int, int, int, int],
    blocks: Blocks,
    longest_s: float,
    number: NDArray[np.int64],
    top: NDArray[np.int64],
) -> None:
    """First return of each beamlet: the highest, for beams go down.

    Of several flightlines that were flown at the same time, the one takes a point whose
    beamlet passes nearest to it.

    Parameters
    ----------
    time_s, channel : (n,)
        Time and beamlet of each point.
    place : three (n,) integer arrays
        Easting, northing and height [quanta].
    rows : (m,) intp
        Points that may be first returns; they lie in the grid.
    cells : (int, int, int, int)
        South-west corner of the grid (x, y) and edge of a cell [quanta], cells of a row.
    blocks : Blocks
        Shots fired.
    longest_s : float
        Longest block [s].
    number : (shots,) int64
        Row of each shot in ``top``; -1 for shots that do not matter.
    top : (k, c) int64
        Filled with the height and cell of each beamlet's first return, or :data:`SILENT`.
    """
    top[:] = SILENT
    aim = np.empty(9)
    west, south, size, cols = cells
    for p in rows:
        c = int(channel[p])
        if c >= top.shape[1]:
            continue
        east, north = place[0][p] - west, place[1][p] - south
        b = np.searchsorted(blocks.begin_s, time_s[p], side="right") - 1
        best, least, taken = np.int64(-1), np.inf, np.int64(-1)
        while b >= 0 and blocks.begin_s[b] >= time_s[p] - longest_s:
            shot = np.int64(np.rint((time_s[p] - blocks.t0_s[b]) * blocks.prf_hz[b]))
            if blocks.first[b] <= shot <= blocks.last[b] and not np.isnan(blocks.pattern[b, c, 0]):
                miss = 0.0
                if taken >= 0:
                    x, y, z = east * QUANTUM_M, north * QUANTUM_M, place[2][p] * QUANTUM_M
                    miss = _miss2(blocks, b, shot, c, x, y, z, aim)
                    if least == 0.0:
                        other = np.rint((time_s[p] - blocks.t0_s[taken]) * blocks.prf_hz[taken])
                        least = _miss2(blocks, taken, np.int64(other), c, x, y, z, aim)
                if taken < 0 or miss < least:
                    taken, least = b, miss
                    best = number[blocks.offset[b] + shot - blocks.first[b]]
            b -= 1
        if best >= 0:
            # No quotient of whole numbers so small rounds up to the next whole one.
            row, col = np.int64(north / size), np.int64(east / size)
            # Of two as high, the cell decides and not their order.
            word = (np.int64(place[2][p]) << np.int64(32)) | (row * cols + col)
            top[best, c] = max(top[best, c], word)


@njit(nogil=True, cache=True, inline="always")
def trace(
    grid: Grid, sensor: NDArray[np.float64], lean: NDArray[np.float64], level: float
) -> tuple[int, int]:
    """Row and column of the cell where a ray meets the surface; -1 where it meets none.

    Parameters
    ----------
    grid : Grid
        The surface.
    sensor, lean
        Position [m], and dx/dz, dy/dz.
    level : float
        A height near the surface, from which the walk's bounds are looked up [m].
    """
    rows, cols = grid.height.shape
    # Column and row at height z are x0 + x1 * z and y0 + y1 * z, in cells.
    per_m = 1.0 / grid.cell_m
    x1, y1 = lean[0] * per_m, lean[1] * per_m
    x0, y0 = sensor[0] * per_m - x1 * sensor[2], sensor[1] * per_m - y1 * sensor[2]
    z, low = level, np.inf
    for _ in range(2):
        x, y = x0 + x1 * z, y0 + y1 * z
        if x < 0.0 or y < 0.0 or x >= cols or y >= rows:
            break
        i, j = int(x) // COARSE, int(y) // COARSE
        if np.isnan(grid.high[j, i]):
            break
        z, low = grid.high[j, i], min(low, grid.low[j, i])
    over = max(abs(x1), abs(y1))
    step = STEP_CELLS / over if over > 1e-6 else np.inf
    for _ in range(MAX_STEPS):
        x, y = x0 + x1 * z, y0 + y1 * z
        if 0.0 <= x < cols and 0.0 <= y < rows:
            row, col = int(y), int(x)
            if z <= grid.height[row, col]:
                return row, col
        if z <= low:
            break
        z = max(z - step, low)
    return -1, -1


@njit(nogil=True, cache=True, inline="always")
def exposure(
    grid: Grid,
    row: int,
    col: int,
    z: float,
    sensor: NDArray[np.float64],
    lean: NDArray[np.float64],
    constant: float,
    extinction: float,
    terms: Any,
) -> float:
    """Photo-electrons per reflectance that a beamlet brings from a cell [W17 Eq. 2.1].

    Parameters
    ----------
    grid : Grid
        The surface.
    row, col, z
        Cell that is met, and at which height [m].
    sensor, lean
        Of the beamlet: position [m] and dx/dz, dy/dz.
    constant : float
        Of instrument and channel [m2].
    extinction : float
        Of the air [1/m].
    terms : (bool, bool)
        Whether range, and whether incidence is allowed for.
    """
    length = math.sqrt(1.0 + lean[0] * lean[0] + lean[1] * lean[1])
    amount = constant
    if terms[0]:
        range_m = (sensor[2] - z) * length
        amount *= math.exp(-2.0 * extinction * range_m) / (range_m * range_m)
    if terms[1]:
        sx, sy = grid.slope[row, col, 0], grid.slope[row, col, 1]
        cosine = (1.0 - sx * lean[0] - sy * lean[1]) / (length * math.sqrt(1 + sx * sx + sy * sy))
        amount *= max(cosine, COSINE_MIN)
    return amount


@njit(nogil=True, cache=True)
def expose_cells(
    shots: tuple[NDArray[np.int64], NDArray[np.float64]],
    blocks: Blocks,
    top: NDArray[np.int64],
    grid: Grid,
    core: tuple[int, int, int, int],
    level: float,
    extinction: float,
    terms: tuple[bool, bool],
    fixed: float,
    silent: NDArray[np.int64],
    fired: NDArray[np.int64],
    seen_cell: NDArray[np.int64],
    seen_amount: NDArray[np.float64],
) -> int:
    """Share out every fired beamlet to the cell of its first return, or where it ended.

    Parameters
    ----------
    shots : ((k,) int64, (k,) float64)
        Block of each shot, and its time within that.
    blocks : Blocks
        Shots fired.
    top : (k, c) int64
        From :func:`match_points`.
    grid : Grid
        The surface.
    core : (int, int, int, int)
        First and past-the-last row, first and past-the-last column of the cells wanted.
    level : float
        A height near the surface [m].
    extinction : float
        Of the air [1/m].
    terms : (bool, bool)
        Whether range, and whether incidence is allowed for.
    fixed : float
        Steps of ``silent`` per photo-electron and reflectance.
    silent : (rows, cols) int64
        Sum over silent beamlets, fixed point; added to.
    fired : (rows, cols) int64
        Beamlets of each cell; added to.
    seen_cell : (s,) int64
        Filled with the cell of each seen beamlet.
    seen_amount : (s,) float64
        Filled with its photo-electrons per reflectance.

    Returns
    -------
    int
        Number of seen beamlets; rows and columns of the outputs are those of ``core``.
    """
    sensor, lean, aim = np.empty(3), np.empty(2), np.empty(9)
    r0, r1, c0, c1 = core
    cols = np.int64(grid.height.shape[1])
    count = 0
    for s in range(len(top)):
        b = shots[0][s]
        _aim(blocks, b, shots[1][s], aim)
        sensor[:] = aim[:3]
        for c in range(top.shape[1]):
            constant = blocks.exposure[b, c]
            gx, gy = blocks.pattern[b, c, 0], blocks.pattern[b, c, 1]
            if constant <= 0.0 or np.isnan(gx):
                continue
            lean[0] = aim[3] + aim[5] * gx + aim[7] * gy
            lean[1] = aim[4] + aim[6] * gx + aim[8] * gy
            first = top[s, c]
            if first != SILENT:
                cell = first & np.int64(CELL_BITS)
                row, col = int(cell // cols), int(cell % cols)
            else:
                row, col = trace(grid, sensor, lean, level)
            if row < r0 or row >= r1 or col < c0 or col >= c1:
                continue
            z = (first >> np.int64(32)) * QUANTUM_M if first != SILENT else grid.height[row, col]
            amount = exposure(grid, row, col, z, sensor, lean, constant, extinction, terms)
            fired[row - r0, col - c0] += 1
            if first != SILENT:
                seen_cell[count] = (row - r0) * (c1 - c0) + col - c0
                seen_amount[count] = amount
                count += 1
            else:
                silent[row - r0, col - c0] += np.int64(np.rint(amount * fixed))
    return count
