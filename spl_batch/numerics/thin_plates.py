"""Smoothing thin plates: the surface that bends least while it passes near some points.

Source: Duchon 1977 (LNM 571); Wahba 1990, *Spline Models for Observational Data*, 2.4. Of all
surfaces f it has the least ``sum (z_i - f(x_i, y_i))**2 + c * bending energy``, and is

    f(x, y) = b_0 + b_1 x + b_2 y + sum a_i U(r_i),   U(r) = r**2 log r,

where ``(U + stiffness I) a + P b = z``, ``P' a = 0`` (P: rows of 1, x, y). The system is solved
here, by elimination with pivots, as a library's answer would depend on how many threads it takes.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.special import xlogy

from spl_batch.numerics.compiled import njit
from spl_batch.numerics.neighbours.kdtree import U0, U1

Values = NDArray[np.float64]


def fit_plate(points: Values, stiffness: float) -> Values | None:
    """Smoothing thin plate of some points.

    Parameters
    ----------
    points : (n, 3) float64
        x, y, z; distances of about one keep the numbers small.
    stiffness : float
        What is added to the diagonal [unit of x squared]; 0 passes through all points.

    Returns
    -------
    (n + 3,) float64 or None
        ``a`` and ``b`` of the module's equation; None for points on one line.
    """
    n = len(points)
    matrix, plate = np.zeros((n + 3, n + 3)), np.zeros(n + 3)
    matrix[:n, :n] = _bending(points, points[:, 0], points[:, 1])
    matrix[np.arange(n), np.arange(n)] = stiffness
    matrix[:n, n], matrix[:n, n + 1 :] = 1.0, points[:, :2]
    matrix[n:, :n] = matrix[:n, n:].T
    plate[:n] = points[:, 2]
    return plate if _solve(matrix, plate) else None


def plate_heights(points: Values, plate: Values, x: Values, y: Values) -> Values:
    """Heights of a plate of :func:`fit_plate` at the points x, y: (m,)."""
    n = len(points)
    heights: Values = plate[n] + plate[n + 1] * x + plate[n + 2] * y
    # One after the other: how numpy sums depends on how many points there are, and all bendings at
    # once would be held as often as there are points.
    for k in range(n):
        heights += plate[k] * _bending(points[k : k + 1], x, y)[0]
    return heights


def _bending(points: Values, x: Values, y: Values) -> Values:
    """``r**2 log r`` of the distances from points to x, y, 0 at 0: (n, m)."""
    distance2 = (x - points[:, :1]) ** 2 + (y - points[:, 1:2]) ** 2
    bending = xlogy(distance2, distance2)
    return np.asarray(0.5 * bending, np.float64)


@njit()
def _solve(matrix: Values, values: Values) -> bool:
    """Solve a square system in place, pivots by column; whether it can be solved.

    Indices are unsigned: a signed one costs numba a test for wrapping, and the compiler its vector
    instructions.
    """
    n, end = len(values), np.uint64(len(values))
    for k in range(U0, end):
        # The row with the largest value of the column, from the diagonal down, comes there.
        pivot = k
        for i in range(k + U1, end):
            if abs(matrix[i, k]) > abs(matrix[pivot, k]):
                pivot = i
        for j in range(k, end):
            matrix[k, j], matrix[pivot, j] = matrix[pivot, j], matrix[k, j]
        values[k], values[pivot] = values[pivot], values[k]
        if matrix[k, k] == 0.0:
            return False
        for i in range(k + U1, end):
            factor = matrix[i, k] / matrix[k, k]
            for j in range(k + U1, end):
                matrix[i, j] -= factor * matrix[k, j]
            values[i] -= factor * values[k]
    for k in range(n - 1, -1, -1):
        rest = values[k]
        for j in range(k + 1, n):
            rest -= matrix[k, j] * values[j]
        values[k] = rest / matrix[k, k]
    return True
