"""Packed lexicographic order beside ``numpy.lexsort``."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from spl_batch.lattice.row_order import in_order, lexicographic_order

INTEGERS = (np.uint8, np.int32, np.int64, np.uint64)


@st.composite
def _keys(draw):
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    n = draw(st.integers(0, 60))
    keys = []
    for _ in range(draw(st.integers(1, 4))):
        if draw(st.booleans()):
            start = draw(st.sampled_from([-3e-320, -1.5, 0.0, 3e8]))
            near = start + np.spacing(start) * rng.integers(-9, 9, n)
            odd = rng.choice([-1.5, 0.0, -0.0, np.inf, np.nan], n)
            keys.append(near if draw(st.booleans()) else odd)
            continue
        info = np.iinfo(draw(st.sampled_from(INTEGERS)))
        few = rng.integers(max(info.min, -2), 3, n, dtype=info.dtype)
        wide = rng.integers(info.min, info.max, n, dtype=info.dtype, endpoint=True)
        keys.append(few if draw(st.booleans()) else wide)
    if draw(st.booleans()):
        keys[0] = np.sort(keys[0])
    return keys


@given(_keys())
def test_order_is_that_of_lexsort(keys):
    assert np.array_equal(lexicographic_order(keys), np.lexsort(keys[::-1]))


@given(_keys(), st.booleans())
def test_in_order_where_sorting_changes_nothing(keys, sort):
    if sort:
        keys = [key[np.lexsort(keys[::-1])] for key in keys]
    ordered = np.array_equal(np.lexsort(keys[::-1]), np.arange(len(keys[0])))
    if any(np.isnan(key).any() for key in keys):
        assert ordered or not in_order(keys)
    else:
        assert in_order(keys) == ordered


@pytest.mark.parametrize("largest", [1 << 5, 1 << 30])
def test_rows_that_the_packed_keys_leave_equal_are_sorted_by_the_rest(largest):
    rng = np.random.default_rng(1)
    x = rng.integers(0, 4, 500)
    keys = [x, rng.integers(0, largest, 500) // (largest // 4), x * largest**2, rng.random(500)]
    assert np.array_equal(lexicographic_order(keys), np.lexsort(keys[::-1]))
