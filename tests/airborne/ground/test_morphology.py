"""Opening by octagons against scipy's by the footprint."""

import numpy as np
import pytest
from scipy import ndimage

from spl_batch.airborne.ground.morphology import cut_off, octagon, opening


def footprint(radius: int) -> np.ndarray:
    """Cells of the octagon, drawn directly."""
    square, diamond = octagon(radius)
    rows, columns = np.mgrid[-radius : radius + 1, -radius : radius + 1]
    beyond = np.maximum(np.abs(rows) - square, 0) + np.maximum(np.abs(columns) - square, 0)
    return beyond <= diamond


@pytest.mark.parametrize("radius", [1, 2, 3, 5, 8, 13])
def test_opening_agrees_with_scipy(radius: int) -> None:
    surface = np.random.default_rng(radius).normal(size=(60, 47)).astype(np.float32)
    padded = np.pad(surface, 4 * radius, mode="edge")
    expected = ndimage.grey_opening(padded, footprint=footprint(radius))
    inner = slice(4 * radius, -4 * radius)
    assert np.array_equal(opening(surface, radius), expected[inner, inner])


def test_octagon_is_nearly_a_disk() -> None:
    for radius in (5, 10, 18):
        assert footprint(radius).sum() == pytest.approx(np.pi * radius**2, rel=0.25)


def test_opening_by_nothing_changes_nothing() -> None:
    surface = np.random.default_rng(0).normal(size=(9, 9)).astype(np.float32)
    assert np.array_equal(opening(surface, 0), surface)


def test_opening_is_idempotent_and_below() -> None:
    surface = np.random.default_rng(4).normal(size=(50, 50)).astype(np.float32)
    once = opening(surface, 3)
    assert np.all(once <= surface)
    inner = slice(12, -12)
    assert np.array_equal(opening(once, 3)[inner, inner], once[inner, inner])


def test_what_is_cut_off_falls_from_one_opening_to_the_next() -> None:
    surface = np.random.default_rng(2).normal(size=(31, 50)).cumsum(axis=1)
    falls = np.array([0.5, 0.9, 0.3, 0.7])
    expected, last = np.zeros(surface.shape, np.bool_), surface.astype(np.float32)
    for radius, fall in enumerate(falls, start=1):
        opened = opening(last, radius)
        expected |= last - opened > np.float32(fall)
        last = opened
    assert 0.1 < expected.mean() < 0.9
    assert np.array_equal(cut_off(surface, falls), expected)
