"""Fired beamlets: where they were aimed, which return is the first of each, where others ended."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.constants import QUANTUM_M
from spl_batch.lattice.tables import FIXED_POINT
from spl_batch.numerics.compiled import njit
from spl_batch.numerics.simd import TOGETHER
from spl_batch.numerics.sorting import first_above

SILENT = int(np.iinfo(np.int64).min)
"""First return of a beamlet that has none. Others are a word: the height [quanta] in the upper
half, in the lower the number of the cell, ``row * cols + col``."""

CELL_BITS = int(np.iinfo(np.uint32).max)
"""Lower half of a first return."""


class Blocks(NamedTuple):
    """Blocks of shots of several flightlines, by time of their first shot."""

    begin_s: NDArray[np.float64]  #: (m,): half a period before the first shot fired, ascending [s].
    line: NDArray[np.int64]  #: (m,): number of the flightline.
    #: (m,): clock of the shots.
    t0_s: NDArray[np.float64]
    prf_hz: NDArray[np.float64]
    #: (m,): first and last shot fired.
    first: NDArray[np.int64]
    last: NDArray[np.int64]
    #: (m,): a shot's time within its block is ``(shot - middle) / half``.
    middle: NDArray[np.float64]
    half: NDArray[np.float64]
    anchor: NDArray[np.float64]  #: (m, 3): relative to the grid's corner; z is a height [m].
    #: (m, TERMS, 2): where beamlets meet the reference plane, relative to the anchor [m].
    coefficient: NDArray[np.float64]
    origin: NDArray[np.float64]  #: (m, 2, 3): sensor relative to the anchor, and its motion [m].
    pattern: NDArray[np.float64]  #: (m, c, 2): place of each channel in the array.
    #: (m, c): photo-electrons per reflectance of each channel, times square of range [m2].
    exposure: NDArray[np.float64]
    offset: NDArray[np.int64]  #: (m,): number of the first shot among all shots.


@njit(inline="always")
def aim_at(blocks: Blocks, b: np.int64, tau: float, out: NDArray[np.float64]) -> None:
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


@njit()
def shots_near(
    blocks: Blocks,
    level: float,
    depth_m: float,
    box_m: tuple[float, float, float, float],
    number: NDArray[np.int64],
    block: NDArray[np.int64],
    tau: NDArray[np.float64],
) -> int:
    """Shots that can have a beamlet in a rectangle, in the order of all shots; how many.

    The surface is no farther than ``depth_m`` from ``level``, a height near it; ``box_m``: west,
    south, east and north edge, from the grid's corner [m]. Written: ``number``, place of each shot
    among those that are near, -1 for others; from the front ``block`` and ``tau`` of each that is.
    """
    west, south, east, north = box_m
    # Taken out of their tuple once: each look into it counts a reference up and down.
    first, last, middle, half = blocks.first, blocks.last, blocks.middle, blocks.half
    anchor, origin, path, offset = blocks.anchor, blocks.origin, blocks.coefficient, blocks.offset
    count = 0
    for b in range(len(first)):
        array = 0.0
        for k in range(4, path.shape[1]):
            array += abs(path[b, k, 0]) + abs(path[b, k, 1])
        for shot in range(first[b], last[b] + 1):
            t = (shot - middle[b]) / half[b]
            up = anchor[b, 2] - (anchor[b, 2] + origin[b, 0, 2] + t * origin[b, 1, 2])
            away, steep = -np.inf, 0.0
            for k in range(2):
                at = path[b, 0, k] + t * (path[b, 1, k] + t * (path[b, 2, k] + t * path[b, 3, k]))
                lean = (at - origin[b, 0, k] - t * origin[b, 1, k]) / up
                place = anchor[b, k] + at + lean * (level - anchor[b, 2])
                low, high = (west, east) if k == 0 else (south, north)
                away, steep = max(away, low - place, place - high), max(steep, abs(lean))
            here = offset[b] + shot - first[b]
            if away <= array + steep * depth_m:
                number[here], block[count], tau[count] = count, b, t
                count += 1
            else:
                number[here] = -1
    return count


@njit()
def match_points(
    time_s: NDArray[np.float64],
    channel: NDArray[np.uint8],
    line: NDArray[np.uint16],
    place: tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int32]],
    rows: NDArray[np.intp],
    cells: tuple[int, int, int, int],
    blocks: Blocks,
    number: NDArray[np.int64],
    top: NDArray[np.int64],
) -> None:
    """First return of each beamlet: the highest, for beams go down.

    ``time_s, channel, line``: of each point, the last of them the number of its flightline;
    ``place``: easting, northing, height; ``rows``: points in the grid that may be first; ``cells``:
    its south-west corner and edge of a cell [quanta], cells of a row; ``number``: row of each shot
    in ``top``, -1 for shots that do not matter; ``top`` (k, c), height and cell of each first
    return so far, :data:`SILENT` without: lifted where a return is higher.
    """
    highest, channels = top.reshape(-1), top.shape[1]
    west, south, size, cols = cells
    longest_s = 0.0
    for block in range(len(blocks.prf_hz)):
        shots = blocks.last[block] - blocks.first[block] + 1
        longest_s = max(longest_s, shots / blocks.prf_hz[block])
    # Points lie by place and beamlets by time, each far from the last in memory: many are asked
    # for at once.
    where, words = np.empty(TOGETHER, np.int64), np.empty(TOGETHER, np.int64)
    for begin in range(0, len(rows), TOGETHER):
        held = 0
        for p in rows[begin : begin + TOGETHER]:
            c = int(channel[p])
            if c >= channels:
                continue
            east, north = place[0][p] - west, place[1][p] - south
            b = np.int64(first_above(blocks.begin_s, time_s[p]) - 1)
            best = np.int64(-1)
            # Several flightlines may have been flown at the same time.
            while b >= 0 and blocks.begin_s[b] >= time_s[p] - longest_s:
                shot = np.int64(np.rint((time_s[p] - blocks.t0_s[b]) * blocks.prf_hz[b]))
                within = blocks.line[b] == line[p] and blocks.first[b] <= shot <= blocks.last[b]
                if within and not np.isnan(blocks.pattern[b, c, 0]):
                    best = number[blocks.offset[b] + shot - blocks.first[b]]
                    break
                b -= 1
            if best >= 0:
                # No quotient of whole numbers so small rounds up to the next whole one.
                row, col = np.int64(north / size), np.int64(east / size)
                # Of two as high, the cell decides and not their order.
                words[held] = (np.int64(place[2][p]) << np.int64(32)) | (row * cols + col)
                where[held] = best * channels + c
                held += 1
        # Without a branch, so that none waits for another.
        for k in range(np.uint64(held)):
            at = np.uint64(where[k])
            highest[at] = max(highest[at], words[k])


COARSE = 8
"""Cells along one side of the coarse squares that bound heights [count]. Half moves 6273 + 6380
cells of the intensity, twice 6764 + 6783 cells of the intensity."""

U_COARSE = np.uint64(COARSE)

STEP_CELLS = 0.5
"""Step of a ray over the ground [cells]. Half moves 3694 + 5622 cells of the intensity, twice 2713
+ 5368 cells of the intensity."""

COSINE_MIN = 0.2
"""Incidence is not corrected for beyond this [1]. Half moves 76 + 90 cells of the intensity, twice
187 + 206 cells of the intensity."""


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
        while True:
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
    silent: NDArray[np.int64],
    fired: NDArray[np.int64],
    seen_cell: NDArray[np.int64],
    seen_amount: NDArray[np.float64],
) -> int:
    """Share out every fired beamlet to the cell of its first return, or where it ended.

    ``shots``: block of each, and its time within that; ``top``: from :func:`match_points`;
    ``core``: first and past-the-last row, first and past-the-last column of the cells wanted, which
    the outputs have; ``level``: a height near the surface [m]. Added to: ``silent``, sum over
    silent beamlets in steps of :data:`FIXED_POINT`, and ``fired``, beamlets of each cell. Filled:
    cell and photo-electrons per reflectance of each seen beamlet, whose number is returned.
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
                silent[row - r0, col - c0] += np.int64(np.rint(amount * FIXED_POINT))
    return count
