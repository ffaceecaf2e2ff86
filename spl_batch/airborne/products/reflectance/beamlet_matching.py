"""Fired beamlets: where each was aimed, and which return of a cloud is the first of each."""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.constants import QUANTUM_M
from spl_batch.numerics.compiled import njit
from spl_batch.numerics.sorting import first_above

SILENT = -(1 << 63)
"""First return of a beamlet that has none. Others are a word: the height [quanta] in the upper
half, in the lower the number of the cell, ``row * cols + col``."""

CELL_BITS = 0xFFFF_FFFF
"""Lower half of a first return."""


AT_ONCE: Final = 1024
"""Returns that are matched before their beamlets are looked at [count]."""


class Blocks(NamedTuple):
    """Blocks of shots of several flightlines, by time of their first shot."""

    begin_s: NDArray[np.float64]  #: (m,): half a period before the first shot fired, ascending [s].
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
def _miss2(
    blocks: Blocks, b: np.int64, shot: np.int64, c: int, x: float, y: float, z: float,
    aim: NDArray[np.float64],
) -> float:  # fmt: skip
    """Squared horizontal distance at which a beamlet passes a point [m2]."""
    aim_at(blocks, b, (shot - blocks.middle[b]) / blocks.half[b], aim)
    gx, gy = blocks.pattern[b, c, 0], blocks.pattern[b, c, 1]
    dx = aim[0] + (aim[3] + aim[5] * gx + aim[7] * gy) * (z - aim[2]) - x
    dy = aim[1] + (aim[4] + aim[6] * gx + aim[8] * gy) * (z - aim[2]) - y
    return float(dx * dx + dy * dy)


@njit()
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

    Of several flightlines that were flown at the same time, the one takes a point whose beamlet
    passes nearest to it. ``place``: easting, northing, height; ``rows``: points in the grid that
    may be first; ``cells``: its south-west corner and edge of a cell [quanta], cells of a row;
    ``number``: row of each shot in ``top``, -1 for shots that do not matter; ``top`` (k, c), height
    and cell of each first return so far, :data:`SILENT` without: lifted where a return is higher.
    """
    highest, channels = top.reshape(-1), top.shape[1]
    aim = np.empty(9)
    west, south, size, cols = cells
    fires = ~np.isnan(blocks.pattern[:, :, 0])
    # Points lie by place and beamlets by time, each far from the last in memory: many are asked
    # for at once.
    where, words, held = np.empty(AT_ONCE, np.int64), np.empty(AT_ONCE, np.int64), 0
    for p in rows:
        c = int(channel[p])
        if c >= channels:
            continue
        east, north = place[0][p] - west, place[1][p] - south
        b = np.int64(first_above(blocks.begin_s, time_s[p]) - 1)
        best, least, taken = np.int64(-1), np.inf, np.int64(-1)
        while b >= 0 and blocks.begin_s[b] >= time_s[p] - longest_s:
            shot = np.int64(np.rint((time_s[p] - blocks.t0_s[b]) * blocks.prf_hz[b]))
            if blocks.first[b] <= shot <= blocks.last[b] and fires[b, c]:
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
            words[held] = (np.int64(place[2][p]) << np.int64(32)) | (row * cols + col)
            where[held] = best * channels + c
            held += 1
            if held == AT_ONCE:
                _raise(highest, where, words, held)
                held = 0
    _raise(highest, where, words, held)


@njit()
def _raise(
    highest: NDArray[np.int64], where: NDArray[np.int64], words: NDArray[np.int64], held: int
) -> None:
    """Lift values at some places to others; without a branch, so that none waits for another."""
    for k in range(np.uint64(held)):
        at = np.uint64(where[k])
        highest[at] = max(highest[at], words[k])
