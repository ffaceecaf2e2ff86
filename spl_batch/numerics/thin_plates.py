"""Smoothing thin plates: the surface that bends least while it passes near some points.

Source: Duchon 1977 (LNM 571); Wahba 1990, *Spline Models for Observational Data*, 2.4. Of all
surfaces f it has the least ``sum (z_i - f(x_i, y_i))**2 + c * bending energy``, and is

    f(x, y) = b_0 + b_1 x + b_2 y + sum a_i U(r_i),   U(r) = r**2 log r,

where ``(U + stiffness I) a + P b = z``, ``P' a = 0`` (P: rows of 1, x, y). The system is solved
here, by elimination with pivots, as a library's answer would depend on how many threads it takes.
"""

import numpy as np
from numpy.typing import NDArray

from spl_batch.numerics.compiled import njit
from spl_batch.numerics.neighbours.kdtree import U0, U1

Values = NDArray[np.float64]


@njit()
def bending(distance2: float) -> float:
    """``r**2 log r`` of a squared distance, 0 at 0."""
    return 0.5 * distance2 * np.log(distance2) if distance2 > 0.0 else 0.0


@njit()
def _pivot(matrix: Values, values: Values, k: int) -> None:
    """Bring the row with the largest value of a column to the diagonal, from there or below."""
    pivot, end = k, np.uint64(len(values))
    for i in range(k + U1, end):
        if abs(matrix[i, k]) > abs(matrix[pivot, k]):
            pivot = i
    if pivot != k:
        for j in range(k, end):
            matrix[k, j], matrix[pivot, j] = matrix[pivot, j], matrix[k, j]
        values[k], values[pivot] = values[pivot], values[k]


@njit()
def _solve(matrix: Values, values: Values) -> bool:
    """Solve a square system in place, pivots by column; whether it can be solved.

    Indices are unsigned: a signed one costs numba a test for wrapping, and the compiler its vector
    instructions.
    """
    n, end = len(values), np.uint64(len(values))
    for k in range(U0, end):
        _pivot(matrix, values, k)
        if matrix[k, k] == 0.0:
            return False
        for i in range(k + U1, end):
            factor = matrix[i, k] / matrix[k, k]
            if factor != 0.0:
                for j in range(k + U1, end):
                    matrix[i, j] -= factor * matrix[k, j]
                values[i] -= factor * values[k]
    for k in range(n - 1, -1, -1):
        rest = values[k]
        for j in range(k + 1, n):
            rest -= matrix[k, j] * values[j]
        values[k] = rest / matrix[k, k]
    return True


@njit()
def fit_plate(points: Values, stiffness: float, plate: Values) -> bool:
    """Smoothing thin plate of some points.

    Parameters
    ----------
    points : (n, 3) float64
        x, y, z; distances of about one keep the numbers small.
    stiffness : float
        What is added to the diagonal [unit of x squared]; 0 passes through all points.
    plate : (n + 3,) float64, written
        ``a`` and ``b`` of the module's equation.

    Returns
    -------
    bool
        Whether there is one: the points do not lie on one line.
    """
    n = len(points)
    matrix = np.zeros((n + 3, n + 3))
    for i in range(n, n + 3):
        plate[i] = 0.0
    for i in range(n):
        x, y, plate[i] = points[i, 0], points[i, 1], points[i, 2]
        for j in range(i):
            matrix[i, j] = bending((x - points[j, 0]) ** 2 + (y - points[j, 1]) ** 2)
            matrix[j, i] = matrix[i, j]
        matrix[i, i] = stiffness
        matrix[i, n], matrix[i, n + 1], matrix[i, n + 2] = 1.0, x, y
        matrix[n, i], matrix[n + 1, i], matrix[n + 2, i] = 1.0, x, y
    return bool(_solve(matrix, plate))


@njit()
def plate_height(points: Values, plate: Values, x: float, y: float) -> float:
    """Height of a plate of :func:`fit_plate` at a place."""
    n = len(points)
    height = plate[n] + plate[n + 1] * x + plate[n + 2] * y
    for i in range(n):
        height += plate[i] * bending((x - points[i, 0]) ** 2 + (y - points[i, 1]) ** 2)
    return float(height)
