"""Points put into the order of a kd-tree, eight at a time.

Each node is divided at its middle slot along its widest axis, depth first. A point is two words,
x above y and z above its row, counted from the smallest: words compare as their upper halves, and
what goes to either side of a value is packed side by side (:mod:`~spl_batch.numerics.simd`).
"""

import math
import sys
from typing import Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.numerics.compiled import njit
from spl_batch.numerics.simd import (
    LANES,
    UL,
    ascending,
    greater,
    greatest,
    least,
    lesser,
    load,
    number,
    pack,
    spread,
    where,
)

FEW: Final = 12
"""Points up to which they are sorted in one by one [count]."""

SAMPLE: Final = 256
"""Most points from which a value to divide at is taken [count]."""

U0, U1, HALF = np.uint64(0), np.uint64(1), np.uint64(32)
LOW, FULL = np.uint64(0xFFFF_FFFF), np.uint64(0xFFFF_FFFF_FFFF_FFFF)

_HALVES: Final = (1, 0) if sys.byteorder == "little" else (0, 1)
"""Which of a word's two numbers of 32 bits is the upper one, and which the lower."""


def arrange(xyz: NDArray[np.int32], boxes: NDArray[np.int32], depth: int) -> NDArray[np.int32]:
    """Points, (n, 3) [quanta], n >= 1, in tree order: (4, n) int32, x, y, z and row of each slot.

    ``boxes``, (2**(depth + 1), 6), receives the smallest x, y, z and the largest of each node, from
    node 1 on; ``depth`` is the level of the leaves, none of which is empty. Whole vectors can be
    read from any slot.
    """
    n = len(xyz)
    words = np.empty((2, n + LANES), np.uint64)
    # The halves of the words, as x, y, z and row; what is above 2**31 wraps there and back.
    upper, lower = (words.view(np.int32)[:, half : 2 * n : 2] for half in _HALVES)
    halves = upper[0], lower[0], upper[1], lower[1]
    lowest = np.array([xyz[:, axis].min() for axis in range(3)])
    for axis in range(3):
        np.subtract(xyz[:, axis], lowest[axis], out=halves[axis])
    halves[3][:] = np.arange(n, dtype=np.int32)
    spare = np.empty_like(words)
    _divide_all(
        words[0], words[1], spare[0], spare[1], n, lowest.astype(np.int64), boxes, depth
    )  # fmt: skip
    # What comes next fits into the same memory.
    del spare
    flat = np.empty(4 * n + LANES, np.int32)
    flat[4 * n :] = 0
    points = flat[: 4 * n].reshape(4, n)
    for axis in range(3):
        np.add(halves[axis], lowest[axis], out=points[axis])
    points[3] = halves[3]
    return points


@njit()
def _number_at(xy, zr, slot, axis):  # type: ignore[no-untyped-def]
    """Coordinate of a slot along an axis, from the smallest."""
    if axis == 0:
        return xy[slot] >> HALF
    return xy[slot] & LOW if axis == 1 else zr[slot] >> HALF


