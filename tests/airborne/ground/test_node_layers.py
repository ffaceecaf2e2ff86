"""Layers that nodes are means of, and how thick ranges make them."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from spl_batch.airborne.ground.ground_methods import ground_mask
from spl_batch.airborne.ground.lowest_layers import _CROWDED, ENDS, SUPPORTED, lowest_layers
from spl_batch.airborne.ground.point_spacing import largest_of
from spl_batch.airborne.ground.scales import BLOCK_M
from spl_batch.airborne.settings import GroundSettings
from spl_batch.lattice.tables import PointTable
from spl_batch.numerics.cell_groups import group_by_cell
from tests.airborne.ground.clouds import places, table

THICK_M = 0.1503
"""No whole number of quanta, nor is its half [m]."""


def slow_layer(z: NDArray[np.float64], low: float, thinnest: float) -> NDArray[np.bool_]:
    """Points of the layer on a height, which ends or is thinner; then of that around its mean."""
    once = np.count_nonzero((z >= low) & (z <= low + THICK_M))
    twice = np.count_nonzero((z > low + THICK_M) & (z <= low + 2 * THICK_M))
    goes_on = len(z) >= _CROWDED and twice > ENDS * once
    thick_m = thinnest * THICK_M if goes_on else THICK_M
    held = (z >= low) & (z <= low + thick_m)
    middle = z[held].mean()
    found: NDArray[np.bool_] = np.abs(z - middle) <= thick_m / 2
    return found


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10_000), st.sampled_from([0.5, 1.0]))
def test_layers_that_go_on_are_thinner(seed: int, thinnest: float) -> None:
    rng = np.random.default_rng(seed)
    count = int(rng.integers(SUPPORTED, 30))
    x, y = rng.uniform(0, 0.99, (2, count))
    z = rng.normal(0, 0.03, count) + rng.choice([0, 1], count) * rng.uniform(0, 0.6, count)
    x, y, z = np.round([x, y, z], 3)
    nodes = lowest_layers(x, y, z, group_by_cell(x, y, 1.0), THICK_M, thinnest=thinnest)
    held = slow_layer(z, z.min(), thinnest)
    assert nodes.points[0] == slow_layer(z, z.min(), 1.0).sum()
    assert nodes.xyz[0, 2] == pytest.approx(z[held].mean(), abs=1e-9)
    assert nodes.doubtful[0] == (count >= _CROWDED and held.sum() < SUPPORTED)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10_000))
def test_largest_values_are_those_of_a_block_and_the_eight_around(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 30))
    x, y = rng.uniform(-60, 60, (2, n))
    values = rng.uniform(0, 1, n)
    found = largest_of(x, y, values, 0.4)
    row, column = (np.floor(v / BLOCK_M).astype(int) for v in (y, x))
    for i in range(n):
        near = (np.abs(row - row[i]) <= 1) & (np.abs(column - column[i]) <= 1)
        assert found.at(x[i : i + 1], y[i : i + 1])[0] == max(values[near].max(), 0.4)


@pytest.mark.parametrize("sigma_m", [0.02, 0.05, 0.12])
def test_bare_ground_is_as_thick_as_ranges_scatter(sigma_m: float) -> None:
    x, y = places(36_000, 40)
    z = 0.1 * x + np.random.default_rng(5).normal(0, sigma_m, len(x))
    points = table(x, y, z)
    told = np.full(len(x), sigma_m, np.float32)
    points = PointTable({**{axis: points[axis] for axis in "xyz"}, "range_sigma": told})
    found = ground_mask(points, np.ones(len(x), np.bool_), GroundSettings())
    assert found.mean() > 0.97
    assert np.mean(z[found] - 0.1 * x[found]) == pytest.approx(0.0, abs=0.2 * sigma_m)
