"""The ranging spread that ground is looked for with."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from spl_batch.airborne.ground.multiscale.ranging_layer import (
    QUARTER_M,
    SIGMA_M,
    STEEP,
    STEEP_SHARE,
    STEPS,
    evidence,
    off_planes,
    reckoned,
)
from spl_batch.airborne.ground.point_spacing import Blocks
from spl_batch.numerics.cell_groups import group_by_cell

Float = NDArray[np.float64]


def cloud(rng: np.random.Generator, sigma_m: float, overgrown: float) -> tuple[Float, Float, Float]:
    """Tilted ground of 24 returns per m2, a share of its cells under heath [m]."""
    x, y = rng.uniform(0, 60, (2, 24 * 60 * 60))
    z = 0.3 * x + rng.normal(0, sigma_m, len(x))
    heath = rng.random((60, 60)) < overgrown
    under = heath[y.astype(int), x.astype(int)]
    z[under] += rng.gamma(1.0, 0.2, int(under.sum()))
    return x, y, z


def told_by(places: tuple[Float, Float, Float], told_m: float) -> Float:
    """The same spread told for all points [m]."""
    return np.full(len(places[0]), told_m)


def middle(spread: Blocks) -> float:
    """Spread of a block that has others all around, in the cloud's middle [m]."""
    return float(spread.values[1, 1])


@pytest.mark.parametrize(
    ("sigma_m", "overgrown", "found"),
    [
        (0.05, 0.5, 0.05),
        (0.05, 0.85, 0.05),
        (0.035, 0.5, 0.035),
        (0.015, 0.5, SIGMA_M),
        (0.05, 0.98, SIGMA_M),
    ],
)
def test_bare_cells_tell_what_ranges_scatter(
    sigma_m: float, overgrown: float, found: float
) -> None:
    places = cloud(np.random.default_rng(1), sigma_m, overgrown)
    reckoned_m = {told: middle(reckoned(evidence(*places, told_by(places, told))))
                  for told in (0.0, 0.02, 0.05, 0.15)}  # fmt: skip
    assert reckoned_m[0.05] == pytest.approx(found, rel=0.12)
    assert reckoned_m[0.15] == 0.15
    assert reckoned_m[0.0] == reckoned_m[0.02] == SIGMA_M


def test_scatter_about_planes_is_that_of_least_squares_in_any_order() -> None:
    rng = np.random.default_rng(3)
    places = np.rint(1000 * np.column_stack([rng.uniform(3e5, 3e5 + 4, (2, 400)).T,
                                             rng.normal(700, 0.2, 400)])) / 1000  # fmt: skip
    found = {}
    for turn in (np.arange(400), rng.permutation(400)):
        x, y, z = places[turn].T.copy()
        cells = group_by_cell(x, y, 1.0)
        found[len(found)] = off_planes(x, y, z, cells, 20)
        for cell, square in enumerate(found[0]):
            of = cells.order[cells.start[cell] : cells.start[cell + 1]]
            design = np.column_stack([np.ones(len(of)), x[of] - 3e5, y[of] - 3e5])
            rest = z[of] - design @ np.linalg.lstsq(design, z[of], rcond=None)[0]
            expected = np.mean(rest**2) if len(of) >= 20 else np.inf
            assert square == pytest.approx(expected, rel=1e-6)
    assert np.array_equal(found[0], found[1])
    assert 0 < np.isinf(found[0]).sum() < len(found[0])


def test_overgrown_ground_that_is_steep_has_the_spread_that_is_told() -> None:
    x, y, z = cloud(np.random.default_rng(1), 0.05, 0.95)
    ridge = z + 1.2 * np.where(y > 24.0, y - 24.0, 0.0)
    assert middle(reckoned(evidence(x, y, z, told_by((x, y, z), 0.05)))) == SIGMA_M
    assert middle(reckoned(evidence(x, y, ridge, told_by((x, y, z), 0.05)))) == 0.05


def test_one_steep_block_of_nine_counts_in_part() -> None:
    x, y, z = cloud(np.random.default_rng(1), 0.05, 0.95)
    z[(x > 32.0) & (x < 40.0) & (y > 32.0) & (y < 40.0)] += 10.0
    found = reckoned(evidence(x, y, z, told_by((x, y, z), 0.05)))
    share = (1 / 9 - STEEP_SHARE[0]) / (STEEP_SHARE[1] - STEEP_SHARE[0])
    assert middle(found) == pytest.approx(SIGMA_M + share * (0.05 - SIGMA_M))
    assert found.at(np.array([-9, 0]), np.array([0, 0])).tolist() == [SIGMA_M, SIGMA_M]


def test_between_bare_and_overgrown_the_spread_goes_over_by_degrees() -> None:
    found = []
    for overgrown in np.linspace(0.8, 0.98, 15):
        places = cloud(np.random.default_rng(1), 0.05, float(overgrown))
        found.append(middle(reckoned(evidence(*places, told_by(places, 0.05)))))
    assert found[0] == pytest.approx(0.05, rel=0.05)
    assert found[-1] == SIGMA_M
    assert any(0.03 < value < 0.045 for value in found)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000))
def test_steep_blocks_are_counted_by_hand(seed: int) -> None:
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(-40.0, 40.0, (2, int(rng.integers(0, 200))))
    z = rng.uniform(0.0, 12.0, len(x))
    lowest: dict[tuple[int, int], dict[tuple[int, int], float]] = {}
    for e, n, u in zip(x, y, z, strict=True):
        square = int(e // QUARTER_M), int(n // QUARTER_M)
        block = lowest.setdefault((square[0] // 2, square[1] // 2), {})
        block[square] = min(block.get(square, np.inf), u)
    whole = [list(block.values()) for block in lowest.values() if len(block) == 4]
    steep = [block for block in whole if max(block) - min(block) > STEEP * QUARTER_M]
    if len(x):
        shown = evidence(x, y, z, np.zeros(len(x))).values
        assert shown[:, :, STEPS + 1 : STEPS + 3].sum(axis=(0, 1)).tolist() == [
            len(whole),
            len(steep),
        ]
