"""Opening by octagons against scipy's by the footprint."""

import numpy as np
import pytest
from scipy import ndimage

from spl_batch.airborne.ground.morphology import object_cells, octagon, opening


def footprint(radius: int) -> np.ndarray:
    """Cells of the octagon, drawn directly."""
    square, diamond = octagon(radius)
    rows, columns = np.mgrid[-radius : radius + 1, -radius : radius + 1]
    beyond = np.maximum(np.abs(rows) - square, 0) + np.maximum(np.abs(columns) - square, 0)
    return beyond <= diamond


def by_scipy(surface: np.ndarray, radius: int) -> np.ndarray:
    """Opening by the footprint of a surface whose edges go on level."""
    padded = np.pad(surface, 4 * radius, mode="edge")
    inner = slice(4 * radius, -4 * radius)
    return ndimage.grey_opening(padded, footprint=footprint(radius))[inner, inner]


@pytest.mark.parametrize("radius", [1, 2, 3, 5, 8, 13])
def test_opening_agrees_with_scipy(radius: int) -> None:
    surface = np.random.default_rng(radius).normal(size=(60, 47)).astype(np.float32)
    assert np.array_equal(opening(surface, radius), by_scipy(surface, radius))


def test_octagon_is_nearly_a_disk() -> None:
    for radius in (5, 10, 18):
        assert footprint(radius).sum() == pytest.approx(np.pi * radius**2, rel=0.25)


@pytest.mark.parametrize("rough", [0.3, 0.6, 1.0])
@pytest.mark.parametrize(("cell_m", "step_m"), [(1.0, 1.2), (0.5, np.inf)])
def test_objects_fall_from_one_opening_to_the_next(
    rough: float, cell_m: float, step_m: float
) -> None:
    """An opening of an opening is that of the surface but where an edge cuts it."""
    surface = rough * np.random.default_rng(2).normal(size=(90, 150)).cumsum(axis=1)
    window_m = 10.7 * cell_m
    found = object_cells(surface, cell_m, 0.15, window_m, step_m=step_m)
    single = surface.astype(np.float32)
    opened = [single, *(by_scipy(single, radius) for radius in range(1, 12))]
    falls = np.minimum(0.15 * cell_m * np.arange(1, 12), step_m).astype(np.float32)
    expected = (-np.diff(opened, axis=0) > falls[:, None, None]).any(axis=0)
    assert 0.1 < expected.mean() < 0.95
    assert np.array_equal(found[22:-22, 22:-22], expected[22:-22, 22:-22])


def test_a_long_hall_that_an_edge_cuts_is_cut_off_and_a_slope_is_not() -> None:
    """Longer than the window: each opening rounds off its corners, and continues what is left."""
    surface = np.zeros((200, 200))
    surface[:13, 40:170] = 7.0
    assert object_cells(surface, 1.0, 0.15, 40.0, step_m=2.0)[:13, 40:170].mean() > 0.99
    assert not object_cells(0.5 * np.indices((200, 200))[0], 1.0, 0.15, 40.0, step_m=2.0).any()
