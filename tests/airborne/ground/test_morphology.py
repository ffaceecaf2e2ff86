"""Opening by octagons against scipy's by the footprint."""

import numpy as np
import pytest
from scipy import ndimage

from spl_batch.airborne.ground.morphology import cut_off, dilate, erode, octagon, room_for


def footprint(radius: int) -> np.ndarray:
    """Cells of the octagon, drawn directly."""
    square, diamond = octagon(radius)
    rows, columns = np.mgrid[-radius : radius + 1, -radius : radius + 1]
    beyond = np.maximum(np.abs(rows) - square, 0) + np.maximum(np.abs(columns) - square, 0)
    return beyond <= diamond


def opening(surface: np.ndarray, radius: int) -> np.ndarray:
    """Grey opening by an octagon; edges are continued level."""
    opened, room, size = np.empty_like(surface), room_for(surface.shape, radius), octagon(radius)
    dilate(room, erode(surface, 2 * radius, *size, room), *size, opened)
    return opened


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


def one_after_the_other(surface: np.ndarray, falls: np.ndarray) -> np.ndarray:
    """Cells that fall by too much from any opening to the next."""
    found, last = np.zeros(surface.shape, np.bool_), surface.astype(np.float32)
    for radius, fall in enumerate(falls, start=1):
        opened = opening(last, radius)
        found |= last - opened > np.float32(fall)
        last = opened
    return found


@pytest.mark.parametrize("rough", [0.3, 0.6, 1.0])
def test_what_is_cut_off_falls_from_one_opening_to_the_next(rough: float) -> None:
    """Openings that are left out would have told nothing more but at edges."""
    surface = rough * np.random.default_rng(2).normal(size=(90, 150)).cumsum(axis=1)
    falls = np.minimum(0.15 * np.arange(1, 12), 1.2)
    asked = np.random.default_rng(3).random(surface.shape) < 0.9
    expected = one_after_the_other(surface, falls)
    assert 0.1 < expected.mean() < 0.95
    found = cut_off(surface, falls)
    assert np.array_equal(found[22:-22, 22:-22], expected[22:-22, 22:-22])
    assert np.mean(found != expected) < 4e-3
    assert np.array_equal(cut_off(surface, falls, asked), found & asked)


def test_falls_need_not_grow() -> None:
    surface = np.random.default_rng(2).normal(size=(31, 50)).cumsum(axis=1)
    falls = np.array([0.5, 0.9, 0.3, 0.7])
    expected = one_after_the_other(surface, falls)
    assert np.array_equal(cut_off(surface, falls)[8:-8, 8:-8], expected[8:-8, 8:-8])


def test_a_long_hall_that_an_edge_cuts_is_cut_off_and_a_slope_is_not() -> None:
    """Longer than the window: each opening rounds off its corners, and continues what is left."""
    surface = np.zeros((200, 200))
    surface[:13, 40:170] = 7.0
    falls = np.minimum(0.15 * np.arange(1, 41), 2.0)
    assert cut_off(surface, falls)[:13, 40:170].mean() > 0.99
    assert not cut_off(0.5 * np.indices((200, 200))[0], falls).any()
