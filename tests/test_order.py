"""Packed lexicographic order beside ``numpy.lexsort``."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from spl_batch.order import lexicographic_order

INTEGERS = (np.uint8, np.int32, np.int64, np.uint64)


@st.composite
def _keys(draw):
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    n = draw(st.integers(0, 60))
    keys = []
    for _ in range(draw(st.integers(1, 4))):
        if draw(st.booleans()):
            keys.append(rng.choice([-1.5, 0.0, -0.0, 2.0, np.nan], n))
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


@pytest.mark.parametrize("largest", [1 << 5, 1 << 30])
def test_rows_that_the_packed_keys_leave_equal_are_sorted_by_the_rest(largest):
    rng = np.random.default_rng(1)
    x = rng.integers(0, 4, 500)
    keys = [x, rng.integers(0, largest, 500) // (largest // 4), x * largest**2, rng.random(500)]
    assert np.array_equal(lexicographic_order(keys), np.lexsort(keys[::-1]))
