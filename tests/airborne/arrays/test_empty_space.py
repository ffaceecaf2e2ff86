"""Noise density of a cloud by its own empty space."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from spl_batch.airborne.arrays.empty_space import empty_space

EDGE_M = 90.0
GATE_M = (-60.0, 140.0)
VOLUME_M3 = EDGE_M**2 * (GATE_M[1] - GATE_M[0])

Float = NDArray[np.float64]


def noise(rng: np.random.Generator, per_m3: float, edge_m: float = EDGE_M) -> Float:
    count = rng.poisson(per_m3 * VOLUME_M3 * (edge_m / EDGE_M) ** 2)
    return rng.uniform([0, 0, GATE_M[0]], [edge_m, edge_m, GATE_M[1]], (count, 3))


def terrain(rng: np.random.Generator, per_m2: float) -> Float:
    x, y = rng.uniform(0, EDGE_M, (2, round(per_m2 * EDGE_M**2)))
    return np.stack([x, y, 0.2 * x + 4 * np.sin(y / 15) + rng.normal(0, 0.05, len(x))], axis=1)


def crowns(rng: np.random.Generator, ground: Float, per_m2: float) -> Float:
    """Leaves in clumps, up to 25 m above half of the ground."""
    chosen = ground[(ground[:, 0] < EDGE_M / 2)]
    base = chosen[rng.integers(0, len(chosen), round(per_m2 * EDGE_M**2 / 40))]
    centres = base + np.c_[np.zeros((len(base), 2)), rng.uniform(2, 25, len(base))]
    leaves = np.repeat(centres, 40, axis=0)
    return leaves + rng.normal(0, 0.5, leaves.shape)


def measured(xyz: Float) -> tuple[Float, float, float]:
    return empty_space(*np.rint(1000 * xyz).astype(np.int64).T)


@given(st.integers(0, 2**31), st.sampled_from([0.002, 0.01, 0.05, 0.1]), st.floats(0.5, 20))
@settings(max_examples=12, deadline=None)
def test_it_is_the_density_of_the_noise_whatever_stands_there(
    seed: int, per_m3: float, per_m2: float
) -> None:
    rng = np.random.default_rng(seed)
    ground = terrain(rng, per_m2)
    cloud = np.vstack([ground, crowns(rng, ground, per_m2), noise(rng, per_m3)])
    density, volume_m3, share = measured(cloud)
    chance = 4 / np.sqrt(per_m3 * VOLUME_M3 / 9)  # of a square
    assert np.median(density) == pytest.approx(per_m3, rel=0.06 + chance)
    assert volume_m3 > 0.4 * VOLUME_M3
    assert share > 0.98


@given(st.integers(0, 2**31), st.floats(3, 20))
@settings(max_examples=8, deadline=None)
def test_a_forest_without_noise_tells_none(seed: int, per_m2: float) -> None:
    rng = np.random.default_rng(seed)
    ground = terrain(rng, per_m2)
    density, _, _ = measured(np.vstack([ground, crowns(rng, ground, 2 * per_m2)]))
    assert density.max() < 1e-3


def test_neither_order_nor_place_matters() -> None:
    rng = np.random.default_rng(2)
    cloud = np.vstack([terrain(rng, 5), noise(rng, 0.02)])
    density, *rest = measured(cloud)
    turn = rng.permutation(len(cloud))
    again, *same = measured(cloud[turn])
    np.testing.assert_array_equal(again, density[turn])
    assert same == rest
    # Moved by whole squares and layers, south of the equator.
    moved, *_ = measured(cloud + np.array([-6_000.0, -90_000.0, -35.0]))
    np.testing.assert_array_equal(moved, density)


@pytest.mark.parametrize("edge_m", [100.0, 240.0])
def test_slanting_beams_tell_no_less_at_the_rim(edge_m: float) -> None:
    rng = np.random.default_rng(5)
    cloud = noise(rng, 0.02, edge_m)
    cloud[:, 0] += 0.35 * cloud[:, 2]
    density, _, share = measured(cloud)
    assert density.min() > 0.5 * 0.02
    assert np.median(density) == pytest.approx(0.02, rel=0.35 if edge_m < 200 else 0.05)
    assert share > 0.9
