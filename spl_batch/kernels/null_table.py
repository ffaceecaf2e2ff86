"""Quantiles and shares from a table, between its rows and columns."""

import numpy as np
from numba import njit
from numpy.typing import NDArray


def value_of(
    at: NDArray[np.float64],
    level: NDArray[np.float64],
    quantile: NDArray[np.float64],
    levels: NDArray[np.float64],
    slope: float,
) -> NDArray[np.float64]:
    """Quantiles at levels; arguments as for :func:`level_of`, its inverse."""
    out = np.empty(len(at), dtype=np.float64)
    _values(at, level, quantile, levels, slope, out)
    return out


@njit(nogil=True, cache=True)
def _mixed(quantile, row, part, column):  # type: ignore[no-untyped-def]
    return quantile[row, column] * (1.0 - part) + quantile[row + 1, column] * part


@njit(nogil=True, cache=True)
def _values(at, level, quantile, levels, slope, out):  # type: ignore[no-untyped-def]
    rows, last = quantile.shape[0], quantile.shape[1] - 1
    rising = -levels
    for i in range(len(at)):
        row = min(int(at[i]), rows - 2)
        part = at[i] - row
        if level[i] < levels[last]:
            out[i] = _mixed(quantile, row, part, last) + (level[i] - levels[last]) / slope
            continue
        column = min(np.searchsorted(rising, -level[i], side="right") - 1, last - 1)
        share = (level[i] - levels[column]) / (levels[column + 1] - levels[column])
        first = _mixed(quantile, row, part, column)
        out[i] = first + share * (_mixed(quantile, row, part, column + 1) - first)


def level_of(
    at: NDArray[np.float64],
    value: NDArray[np.float64],
    quantile: NDArray[np.float64],
    level: NDArray[np.float64],
    slope: float,
) -> NDArray[np.float64]:
    """Level at which the quantile of an interpolated row equals a value.

    Parameters
    ----------
    at : (n,) float64
        Row of the table, with its fraction.
    value : (n,) float64
        What is looked up.
    quantile : (d, p) float64
        Quantiles, descending along each row.
    level : (p,) float64
        Level of each column, descending.
    slope : float
        Level per value beyond the last column.

    Returns
    -------
    (n,) float64
        The largest such level; the first where the value lies above the row's first quantile.
    """
    out = np.empty(len(value), dtype=np.float64)
    _levels(at, value, quantile, level, slope, out)
    return out


@njit(nogil=True, cache=True)
def _levels(at, value, quantile, level, slope, out):  # type: ignore[no-untyped-def]
    rows, last = quantile.shape[0], quantile.shape[1] - 1
    for i in range(len(at)):
        row = min(int(at[i]), rows - 2)
        part = at[i] - row
        low, high = 0, last
        end = _mixed(quantile, row, part, last)
        if value[i] < end:
            out[i] = level[last] + (value[i] - end) * slope
            continue
        while high - low > 1:
            middle = (low + high) >> 1
            if _mixed(quantile, row, part, middle) > value[i]:
                low = middle
            else:
                high = middle
        a = _mixed(quantile, row, part, low)
        b = _mixed(quantile, row, part, high)
        share = min(max((a - value[i]) / (a - b), 0.0), 1.0) if a > b else 0.0
        out[i] = level[low] + share * (level[high] - level[low])
