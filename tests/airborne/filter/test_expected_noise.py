"""Noise expected at points: what lies far above or below costs no voxels."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from spl_batch.airborne.filter.expected_noise import noise_model
from spl_batch.airborne.settings import NoiseSettings
from spl_batch.lattice.tables import FIXED_POINT, VoxelPart
from spl_batch.lattice.tiles import quanta

SETTINGS = NoiseSettings()
EDGE = quanta(SETTINGS.voxel_m)
FIRST, LAYERS = 2, 6
"""Lowest layer of the share, and how many there are."""


class Tall(VoxelPart):
    """A share that claims many more layers than it has."""

    def layers(self) -> range:
        return range(-40, 60)


@pytest.fixture
def part() -> VoxelPart:
    rng = np.random.default_rng(3)
    amount = rng.uniform(0.5, 1.5, (8, 9, LAYERS)) * 200.0 * FIXED_POINT
    squares = rng.integers(1, 60, (8, 9, LAYERS, 16)).astype(np.uint16)
    return VoxelPart((0, 0, FIRST), amount.astype(np.int64), squares=squares)


def points(low: int, high: int) -> list[NDArray[np.int64]]:
    """Places in all voxels of the share and beside it, between two layers."""
    rng = np.random.default_rng(4)
    ends = ((-1, 9), (-1, 10), (low, high))
    return [rng.integers(a * EDGE, b * EDGE, 4000) for a, b in ends]


def asked(share: Any, xyz: list[NDArray[np.int64]]) -> tuple[tuple[int, ...], NDArray[np.float64]]:
    """Shape of the voxels that are held, and both densities at places."""
    model = noise_model(xyz, [[share]], 25, SETTINGS)
    assert model is not None
    return model.density.shape, np.array([model.local(xyz), model.mean(xyz)])


@pytest.mark.parametrize("layers", [(-20, 30), (FIRST, 4), (3, 30), (-20, 1), (11, 30)])
def test_layers_that_no_share_has_change_nothing(part: VoxelPart, layers: tuple[int, int]) -> None:
    xyz = points(*layers)
    shape, found = asked(part, xyz)
    whole, expected = asked(Tall(part.corner, part.amount, squares=part.squares), xyz)
    np.testing.assert_array_equal(found, expected)
    assert shape[2] <= min(LAYERS + 6, whole[2])
    assert expected.any() == (layers[0] < FIRST + LAYERS + 1 and layers[1] > FIRST - 1)


def test_a_stray_point_in_the_sky_costs_itself_alone(part: VoxelPart) -> None:
    xyz = points(FIRST, FIRST + LAYERS)
    shape, expected = asked(part, xyz)
    strays = [np.concatenate((axis, axis[:2])) for axis in xyz]
    strays[2][-2:] = [quanta(2e6), -quanta(2e6)]
    with_strays, found = asked(part, strays)
    np.testing.assert_array_equal(found[:, :-2], expected)
    assert not found[:, -2:].any()
    assert with_strays[2] <= shape[2] + 6
