"""The trend of the ground against planes and a slow twin."""

import numpy as np
import pytest
from numpy.typing import NDArray

from spl_batch.airborne.ground.ground_trend import REACH_M, fit_trend, trend_at
from spl_batch.airborne.ground.scales import WIDE_M
from tests.airborne.ground.clouds import places

Float = NDArray[np.float64]


def slow_height(ground: Float, x: float, y: float) -> float:
    """Height at a lattice node, by weighted least squares with a damped slope."""
    dx, dy = ground[:, 0] - x, ground[:, 1] - y
    w = np.maximum(1 - (dx**2 + dy**2) / REACH_M**2, 0) ** 2
    centre = [np.average(v, weights=w) for v in (dx, dy, ground[:, 2])]
    off = np.column_stack([dx - centre[0], dy - centre[1]])
    normal = (off * w[:, None]).T @ off / w.sum() + 0.1 * np.eye(2)
    slope = np.linalg.solve(normal, off.T @ (w * (ground[:, 2] - centre[2])) / w.sum())
    return float(centre[2] - slope @ centre[:2])


def test_a_slope_is_its_own_trend() -> None:
    x, y = places(4000, 80)
    trend = fit_trend(np.column_stack([x, y, 1000 + 1.5 * x - 0.4 * y]), x, y)
    inner = (np.abs(x - 40) < 24) & (np.abs(y - 40) < 24)
    off = trend_at(trend, x, y) - (1000 + 1.5 * x - 0.4 * y)
    assert np.abs(off[inner]).max() < 0.05
    assert np.abs(off).max() < 0.3


def test_lattice_heights_agree_with_the_slow_twin() -> None:
    x, y = places(900, 60) + 5000
    ground = np.column_stack([x, y, 300 + 20 * np.sin(x / 15) + y / 3])
    trend = fit_trend(ground, x, y)
    for row in (2, 7, 12):
        for column in (0, 5, 14):
            at = (trend.left + column) * WIDE_M, (trend.bottom + row) * WIDE_M
            expected = slow_height(ground, *at)
            assert trend.height[row, column] == pytest.approx(expected, abs=1e-6)
            found = trend_at(trend, *(np.array([v]) for v in at))
            assert found[0] == pytest.approx(expected, abs=1e-6)


def test_what_lies_beyond_its_reach_does_not_count() -> None:
    """Two windows of a survey agree where both hold all ground within reach."""
    x, y = places(5000, 120)
    ground = np.column_stack([x, y, 30 * np.sin(x / 20) + y])
    part = x < 80
    whole, left = fit_trend(ground, x, y), fit_trend(ground[part], x[part], y[part])
    near = x < 80 - REACH_M - WIDE_M
    difference = trend_at(whole, x[near], y[near]) - trend_at(left, x[near], y[near])
    assert np.abs(difference).max() < 1e-9


def test_gaps_are_bridged() -> None:
    x, y = places(5000, 120)
    z = 0.5 * x
    known = np.hypot(x - 60, y - 60) > 40
    trend = fit_trend(np.column_stack([x, y, z])[known], x, y)
    assert np.abs(trend_at(trend, x, y) - z).max() < 0.5
    one = fit_trend(np.array([[3.0, 4.0, 7.0]]), x, y)
    np.testing.assert_allclose(one.height, 7.0)
