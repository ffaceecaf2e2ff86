"""The simple morphological filter's grid steps."""

import numpy as np

from spl_batch.airborne.ground.smrf import fill_gaps, provisional_terrain
from tests.airborne.ground.clouds import ground_of, places, table


def test_returns_far_below_a_slope_pull_no_terrain_down() -> None:
    x, y = places(8000, 40)
    z = 0.5 * x
    low = np.hypot(x - 22, y - 22) < 0.8
    found = ground_of(table(x, y, z - 30.0 * low), "smrf")
    assert low.sum() > 5
    assert np.array_equal(found, ~low)


def test_gaps_are_filled_linearly() -> None:
    plane = np.add.outer(0.3 * np.arange(20), -0.2 * np.arange(30))
    holed = plane.copy()
    holed[5:12, 8:20] = np.nan
    np.testing.assert_allclose(fill_gaps(holed), plane, atol=1e-5)


def test_gaps_at_the_edge_take_the_nearest_height() -> None:
    grid = np.full((4, 6), np.nan)
    grid[:, 0] = [1, 2, 3, 4]
    assert np.array_equal(fill_gaps(grid), np.repeat(grid[:, :1], 6, axis=1))


def test_terrain_under_a_roof() -> None:
    plane = np.add.outer(0.05 * np.arange(60), np.zeros(60))
    roofed = plane.copy()
    roofed[20:40, 20:40] += 6
    np.testing.assert_allclose(provisional_terrain(roofed, 1.0, 0.15, 18.0), plane, atol=1e-5)
