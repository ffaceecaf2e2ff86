"""Kernels that put returns into squares of a grid, and squares into rings of a swath.

A grid is told by the edge of its squares and by the column and row of its first one [quanta].
"""

import numpy as np

from spl_batch.numerics.compiled import njit


@njit(inline="always")
def _square(away, squares):  # type: ignore[no-untyped-def]
    """Square of a distance >= 0 [quanta]: in the middle of its quantum it is near no other one."""
    return np.int64((away + 0.5) * squares)


@njit()
def count_squares(x, y, west, south, edge, count):  # type: ignore[no-untyped-def]
    """Count returns by square; those beyond the grid are left out.

    Parameters
    ----------
    x, y : (n,) int64
        Returns [quanta].
    west, south, edge : int
        The grid.
    count : (rows, columns) int64
        Counts, which are added to.
    """
    rows, columns = count.shape
    low, left = south * edge, west * edge
    high, right, squares = low + rows * edge, left + columns * edge, 1.0 / edge
    for i in range(len(x)):
        if left <= x[i] < right and low <= y[i] < high:
            row, column = _square(y[i] - low, squares), _square(x[i] - left, squares)
            count[row, column] += 1


@njit()
def mark_squares(x, y, west, south, edge, out):  # type: ignore[no-untyped-def]
    """Mark squares that hold a return: (rows, columns) bool; else as :func:`count_squares`."""
    rows, columns = out.shape
    low, left = south * edge, west * edge
    high, right, squares = low + rows * edge, left + columns * edge, 1.0 / edge
    for i in range(len(x)):
        if left <= x[i] < right and low <= y[i] < high:
            row, column = _square(y[i] - low, squares), _square(x[i] - left, squares)
            out[row, column] = True


@njit()
def add_rings(ring, row, column, there, its_row, its_column, held, squares, total):  # type: ignore[no-untyped-def]
    """Add squares up by the ring of a swath that they lie in.

    Parameters
    ----------
    ring : (a, b) int64
        Ring at places of the swath; below 0 where it is not.
    row, column : (rows,), (columns,) int64
        Where in it the squares lie.
    there : (c, d) bool
        Which places count.
    its_row, its_column : (rows,), (columns,) int64
        Where in that the squares lie.
    held : (rows, columns) bool or int64
        What each square holds.
    squares, total : (rings,) int64
        Squares, and the sum of what they hold.
    """
    for i in range(len(row)):
        for j in range(len(column)):
            k = ring[row[i], column[j]]
            if k >= 0 and there[its_row[i], its_column[j]]:
                squares[k] += 1
                total[k] += held[i, j]
