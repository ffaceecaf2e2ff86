"""Nearest cells that hold something, beside scipy's distance transform."""

import numpy as np
import pytest
from scipy import ndimage

from spl_batch.numerics.nearest_cells import distances, nearest_cells


@pytest.mark.parametrize("share", [0.01, 0.1, 0.5, 0.95, 1.0])
@pytest.mark.parametrize("shape", [(1, 1), (1, 40), (40, 1), (23, 57), (57, 23)])
def test_the_same_cells_as_scipy_finds(shape: tuple[int, int], share: float) -> None:
    held = np.random.default_rng(1).random(shape) < share
    held[shape[0] // 2, shape[1] // 3] = True
    expected = ndimage.distance_transform_edt(~held, return_distances=False, return_indices=True)
    assert np.array_equal(nearest_cells(held), expected)
    assert np.array_equal(distances(held), ndimage.distance_transform_edt(~held))
