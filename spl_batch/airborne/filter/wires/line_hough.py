r"""Fullest straight tube through each point among nearly horizontal directions.

Every neighbour within the half-length L adds one to the directions that pass it closely: a Hough
transform of one point, over cells of azimuth and slope. A typical parabola, by which a conductor
hangs, is taken away first. A tube is a window of (2 w + 1)^2 cells, w = 1 in the outer half of its
length, 3 in the next quarter and 7 within: on average as wide as stated. Four cells of 16 bits
share a word, and are added two to a row.

====== ==========================================================================
symbol name
====== ==========================================================================
L, l   ``length``, ``least``: half-length of a tube, nearest neighbour that counts [quanta]
r      ``radius``: half-width of a tube [quanta]; a cell is ``CELL`` r / L
K      ``count``: returns in the fullest tube, the point itself excluded
lambda ``expected``: background in one tube, its density times the volume of the windows.
       The density is the expected one, or that of the double cone of all directions
       without the tube, whichever is larger
====== ==========================================================================
"""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.lattice.lattice_columns import Columns, first_above, most_around
from spl_batch.numerics.compiled import njit
from spl_batch.numerics.neighbours.kdtree import U0, U1, U2, U3
from spl_batch.numerics.simd import UL, ascending, load, number, pack, spread

CELL: Final = 0.83
"""Edge of a cell of direction [r / L]: windows are 2 r wide, each weighted by its volume."""

TURNS, LEVELS = 400, 160
"""Most cells of azimuth and of slope [count]; longer tubes get coarser cells."""

PAD: Final = 8
"""Cells beyond the steepest slope at either side: more than the widest window reaches [count]."""

STRETCH: Final = np.uint64(256)
"""Cells that are looked through at once for a count [count]."""

WORDS: Final = (2 * PAD + 1) // 4 + 1
"""Words of four cells that the widest window may touch, whichever of them it begins in [count]."""

UW = np.uint64(WORDS)

Float = NDArray[np.float64]


@njit(inline="always")
def half_turn(x, y):  # type: ignore[no-untyped-def]
    """Azimuth of a direction without sense, in [0, pi], to 0.0016 rad.

    A polynomial (Rajan et al., "Efficient approximations for the arctangent function",
    IEEE Signal Processing Magazine 23, 2006): cells of direction are 15 times as wide.
    """
    ax, ay = abs(x), abs(y)
    t = min(ax, ay) / max(ax, ay)
    angle = t * (0.25 * math.pi + (1.0 - t) * (0.2447 + 0.0663 * t))
    if ay > ax:
        angle = 0.5 * math.pi - angle
    if (x < 0.0) != (y < 0.0):
        angle = math.pi - angle
    return angle


def grid(
    reach: Float, radius: float, slope_max: float
) -> tuple[Float, NDArray[np.int64], NDArray[np.int64]]:
    """Edge of a cell of direction [rad], cells of azimuth, and of slope without the rim.

    Of tubes of half-lengths ``reach`` and half-width ``radius`` [quanta].
    """
    most = max(math.pi / TURNS, 2.0 * slope_max / (LEVELS - 2 * PAD - 1))
    turns = (math.pi / np.maximum(CELL * radius / reach, most)).astype(np.int64)
    step = math.pi / turns
    return step, turns, (2.0 * slope_max / step).astype(np.int64) + 1


def tube_volume(reach: Float, least: float, step: Float) -> Float:
    """Volume of all windows along one direction [quanta3]."""
    volume, far = np.zeros(len(reach)), reach
    for half, part in ((1.5, 0.5), (3.5, 0.5), (7.5, 0.0)):
        near = np.maximum(least, part * far)
        length3 = np.maximum(far * far * far - near * near * near, 0.0)
        volume += 8.0 / 3.0 * (half * step) ** 2 * length3
        far = near
    return volume


@njit()
def _middle(cells, most, turns, rows, lanes):  # type: ignore[no-untyped-def]
    """Centre of the first cell with the largest count and of its equals beside it [cells]."""
    # Stretches without one are passed in vectors.
    begin, there = U0, np.uint16(0)
    while there == 0:
        for i in range(begin, min(begin + STRETCH, np.uint64(turns * lanes))):
            there += np.uint16(cells[i] == most)
        begin += STRETCH
    first = np.int64(begin - STRETCH)
    while cells[first] != most:
        first += 1
    a, b = first // lanes, first % lanes
    total_a = total_b = equal = 0
    for i in range(a, min(a + 3, turns)):
        for j in range(max(b - 2, 0), min(b + 3, rows)):
            if cells[i * lanes + j] == most:
                total_a += i
                total_b += j
                equal += 1
    return total_a / equal + 0.5, total_b / equal + 0.5


