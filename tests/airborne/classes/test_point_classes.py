"""What the classes of points are told by."""

import numpy as np
import pytest

from spl_batch.airborne.classes.point_classes import middle_m, middle_of_counts_m


@pytest.mark.parametrize("n", [0, 1, 2, 7, 1000])
def test_the_middle_of_counts_is_that_of_all_heights(n: int) -> None:
    z = np.random.default_rng(n).integers(-50, 50, n).astype(np.int32)
    parts = [np.unique(some, return_counts=True) for some in np.array_split(z, 3)]
    heights, counts = (np.concatenate(some) for some in zip(*parts, strict=True))
    assert middle_of_counts_m(heights, counts) == middle_m(z)
