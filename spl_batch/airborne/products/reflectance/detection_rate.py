"""How bright a cell is, from which of its beamlets were seen."""

import math

import numpy as np
from numpy.typing import NDArray

from spl_batch.numerics.compiled import njit


@njit()
def sort_by_cell(
    cell: NDArray[np.int64],
    amount: NDArray[np.float64],
    start: NDArray[np.int64],
    out: NDArray[np.float64],
) -> None:
    """Put amounts cell by cell, in the order in which they came.

    Parameters
    ----------
    cell : (s,) int64
        Cell of each.
    amount : (s,) float64
        What is sorted.
    start : (m + 1,) int64
        First place of each cell, and their number.
    out : (s,) float64
        Filled.
    """
    place = start[:-1].copy()
    for s in range(len(cell)):
        out[place[cell[s]]] = amount[s]
        place[cell[s]] += 1


@njit()
def most_likely(
    start: NDArray[np.int64],
    amount: NDArray[np.float64],
    silent: NDArray[np.float64],
    out: NDArray[np.float64],
) -> None:
    r"""Reflectance under which what was seen, and what was not, is most likely.

    A beamlet that expects :math:`k \rho` photo-electrons is seen with probability
    :math:`1 - e^{-k \rho}` [W17 Eq. 2.7], so
    :math:`\sum_{seen} k / (e^{k \rho} - 1) = \sum_{silent} k`; equal ones give
    :math:`k \rho = -\ln(1 - p)`.

    Parameters
    ----------
    start : (m + 1,) int64
        First seen beamlet of each cell, and their number.
    amount : (s,) float64
        k of each seen beamlet, > 0.
    silent : (m,) float64
        Sum of k over the silent ones, > 0 where any was seen.
    out : (m,) float64
        Filled; 0 where none was seen.
    """
    for cell in range(len(start) - 1):
        low, high = start[cell], start[cell + 1]
        out[cell] = 0.0
        if low == high:
            continue
        total = 0.0
        for s in range(low, high):
            total += amount[s]
        mean = total / (high - low)
        rho = math.log1p(total / silent[cell]) / mean
        for _ in range(50):
            value, fall = -silent[cell], 0.0
            for s in range(low, high):
                # of what falls: the exponential of many photo-electrons is beyond all numbers
                unseen, seen = math.exp(-amount[s] * rho), -math.expm1(-amount[s] * rho)
                value += amount[s] * unseen / seen
                fall += amount[s] * amount[s] * unseen / (seen * seen)
            # The left side is convex and falls: from the right a step may go too far.
            new = max(rho + value / fall, 0.25 * rho)
            done = abs(new - rho) <= 1e-10 * rho
            rho = new
            if done:
                break
        out[cell] = rho
