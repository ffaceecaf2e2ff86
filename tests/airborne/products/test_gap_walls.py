"""Ground beyond walls, against loops and on scenes that are known."""

import numpy as np

from spl_batch.airborne.products.gap_surface import (
    AROUND_CELLS,
    FULL_OF_NINE,
    STEEPER,
    WALL_CELLS,
    on_this_side,
    walls_of,
)

ROW, COLUMN = np.indices((50, 46)) + 0.5


def slow(height):
    """Cell by cell: the largest step within a 3 x 3, against the mean of those around."""
    step = np.full(height.shape, np.nan)
    for i, j in zip(*np.nonzero(~np.isnan(height)), strict=True):
        near = height[max(i - 1, 0) : i + 2, max(j - 1, 0) : j + 2]
        if np.count_nonzero(~np.isnan(near)) >= FULL_OF_NINE:
            step[i, j] = np.nanmax(near) - np.nanmin(near)
    walls, half = np.zeros(height.shape, bool), AROUND_CELLS // 2
    for i, j in zip(*np.nonzero(step > WALL_CELLS), strict=True):
        around = step[max(i - half, 0) : i + half + 1, max(j - half, 0) : j + half + 1]
        walls[i, j] = step[i, j] > STEEPER * np.nanmean(around)
    return walls


def test_walls_are_those_of_a_loop():
    rng = np.random.default_rng(1)
    height = 4.0 * (COLUMN > 20 + 0.3 * ROW) + 0.5 * ROW + rng.normal(0, 0.2, ROW.shape)
    height[rng.random(ROW.shape) < 0.2] = np.nan
    found = walls_of(height)
    np.testing.assert_array_equal(found, slow(height))
    assert found.sum() > 50


def test_a_gap_sees_its_own_side_of_a_wall():
    gaps = (np.abs(ROW - 25) < 6) & (np.abs(COLUMN - 20) < 6)
    height = np.where(gaps, np.nan, 4.0 * (COLUMN > 30))
    near = on_this_side(height, gaps, 12)
    assert near[25, 8:29].all()
    assert not near[25, 29:].any()
    # Without the wall it sees as far as it reaches.
    level = on_this_side(np.where(gaps, np.nan, 0.0), gaps, 12)
    assert level.all()
