"""Quantiles and shares from a table, between its rows and columns."""

import numpy as np
from numpy.typing import NDArray

from spl_batch.numerics.compiled import njit


def between(
    row: NDArray[np.float64], column: NDArray[np.float64], table: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Values of a table (d, k) linear between its rows and columns, at fractional places: (n,)."""
    rows, columns = table.shape
    i, j = row.astype(np.intp), column.astype(np.intp)
    near, close = 1.0 - (row - i), 1.0 - (column - j)
    far, beyond = 1.0 - near, 1.0 - close
    k, m = np.minimum(i + 1, rows - 1), np.minimum(j + 1, columns - 1)
    found: NDArray[np.float64] = table[i, j] * near * close + table[i, m] * near * beyond
    found += table[k, j] * far * close
    found += table[k, m] * far * beyond
    return found


def value_of(
    at: NDArray[np.float64],
    level: NDArray[np.float64],
    quantile: NDArray[np.float64],
    levels: NDArray[np.float64],
    slope: float,
) -> NDArray[np.float64]:
    """Quantiles at levels; arguments as for :func:`level_of`, its inverse."""
    beyond = np.minimum(level - levels[-1], 0.0) / slope
    column = np.interp(-level, -levels, np.arange(len(levels)))
    found: NDArray[np.float64] = between(at, column, quantile) + beyond
    return found


def level_of(
    at: NDArray[np.float64],
    value: NDArray[np.float64],
    quantile: NDArray[np.float64],
    level: NDArray[np.float64],
    slope: float,
) -> NDArray[np.float64]:
    """Level at which the quantile of an interpolated row of a table (d, p) equals a value: (n,).

    Quantiles and levels descend; beyond the last column there are ``slope`` levels per value. The
    largest such level; the first where the value lies above the row's first quantile.
    """
    out = np.empty(len(value), dtype=np.float64)
    _levels(at, value, quantile, level, slope, out)
    return out


@njit()
def _mixed(quantile, row, part, column):  # type: ignore[no-untyped-def]
    return quantile[row, column] * (1.0 - part) + quantile[row + 1, column] * part


@njit()
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
