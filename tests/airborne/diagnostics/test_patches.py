"""Squares that hang together, largest first, each with the squares of its own box."""

import numpy as np

from spl_batch.airborne.diagnostics.patches import largest_of_squares, patches


def test_patches_lie_in_their_boxes_and_hold_every_square_once() -> None:
    marked = np.random.default_rng(3).random((60, 40)) < 0.2
    found, again = patches(marked), np.zeros(marked.shape, int)
    for one in found:
        west, south, east, north = one.box(0.0, 0.0, 1.0)
        assert one.marked.shape == (north - south, east - west)
        assert np.count_nonzero(one.marked) == one.squares
        again[one.at] += one.marked
    assert np.array_equal(again, marked)
    sizes = [one.squares for one in found]
    assert sizes == sorted(sizes, reverse=True)


def test_patches_touch_at_corners() -> None:
    area, box = largest_of_squares(np.array([[5, 7], [6, 8], [9, 9], [5, 7]]), 10.0)
    assert area == 300.0
    assert box == (50.0, 70.0, 70.0, 90.0)
