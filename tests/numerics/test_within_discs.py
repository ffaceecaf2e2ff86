"""Cells within discs are those that scipy's distances tell."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from scipy.ndimage import distance_transform_edt

from spl_batch.numerics.within_discs import within_discs

MASKS = arrays.arrays(np.bool_, st.tuples(st.integers(0, 12), st.integers(0, 12)))
ROOTS = st.integers(0, 200).map(np.sqrt)


@given(MASKS, st.integers(0, 15) | st.floats(0, 15) | ROOTS)
def test_they_are_those_near_enough(held: np.ndarray, radius: float) -> None:
    expected = distance_transform_edt(~held) <= radius if held.any() else held
    assert np.array_equal(within_discs(held, float(radius)), expected)
