"""The ranging spread that ground is looked for with."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from spl_batch.airborne.ground.multiscale.ranging_layer import (
    SHARED_M,
    SIGMA_M,
    STEEP,
    STEEP_SHARE,
    reckoned,
)
from spl_batch.airborne.ground.point_spacing import BLOCK_M, Blocks

Float = NDArray[np.float64]

EVEN_M = np.sqrt(0.08**2 - SHARED_M**2)
"""Spread that counts on even ground where 8 cm are stated [m]."""


def cloud(rise: float) -> tuple[Float, Float, Float]:
    """Tilted ground of 4 returns per m2 [m]."""
    x, y = np.random.default_rng(1).uniform(0, 60, (2, 4 * 60 * 60))
    return x, y, rise * x


def middle(spread: Blocks) -> float:
    """Spread of a block that has others all around, in the cloud's middle [m]."""
    return float(spread.values[1, 1])


@pytest.mark.parametrize(
    ("stated_m", "even_m"), [(0.0, SIGMA_M), (0.05, SIGMA_M), (0.08, 0.0673), (0.15, 0.1436)]
)
def test_what_neighbours_share_counts_on_steep_ground_alone(stated_m: float, even_m: float) -> None:
    for rise, expected in ((0.3, even_m), (0.9, max(stated_m, SIGMA_M))):
        x, y, z = cloud(rise)
        found = reckoned(x, y, z, np.full(len(x), stated_m))
        assert middle(found) == pytest.approx(expected, abs=1e-4)


def test_one_steep_block_of_nine_counts_in_part() -> None:
    x, y, z = cloud(0.0)
    z = np.where((x > 32.0) & (x < 40.0) & (y > 32.0) & (y < 40.0), 10.0, z)
    found = reckoned(x, y, z, np.full(len(x), 0.08))
    share = (1 / 9 - STEEP_SHARE[0]) / (STEEP_SHARE[1] - STEEP_SHARE[0])
    assert middle(found) == pytest.approx(EVEN_M + share * (0.08 - EVEN_M))
    assert found.at(np.array([-9, 0]), np.array([0, 0])) == pytest.approx(EVEN_M)


def test_the_largest_spread_that_is_stated_around_counts() -> None:
    x, y, z = cloud(0.0)
    stated_m = np.where((x > 50) & (y > 50), 0.12, 0.08)
    found = reckoned(x, y, z, stated_m).values
    larger_m = np.sqrt(0.12**2 - SHARED_M**2)
    expected = [[EVEN_M] * 4, [EVEN_M] * 4, *[[EVEN_M, EVEN_M, larger_m, larger_m]] * 2]
    np.testing.assert_allclose(found, expected)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000))
def test_steep_blocks_are_counted_by_hand(seed: int) -> None:
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(-40.0, 40.0, (2, int(rng.integers(1, 300))))
    z = rng.uniform(0.0, 12.0, len(x))
    lowest: dict[tuple[int, int], dict[tuple[int, int], float]] = {}
    for e, n, u in zip(x, y, z, strict=True):
        quarter = int(n // (BLOCK_M / 2)), int(e // (BLOCK_M / 2))
        block = lowest.setdefault((quarter[0] // 2, quarter[1] // 2), {})
        block[quarter] = min(block.get(quarter, np.inf), u)
    whole = {at: [*block.values()] for at, block in lowest.items() if len(block) == 4}
    steep = {at for at, low in whole.items() if max(low) - min(low) > STEEP * BLOCK_M / 2}
    found = reckoned(x, y, z, np.full(len(x), 0.08))
    for at in lowest:
        near = [k for k in whole if max(abs(k[0] - at[0]), abs(k[1] - at[1])) <= 1]
        share = sum(k in steep for k in near) / max(len(near), 1)
        counts = np.interp(share, STEEP_SHARE, [0.0, 1.0])
        value = found.values[at[0] - found.first[0], at[1] - found.first[1]]
        assert value == pytest.approx(EVEN_M + counts * (0.08 - EVEN_M))
