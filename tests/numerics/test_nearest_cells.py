"""Nearest cells that hold something, beside a search over all pairs of cells."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from spl_batch.numerics.nearest_cells import distances, nearest_cells

MASKS = arrays.arrays(np.bool_, st.tuples(st.integers(1, 9), st.integers(1, 9)))


def all_pairs(held: np.ndarray) -> np.ndarray:
    """Distance of each cell to the nearest that holds something; infinite where none does."""
    cells = np.stack(np.indices(held.shape), axis=-1)
    offsets = cells[:, :, None] - np.argwhere(held)
    return np.sqrt((offsets**2).sum(axis=-1)).min(axis=-1, initial=np.inf)


@given(MASKS)
def test_they_are_the_nearest_of_all(held: np.ndarray) -> None:
    expected = all_pairs(held)
    assert np.array_equal(distances(held), expected)
    if held.any():
        row, column = nearest_cells(held)
        assert held[row, column].all()
        own_row, own_column = np.indices(held.shape)
        assert np.array_equal(np.hypot(row - own_row, column - own_column), expected)
