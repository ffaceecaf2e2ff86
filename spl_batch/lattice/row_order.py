"""Order of rows by several keys, by sorting one packed integer for each; different numbers.

Sorting key after key moves every row once per key. Most rows already differ in the first keys:
these are packed into one 64-bit word, above the row's number, and words are sorted: all different,
which numpy does eight at a time. The few rows that are still equal are put in order by all keys.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

ROOM = 1 << 16
"""Numbers that span no more than this are counted, however few they are [count]."""

_WORD = 64
_PART = 1 << 14
_DIGIT = 16

_NEAR = 34
"""Floats whose bits differ in so many positions at most need no ranks: times within minutes do."""


def lexicographic_order(keys: Sequence[NDArray[Any]]) -> NDArray[np.intp]:
    """Indices that sort rows by several keys; equal rows keep their order.

    Parameters
    ----------
    keys : sequence of (n,) arrays
        At least one, the first one decides first. Integers or floats; the first floats
        after the first key end what is packed.

    Returns
    -------
    (n,) intp
        What ``numpy.lexsort`` gives for the reversed keys.
    """
    n = len(keys[0])
    row_bits = n.bit_length()
    packed, complete = _pack(keys, _WORD - row_bits)
    if packed is None:
        return np.lexsort(keys[::-1])
    if complete and packed.max(initial=0) < 1 << _DIGIT:
        # Numbers this short are put in order digit by digit, without comparing them.
        return np.argsort(packed.astype(np.uint16), kind="stable")
    # In place from here on: of millions of rows each copy is memory that a process needs.
    word = packed
    word <<= np.uint64(row_bits)
    word |= np.arange(n, dtype=np.uint64)
    word.sort()
    row = np.uint64((1 << row_bits) - 1)
    if complete:
        word &= row
        return word.view(np.intp)
    order = (word & row).view(np.intp)
    word >>= np.uint64(row_bits)
    tied = np.flatnonzero(word[1:] == word[:-1])
    if len(tied):
        equal = np.zeros(n, np.bool_)
        equal[tied] = equal[tied + 1] = True
        at = np.flatnonzero(equal)
        rows = order[at]
        order[at] = rows[np.lexsort([key[rows] for key in reversed(keys)])]
    return order


def distinct(values: NDArray[Any]) -> tuple[NDArray[Any], NDArray[np.intp]]:
    """Different numbers, rising, and which of them each value is.

    ``numpy.unique`` gives the same and sorts for it.

    Parameters
    ----------
    values : (n,) array of integers
        Any numbers.

    Returns
    -------
    found : (k,) array of the same type
        The different ones.
    rank : (n,) intp
        Which of them each value is.
    """
    low = int(values.min()) if len(values) else 0
    span = int(values.max()) - low + 1 if len(values) else 0
    if span > max(ROOM, len(values)):
        found, rank = np.unique(values, return_inverse=True)
        return found, rank
    offset = values.astype(np.int64) - low
    held = np.zeros(span, np.bool_)
    held[offset] = True
    numbers: NDArray[np.int64] = np.flatnonzero(held) + low
    return numbers.astype(values.dtype), (np.cumsum(held) - 1)[offset]


def in_order(keys: Sequence[NDArray[Any]]) -> bool:
    """Whether rows are in the order of their keys already; not if they cannot be compared.

    ``keys``: sequence of (n,) arrays, one at least; the first one decides first.
    """
    n = len(keys[0])
    # Rows in no order show it early.
    return all(_part_in_order([k[a : a + _PART + 1] for k in keys]) for a in range(0, n, _PART))


def _part_in_order(keys: Sequence[NDArray[Any]]) -> bool:
    tied = np.ones(max(len(keys[0]) - 1, 0), np.bool_)
    for key in keys:
        before, after = key[:-1], key[1:]
        same = before == after
        if np.any(tied & ~same & ~(before < after)):
            return False
        tied &= same
        if not tied.any():
            return True
    return True


def _pack(keys: Sequence[NDArray[Any]], room: int) -> tuple[NDArray[np.uint64] | None, bool]:
    """As many leading keys as fit into ``room`` bits, and whether these are all."""
    packed: NDArray[np.uint64] | None = None
    used = 0
    for number, key in enumerate(keys):
        if key.dtype.kind == "f" and number:
            return packed, False
        digits = _ranks(key) if key.dtype.kind == "f" else _offsets(key)
        width = int(digits.max(initial=0)).bit_length()
        if width > room - used:
            return packed, False
        used += width
        if packed is None:
            packed = digits
        else:
            packed <<= np.uint64(width)
            packed |= digits
    return packed, True


def _offsets(key: NDArray[Any]) -> NDArray[np.uint64]:
    """Distance of whole numbers from the smallest one: (n,) uint64, below 2**64 for any."""
    if not len(key):
        return np.empty(0, np.uint64)
    # Unsigned differences wrap around to the right distance.
    offset: NDArray[np.uint64] = key.astype(np.uint64)
    offset -= key.min().astype(np.uint64)
    return offset


def _ranks(key: NDArray[Any]) -> NDArray[np.uint64]:
    """Numbers in the order of floats, few and small: (n,) uint64; NaN is the largest.

    They are ranks among the different ones, or distances where these are short.
    """
    ranks = np.zeros(len(key), np.uint64)
    if np.all(key[1:] >= key[:-1]) and not np.isnan(key[:1]).any():
        np.cumsum(key[1:] != key[:-1], out=ranks[1:])
        return ranks
    if np.isfinite(key).all():
        near = _offsets(_ordered_bits(key))
        if near.max(initial=0) < 1 << _NEAR:
            return near
    ranks[:] = np.unique(key, return_inverse=True)[1]
    return ranks


def _ordered_bits(key: NDArray[Any]) -> NDArray[np.int64]:
    """Whole numbers in the order of some floats, none of them NaN: (n,) int64.

    The bits of positive ones are in that order already [IEEE 754]; -0.0 counts as 0.0.
    """
    bits = (key.astype(np.float64) + 0.0).view(np.int64)
    bits ^= (bits >> np.int64(63)) & np.int64(np.iinfo(np.int64).max)
    return bits