def _masks() -> NDArray[np.uint64]:
    """Ones in the lanes of a window, by its size and first lane, over as many words."""
    masks = np.zeros((3, 4, WORDS), np.uint64)
    for size, first in np.ndindex(3, 4):
        for lane in range(first, first + 2 * (2 << size) - 1):
            masks[size, first, lane >> 2] |= np.uint64(1) << np.uint64(16 * (lane & 3))
    return masks


_MASKS = _masks()


@njit(error_model="numpy")
def _directions(dx, dy, flat, rise, near, reach, step, slope_max, turns, levels, turn, level, size):  # type: ignore[no-untyped-def]
    """Cells of azimuth and slope, and size of the window, of every neighbour."""
    scale = 1.0 / step
    outer, inner = 0.25 * reach * reach, 0.0625 * reach * reach
    for k in range(near):
        up = rise[k] / math.sqrt(flat[k])
        up = -up if dy[k] < 0.0 else up
        turn[k] = min(np.int32(half_turn(dx[k], dy[k]) * scale), turns - 1)
        level[k] = min(np.int32((up + slope_max) * scale), levels - 1)
        size[k] = np.int32(flat[k] < outer) + np.int32(flat[k] < inner)


@njit()
def _vote(words, cells, turn, level, size, near, turns, levels, stride):  # type: ignore[no-untyped-def]
    """Add every neighbour to the directions that pass it, four cells to a word: largest count."""
    masks = _MASKS
    for k in range(near):
        half = (2 << size[k]) - 1
        a, b = turn[k], level[k]
        left = b - half + PAD
        if size[k] == 0 and 0 < a < turns - 1:
            # Seven neighbours of eight, written out for the compiler's sake.
            at, lane = np.uint64((a - 1) * stride + (left >> 2)), np.uint64(left & 3)
            low, high = masks[U0, lane, U0], masks[U0, lane, U1]
            for _ in range(3):
                words[at] += low
                words[at + U1] += high
                at += np.uint64(stride)
            continue
        wide = np.uint64(size[k])
        for i in range(a - half, a + half + 1):
            row, left = i, b - half + PAD
            if i < 0 or i >= turns:
                row = i + turns if i < 0 else i - turns
                left = levels - 1 - b - half + PAD
            at, lane = np.uint64(row * stride + (left >> 2)), np.uint64(left & 3)
            # As many words as it may touch: what is added to the others is 0.
            for j in range(U3):
                words[at + j] += masks[wide, lane, j]
            if wide > U1:
                for j in range(U3, UW):
                    words[at + j] += masks[wide, lane, j]
    most = np.uint16(0)
    for i in range(4 * turns * stride):
        most = max(most, cells[i])
    return np.int64(most)


@njit()
def _cone(  # type: ignore[no-untyped-def]
    points, low, high, x, y, z, bend, steep, outer, inner, near, dx, dy, flat, rise
):
    """Add the offsets, less the parabola, of a stretch's points in the double cone of a place.

    Four of ten are. Returns how many there are then.
    """
    for slot in range(low, high, UL):
        across, along = load(points, (U0, slot)) - spread(x), load(points, (U1, slot)) - spread(y)
        apart = across * across + along * along
        up = load(points, (U2, slot)) - spread(z) - spread(bend) * apart
        taken = (up * up <= spread(steep) * apart) & (apart <= spread(outer))
        taken = taken & (apart >= spread(inner)) & (ascending(slot) < spread(high))
        pack(dx, near, across, taken)
        pack(dy, near, along, taken)
        pack(flat, near, apart, taken)
        pack(rise, near, up, taken)
        near += number(taken)
    return near


def fullest(
    made: Columns, seed: NDArray[np.int32], length: Float, density: Float, largest: Float,
    radius: float, least: float, slope_max: float, bend: float, count: NDArray[np.int32],
    azimuth: Float, slope: Float, expected: Float,
) -> None:  # fmt: skip
    """Fullest tube of every seed, column by column, each column from below.

    ``seed`` (n,) has the number of the seed by row, negative for points that are none; ``length``
    and ``density`` its half-length [quanta] and background [1/quanta3]; ``largest`` the largest
    lambda at which so many returns make a tube worth keeping. ``count``, 0 where it is not,
    ``azimuth``, ``slope`` and ``expected`` are filled, (m,) by seed.
    """
    longest = float(length.max(initial=0.0))
    span = int(longest / made.edge) + 1
    cells = grid(length, radius, slope_max)
    volume = tube_volume(length, least, cells[0])
    _fullest(
        made, seed, length, density, largest, cells, volume, least, slope_max, bend, longest, span,
        most_around(made, span), count, azimuth, slope, expected,
    )  # fmt: skip


