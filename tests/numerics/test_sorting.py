"""Sorting for kernels, beside numpy's."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from spl_batch.numerics.sorting import first_above, sort

NUMBERS = st.lists(st.integers(-9, 9) | st.integers(-(2**62), 2**62), max_size=60)


@given(NUMBERS)
def test_whole_numbers_are_sorted(numbers: list[int]) -> None:
    values = np.array(numbers, dtype=np.int64)
    sort(values)
    assert values.tolist() == sorted(numbers)


@given(NUMBERS, st.integers(-10, 10))
def test_first_value_above(numbers: list[int], sought: int) -> None:
    values = np.sort(np.array(numbers, dtype=np.int64))
    assert first_above(values, sought) == np.searchsorted(values, sought, side="right")
