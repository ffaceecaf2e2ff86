"""Sorting for kernels, beside numpy's."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from spl_batch.numerics.sorting import first_not_below, order_of, sort

NUMBERS = st.lists(st.integers(-9, 9) | st.integers(-(2**62), 2**62), max_size=60)


@given(NUMBERS)
def test_whole_numbers_are_sorted(numbers: list[int]) -> None:
    values = np.array(numbers, dtype=np.int64)
    sort(values)
    assert values.tolist() == sorted(numbers)


@given(NUMBERS)
def test_equal_values_stay_in_their_order(numbers: list[int]) -> None:
    values = np.array(numbers, dtype=np.float64)
    assert np.array_equal(order_of(values), np.argsort(values, kind="stable"))


@given(NUMBERS, st.integers(-10, 10))
def test_first_value_that_is_not_below(numbers: list[int], sought: int) -> None:
    values = np.sort(np.array(numbers, dtype=np.int64))
    assert first_not_below(values, sought) == np.searchsorted(values, sought)