@njit()
def _fullest(  # type: ignore[no-untyped-def]  # noqa: C901, PLR0912, PLR0915
    made, seed, length, density, largest, grids, volume, least, slope_max, bend, longest, span,
    room, count, azimuth, slope, expected,
):  # fmt: skip
    """:func:`fullest`, given :func:`grid` and volumes of the tubes.

    ``longest``: of their half-lengths; ``span``: columns that it reaches; ``room``: most points in
    these [count].
    """
    points, start, edge, corner = made.points, made.start, made.edge, made.corner
    nx, ny = made.shape
    steep = slope_max * slope_max
    # Neighbour columns: their slots between floor and stop in the window, their lower corners.
    first = np.empty((2 * span + 1) ** 2, np.int64)
    last, floor, stop = np.empty_like(first), np.empty_like(first), np.empty_like(first)
    place = np.empty((2, len(first)))
    # Arrays that stay as they are: numba counts references to each view.
    dx, dy, flat, rise = (
        np.empty(room + 8),
        np.empty(room + 8),
        np.empty(room + 8),
        np.empty(room + 8),
    )
    turn, level = np.empty(room, np.int32), np.empty(room, np.int32)
    size = np.empty(room, np.int32)
    words = np.zeros((TURNS + 1) * (LEVELS // 4 + 1), np.uint64)
    cells = words.view(np.uint16)
    for a in range(nx):
        for b in range(ny):
            own = a * ny + b
            if start[own] == start[own + 1]:
                continue
            beside = -1
            for slot in range(start[own], start[own + 1]):
                at = seed[points[3, slot]]
                if at < 0:
                    continue
                if beside < 0:
                    beside = 0
                    for i in range(max(a - span, 0), min(a + span + 1, nx)):
                        for j in range(max(b - span, 0), min(b + span + 1, ny)):
                            gap = math.hypot(max(abs(i - a) - 1, 0), max(abs(j - b) - 1, 0))
                            column = i * ny + j
                            if gap * edge >= longest or start[column] == start[column + 1]:
                                continue
                            floor[beside], stop[beside] = start[column], start[column + 1]
                            first[beside] = first_above(
                                points, start[column], stop[beside], points[2, slot]
                            )
                            last[beside] = first[beside]
                            place[0, beside] = corner[0] + i * edge
                            place[1, beside] = corner[1] + j * edge
                            beside += 1
                x, y, z = points[0, slot], points[1, slot], points[2, slot]
                reach = length[at]
                outer, inner = reach * reach, least * least
                near = U0
                for k in range(beside):
                    # The near and the far corner of the column bound what of it may count.
                    ahead, aside = place[0, k] - x, place[1, k] - y
                    gap_x, gap_y = max(ahead, -ahead - edge, 0.0), max(aside, -aside - edge, 0.0)
                    if gap_x * gap_x + gap_y * gap_y > outer:
                        continue
                    far_x, far_y = max(-ahead, ahead + edge), max(-aside, aside + edge)
                    far = min(far_x * far_x + far_y * far_y, outer)
                    depth = slope_max * math.sqrt(far) + 1.0
                    low, high, end = first[k], last[k], stop[k]
                    bottom, top = np.int64(z - depth), np.int64(z + depth + bend * far)
                    while low < end and points[2, low] < bottom:
                        low += 1
                    while low > floor[k] and points[2, low - 1] >= bottom:
                        low -= 1
                    high = max(low, high)
                    while high < end and points[2, high] <= top:
                        high += 1
                    while high > low and points[2, high - 1] > top:
                        high -= 1
                    first[k], last[k] = low, high
                    near = _cone(
                        points, np.uint64(low), np.uint64(high), np.float64(x), np.float64(y),
                        np.float64(z), bend, steep, outer, inner, near, dx, dy, flat, rise,
                    )  # fmt: skip
                step, turns, levels = grids[0][at], grids[1][at], grids[2][at]
                _directions(
                    dx, dy, flat, rise, near, reach, step, slope_max, turns, levels, turn, level,
                    size,
                )  # fmt: skip
                stride = (levels + 2 * PAD + 7) // 4
                for i in range(turns * stride):
                    words[i] = 0
                most = _vote(words, cells, turn, level, size, near, turns, levels, stride)
                cone = 4.0 / 3.0 * math.pi * slope_max * (reach**3 - least**3)
                crowd = max(density[at], max(np.int64(near) - most, 0) / cone)
                expected[at] = crowd * volume[at]
                if expected[at] > largest[min(most, len(largest) - 1)]:
                    continue
                count[at] = most
                around, up = _middle(cells, np.uint16(most), turns, levels + 2 * PAD, 4 * stride)
                azimuth[at] = around * step
                slope[at] = (up - PAD) * step - slope_max
