"""The nearest of some squared distances, by counting: nothing is sorted.

The distance of the last neighbour is found by counting how many are nearer than a guess, and
guessing better. Counts are loops without a branch, which the compiler turns into vector
instructions. Distances are whole numbers in float64 [quanta2].
"""

from typing import Final

import numpy as np

from spl_batch.numerics.compiled import njit
from spl_batch.numerics.neighbours.kdtree import U0, U3
from spl_batch.numerics.simd import (
    UL,
    ascending,
    greater,
    greatest,
    load,
    number,
    pack,
    spread,
    where,
)

GUESSES: Final = 6
"""Guesses by interpolation, before bisection, at the distance of the last neighbour [count]."""


@njit()
def largest(distance, size):  # type: ignore[no-untyped-def]
    """Largest of the first distances, none of which is negative; 0 of none."""
    most, none, end = spread(0.0), spread(0.0), np.uint64(size)
    for i in range(U0, end, UL):
        most = greater(where(ascending(i) < spread(end), load(distance, i), none), most)
    return greatest(most)


@njit(error_model="numpy")
def within_which(distance, size, wanted, spare, most):  # type: ignore[no-untyped-def]
    """Whole number not above ``most``, to which ``wanted`` to that + ``spare`` are; how many.

    With more ties than that it is the distance of number ``wanted``. There must be as many, none
    above ``most``; counts are taken for linear between the limits, as in a plane.
    """
    low, high = -1.0, most
    below, enough = np.int64(0), np.int64(size)
    step, end = 0, np.uint64(size)
    while enough > wanted + spare and high - low > 1.0:
        step += 1
        if step <= GUESSES:
            share = (wanted + 0.5 * spare - below) / (enough - below)
            guess = np.floor(low + share * (high - low))
            guess = min(max(guess, low + 1.0), high - 1.0)
        else:
            guess = np.floor(0.5 * (low + high))
        held = U0
        for i in range(U0, end, UL):
            held += number((load(distance, i) <= spread(guess)) & (ascending(i) < spread(end)))
        count = np.int64(held)
        if count >= wanted:
            high, enough = guess, count
        else:
            low, below = guess, count
    return high, enough


@njit()
def keep_nearest(points, near, kept, size, k, most):  # type: ignore[no-untyped-def]
    """Keep the k nearest, of those as far as the last the ones with the smallest rows.

    ``near`` and ``kept`` hold ``size`` > k squared distances, none above ``most``, and slots;
    returns k.
    """
    limit, enough = within_which(near, size, k, 0, most)
    surplus = enough - k
    while surplus > 0:
        worst, highest = U0, np.int64(-1)
        for i in range(size):
            row = np.int64(points[U3, kept[i]])
            if near[i] == limit and row > highest:
                worst, highest = np.uint64(i), row
        near[worst] = np.inf
        surplus -= 1
    found, end = U0, np.uint64(size)
    for i in range(U0, end, UL):
        distance, slots = load(near, i), load(kept, i)
        taken = (distance <= spread(limit)) & (ascending(i) < spread(end))
        pack(near, found, distance, taken)
        pack(kept, found, slots, taken)
        found += number(taken)
    return found


@njit()
def distance_to(near, size, wanted):  # type: ignore[no-untyped-def]
    """Squared distance to neighbour number ``wanted`` of ``size`` >= wanted."""
    limit, _ = within_which(near, size, wanted, 0, largest(near, size))
    last, none, end = spread(0.0), spread(0.0), np.uint64(size)
    for i in range(U0, end, UL):
        distance = load(near, i)
        held = (distance <= spread(limit)) & (ascending(i) < spread(end))
        last = greater(where(held, distance, none), last)
    return greatest(last)
