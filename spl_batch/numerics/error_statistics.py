"""Statistics of errors: mean, median, RMSE, NMAD and percentiles, of values or of counts."""

import math
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

STATISTICS: Final = ("n", "mean", "median", "rmse", "sd", "nmad", "p95", "min", "max")
"""Keys of :func:`statistics`."""


NMAD_FACTOR: Final = 1.4826
"""Normalised median absolute deviation over MAD: equals the SD for Gaussian errors."""


def statistics(
    difference: NDArray[np.floating[Any]], counts: NDArray[np.integer[Any]] | None = None
) -> dict[str, float | int | None]:
    """Summary of errors.

    Parameters
    ----------
    difference : (n,) float
        Errors [m]; those that are not finite are left out.
    counts : (n,) int, optional
        How often each of them occurs, by default once [count].

    Returns
    -------
    dict
        ``n`` [count]; ``mean, median, rmse, sd`` (n - 1 degrees of freedom), ``nmad``
        (1.4826 x median absolute deviation), ``p95`` (95th percentile of absolute errors),
        ``min, max`` [m]; None where there are too few for a number.
    """
    d = np.asarray(difference, dtype=np.float64)
    often = np.ones(len(d), np.int64) if counts is None else np.asarray(counts, np.int64)
    d, often = d[np.isfinite(d)], often[np.isfinite(d)]
    n = int(often.sum())
    if n == 0:
        return {key: 0 if key == "n" else None for key in STATISTICS}
    mean, median = float(d @ often) / n, quantile(d, often, 0.5)
    return {
        "n": n,
        "mean": mean,
        "median": median,
        "rmse": float(np.sqrt((d * d) @ often / n)),
        "sd": float(np.sqrt((d - mean) ** 2 @ often / (n - 1))) if n > 1 else None,
        "nmad": NMAD_FACTOR * quantile(np.abs(d - median), often, 0.5),
        "p95": quantile(np.abs(d), often, 0.95),
        "min": float(d.min()),
        "max": float(d.max()),
    }


def quantile(values: NDArray[np.float64], often: NDArray[np.int64], share: float) -> float:
    """Quantile of values that occur so often, linear between neighbours as numpy has it."""
    order = np.argsort(values, kind="stable")
    upto = np.cumsum(often[order])
    rank = share * float(upto[-1] - 1)
    below = math.floor(rank)
    ranks = [below, min(below + 1, int(upto[-1]) - 1)]
    low, high = values[order[np.searchsorted(upto, ranks, side="right")]].tolist()
    return float(low + (high - low) * (rank - below))
