"""Eight values at a time do what one at a time does."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numba import njit

from spl_batch.numerics import simd
from spl_batch.numerics.simd import (
    LANES,
    absolute,
    ascending,
    greater,
    greatest,
    least,
    lesser,
    load,
    middles,
    number,
    pack,
    root,
    spread,
    store,
    where,
)

U0, UL = np.uint64(0), np.uint64(LANES)
VALUES = st.lists(st.floats(), max_size=30)
EIGHT = st.lists(st.floats(), min_size=LANES, max_size=LANES)


@njit
def within(values, size, limit, kept, rows):  # type: ignore[no-untyped-def]
    """Values up to a limit, and which they are: how many."""
    count = U0
    for i in range(U0, np.uint64(size), UL):
        taken = (load(values, i) <= spread(limit)) & (ascending(i) < spread(np.uint64(size)))
        pack(kept, count, load(values, i), taken)
        pack(rows, count, ascending(i), taken)
        count += number(taken)
    return count


@settings(deadline=None)
@given(VALUES, st.floats())
def test_what_counts_is_packed_in_its_order(listed: list[float], limit: float) -> None:
    values = np.array([*listed, *np.zeros(LANES)])
    kept, rows = np.empty(len(values)), np.empty(len(values), np.uint64)
    count = within(values, len(listed), limit, kept, rows)
    expected = np.flatnonzero(np.array(listed) <= limit)
    np.testing.assert_array_equal(rows[:count], expected)
    np.testing.assert_array_equal(kept[:count], values[expected])


def test_lanes_are_packed_one_by_one_where_a_processor_cannot(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rng = np.random.default_rng(3)
    values = rng.random(40)
    for able in (False, True):
        monkeypatch.setattr(simd, "_compresses", lambda _, able=able: able)
        compiled = njit(within.py_func)
        kept, rows = np.empty(40), np.empty(40, np.uint64)
        count = compiled(values, 30, 0.4, kept, rows)
        np.testing.assert_array_equal(rows[:count], np.flatnonzero(values[:30] <= 0.4))
        np.testing.assert_array_equal(kept[:count], values[:30][values[:30] <= 0.4])


@njit
def reckon(a, b, out):  # type: ignore[no-untyped-def]
    """Each operation on floats, a row of eight each."""
    x, y = load(a, U0), load(b, U0)
    store(out, (np.uint64(0), U0), x + y)
    store(out, (np.uint64(1), U0), x - y)
    store(out, (np.uint64(2), U0), x * y)
    store(out, (np.uint64(3), U0), root(x))
    store(out, (np.uint64(4), U0), greater(x, y))
    store(out, (np.uint64(5), U0), lesser(x, y))
    store(out, (np.uint64(6), U0), spread(greatest(x)))
    store(out, (np.uint64(7), U0), spread(least(x)))
    store(out, (np.uint64(8), U0), x / y)
    store(out, (np.uint64(9), U0), absolute(x))


@settings(deadline=None)
@given(EIGHT, EIGHT)
def test_floats_are_reckoned_as_one_by_one(a: list[float], b: list[float]) -> None:
    x, y, out = np.array(a), np.array(b), np.empty((10, LANES))
    reckon(x, y, out)
    with np.errstate(all="ignore"):
        for found, expected in zip(
            out, (x + y, x - y, x * y, np.sqrt(x), np.where(x > y, x, y), np.where(x < y, x, y)),
            strict=False,
        ):  # fmt: skip
            np.testing.assert_array_equal(found, expected)
        np.testing.assert_array_equal(out[8:], [x / y, np.abs(x)])
    if not np.isnan(x).any():
        assert (out[6, 0], out[7, 0]) == (x.max(), x.min())


@njit
def choose(a, b, out):  # type: ignore[no-untyped-def]
    """Each operation on whole numbers, a row of eight each."""
    x, y = load(a, U0), load(b, U0)
    store(out, (np.uint64(0), U0), greater(x, y))
    store(out, (np.uint64(1), U0), lesser(x, y))
    store(out, (np.uint64(2), U0), x & y)
    store(out, (np.uint64(3), U0), spread(greatest(x)))
    store(out, (np.uint64(4), U0), spread(least(x)))


@settings(deadline=None)
@given(*2 * [st.lists(st.integers(0, 2**64 - 1), min_size=LANES, max_size=LANES)])
def test_whole_numbers_are_chosen_as_one_by_one(a: list[int], b: list[int]) -> None:
    x, y = (np.array(some, np.uint64) for some in (a, b))
    out = np.empty((5, LANES), np.uint64)
    choose(x, y, out)
    ends = [np.full(LANES, value) for value in (x.max(), x.min())]
    expected = np.stack([np.maximum(x, y), np.minimum(x, y), x & y, *ends])
    np.testing.assert_array_equal(out, expected)


@njit
def compare(a, b, out):  # type: ignore[no-untyped-def]
    """Lanes in which each comparison holds: a row of ones and zeros each."""
    x, y = load(a, U0), load(b, U0)
    one, none = spread(1.0), spread(0.0)
    store(out, (np.uint64(0), U0), where(x < y, one, none))
    store(out, (np.uint64(1), U0), where(x <= y, one, none))
    store(out, (np.uint64(2), U0), where(x > y, one, none))
    store(out, (np.uint64(3), U0), where(x >= y, one, none))
    store(out, (np.uint64(4), U0), where(x == y, one, none))
    store(out, (np.uint64(5), U0), where(x != y, one, none))
    store(out, (np.uint64(6), U0), where((x < y) | (x > y), one, none))
    store(out, (np.uint64(7), U0), where((x <= y) & (x >= y), one, none))


@settings(deadline=None)
@given(EIGHT, EIGHT)
def test_nothing_compares_with_nan(a: list[float], b: list[float]) -> None:
    x, y, out = np.array(a), np.array(b), np.empty((8, LANES))
    compare(x, y, out)
    expected = (x < y, x <= y, x > y, x >= y, x == y, x != y, (x < y) | (x > y), x == y)
    np.testing.assert_array_equal(out, np.array(expected, np.float64))


def test_the_middle_of_what_is_compared_is_given_by_lane() -> None:
    # 0 and 1, then 2 and 3, then the greater of the former and the lesser of the latter.
    middle = middles([(0, 1), (2, 3), (1, 2)], 4)

    @njit
    def between(values, out):  # type: ignore[no-untyped-def]
        lower, upper = middle(values, U0)
        store(out, (np.uint64(0), U0), lower)
        store(out, (np.uint64(1), U0), upper)

    values, out = np.random.default_rng(7).random((4, LANES)), np.empty((2, LANES))
    between(values.reshape(-1), out)
    greater_, lesser_ = values[:2].max(axis=0), values[2:].min(axis=0)
    np.testing.assert_array_equal(out, np.sort([greater_, lesser_], axis=0))
