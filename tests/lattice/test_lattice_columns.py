"""Columns of points beside sums over all pairs."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from spl_batch.lattice.lattice_columns import columns, most_around


@settings(deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 60), st.integers(0, 4))
def test_no_column_has_more_around_it_than_the_most(seed: int, n: int, span: int) -> None:
    xyz = np.random.default_rng(seed).integers(-40, 40, (n, 3)).astype(np.int32)
    made = columns(xyz, np.arange(n), (3, -5, 0), 10)
    cell = (xyz[:, :2] + np.array([3, -5])) // 10
    low, high = cell.min(axis=0), cell.max(axis=0)
    around = [
        (np.abs(cell - (i, j)).max(axis=1) <= span).sum()
        for i in range(low[0], high[0] + 1)
        for j in range(low[1], high[1] + 1)
    ]
    assert most_around(made, span) == max(around)


def test_nothing_is_around_no_points() -> None:
    assert most_around(columns(np.empty((0, 3), np.int32), np.arange(0), (0, 0, 0), 10)) == 0
