"""Squares and rings, against loops over numpy."""

import numpy as np

from spl_batch.airborne.pulses.square_kernels import add_rings, count_squares, mark_squares


def test_returns_are_put_into_the_squares_that_hold_them():
    rng = np.random.default_rng(1)
    x, y = rng.integers(-5_000, 5_000, (2, 3000))
    west, south, edge = -3, -2, 700
    count, held = np.zeros((6, 8), np.int64), np.zeros((6, 8), np.bool_)
    count_squares(x, y, west, south, edge, count)
    mark_squares(x[::9].copy(), y[::9].copy(), west, south, edge, held)
    for i, j in np.ndindex(count.shape):
        mine = (x // edge - west == j) & (y // edge - south == i)
        assert count[i, j] == mine.sum()
        assert held[i, j] == mine[::9].any()
    assert 0 < count.sum() < len(x)
    assert not held.all()


def test_squares_add_up_by_their_ring():
    rng = np.random.default_rng(2)
    ring, there = rng.integers(-1, 4, (20, 30)), rng.random((10, 15)) < 0.7
    row, column = np.arange(2, 18), np.arange(1, 29, 2)
    held = rng.integers(0, 5, (len(row), len(column)))
    squares, total = np.zeros((2, 4), np.int64)
    add_rings(ring, row, column, there, row // 2, column // 2, held, squares, total)
    of_squares = ring[np.ix_(row, column)]
    counts = there[np.ix_(row // 2, column // 2)]
    for k in range(4):
        assert squares[k] == np.count_nonzero(counts & (of_squares == k))
        assert total[k] == held[counts & (of_squares == k)].sum()