@njit()
def _pivot(xy, zr, low, size, rank, axis, sample):  # type: ignore[no-untyped-def]
    """A value to divide slots at, so that the one of a rank is in the smaller part.

    It is taken from a sample, a bit farther than the rank where that is near an end
    [Floyd and Rivest, Communications of the ACM 18, 1975].
    """
    taken = min(9 + (size >> 7), SAMPLE)
    for i in range(taken):
        slot = low + np.uint64((2 * i + 1) * size // (2 * taken))
        value, at = _number_at(xy, zr, slot, axis), i
        while at > 0 and sample[at - 1] > value:
            sample[at] = sample[at - 1]
            at -= 1
        sample[at] = value
    share = rank / size
    margin = 2.0 * math.sqrt(share * (1.0 - share) / taken)
    if share < 0.3:
        share += margin
    elif share > 0.7:
        share -= margin
    return sample[min(max(np.int64(share * taken), 0), taken - 1)]


@njit()
def _divide(xy, zr, spare_xy, spare_zr, low, high, axis, most):  # type: ignore[no-untyped-def]
    """Put what is at most ``most`` along an axis first; where the others begin."""
    held = zr if axis == 2 else xy
    bits, limit = (LOW, most) if axis == 1 else (FULL, most << HALF | LOW)
    left, right, begin = low, U0, low
    while begin + UL <= high:
        first, second = load(xy, begin), load(zr, begin)
        value = load(held, begin) & spread(bits)
        below, above = value <= spread(limit), value > spread(limit)
        # What is read lies behind what has been written.
        pack(xy, left, first, below)
        pack(zr, left, second, below)
        pack(spare_xy, right, first, above)
        pack(spare_zr, right, second, above)
        kept = number(below)
        left += kept
        right += UL - kept
        begin += UL
    for slot in range(begin, high):
        first, second = xy[slot], zr[slot]
        if held[slot] & bits <= limit:
            xy[left], zr[left] = first, second
            left += U1
        else:
            spare_xy[right], spare_zr[right] = first, second
            right += U1
    for i in range(right):
        xy[left + i], zr[left + i] = spare_xy[i], spare_zr[i]
    return left


@njit()
def _select(xy, zr, spare_xy, spare_zr, low, high, middle, axis, sample):  # type: ignore[no-untyped-def]
    """Divide slots so that none before ``middle`` is larger along an axis than one after it."""
    while high - low > np.uint64(FEW):
        size, rank = np.int64(high - low), np.int64(middle - low)
        most = _pivot(xy, zr, low, size, rank, axis, sample)
        cut = _divide(xy, zr, spare_xy, spare_zr, low, high, axis, most)
        if cut == high:
            # It is the largest: all that are equal to it go behind the others.
            if most == U0:
                return
            cut = _divide(xy, zr, spare_xy, spare_zr, low, high, axis, most - U1)
            if cut <= middle:
                return
        if cut == middle:
            return
        if cut > middle:
            high = cut
        else:
            low = cut
    for slot in range(low + U1, high):
        value, first, second = _number_at(xy, zr, slot, axis), xy[slot], zr[slot]
        at = np.uint64(slot)
        while at > low and _number_at(xy, zr, at - U1, axis) > value:
            xy[at], zr[at] = xy[at - U1], zr[at - U1]
            at -= U1
        xy[at], zr[at] = first, second


@njit()
def _divide_all(xy, zr, spare_xy, spare_zr, n, lowest, boxes, depth):  # type: ignore[no-untyped-def]
    """Split every node at its middle slot along its widest axis, depth first."""
    stack, sample = np.empty(64, dtype=np.int64), np.empty(SAMPLE, dtype=np.uint64)
    box, none, full = np.empty(6, np.int64), spread(U0), spread(FULL)
    stack[0] = 1
    top = 1
    while top > 0:
        top -= 1
        node = stack[top]
        level = 0
        while (node >> level) > 1:
            level += 1
        j = node - (1 << level)
        low, high = np.uint64((j * n) >> level), np.uint64(((j + 1) * n) >> level)
        x0, y0, z0, x1, y1, z1 = full, full, full, none, none, none
        for slot in range(low, high, UL):
            inside = ascending(slot) < spread(high)
            first, second = load(xy, slot), load(zr, slot)
            smallest, largest = where(inside, first, full), where(inside, first, none)
            x0, x1 = lesser(x0, smallest), greater(x1, largest)
            y0, y1 = lesser(y0, smallest & spread(LOW)), greater(y1, largest & spread(LOW))
            z0 = lesser(z0, where(inside, second, full))
            z1 = greater(z1, where(inside, second, none))
        box[0], box[1], box[2] = least(x0) >> HALF, least(y0), least(z0) >> HALF
        box[3], box[4], box[5] = greatest(x1) >> HALF, greatest(y1), greatest(z1) >> HALF
        axis, width = 0, np.int64(-1)
        for a in range(3):
            boxes[node, a], boxes[node, a + 3] = box[a] + lowest[a], box[a + 3] + lowest[a]
            if box[a + 3] - box[a] > width:
                axis, width = a, box[a + 3] - box[a]
        if level == depth:
            continue
        if width > 0:
            middle = np.uint64(((2 * j + 1) * n) >> (level + 1))
            _select(xy, zr, spare_xy, spare_zr, low, high, middle, axis, sample)
        stack[top] = 2 * node + 1
        stack[top + 1] = 2 * node
        top += 2
