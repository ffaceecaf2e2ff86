"""Different numbers are those that sorting finds."""

import numpy as np
import pytest

from spl_batch.lattice.row_order import ROOM, distinct


@pytest.mark.parametrize("dtype", [np.uint16, np.int32, np.int64])
@pytest.mark.parametrize("span", [1, 7, 30_000, 3 * ROOM])
@pytest.mark.parametrize("n", [0, 1, 1000])
def test_numbers_and_ranks_are_those_of_sorting(dtype, span, n):
    values = np.random.default_rng(span).integers(0, min(span, 60_000), n).astype(dtype)
    if dtype == np.int64:
        values = values * (span // 60_000 + 1) - 2**40
    found, rank = distinct(values)
    wanted = np.unique(values, return_inverse=True)
    np.testing.assert_array_equal(found, wanted[0])
    np.testing.assert_array_equal(rank, wanted[1])
    assert found.dtype == values.dtype
