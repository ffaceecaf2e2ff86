"""Statistics of differences, as the report holds them."""

import math
from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.accuracy.tally import Tally

STATISTICS: Final = ("n", "mean", "median", "rmse", "sd", "nmad", "p95", "min", "max")
"""Keys of :func:`statistics`."""

NMAD_FACTOR: Final = 1.4826
"""Normalised median absolute deviation over MAD: equals the SD for Gaussian errors."""

USGS_LEVELS: Final = ((0.05, "QL0"), (0.10, "QL1/QL2"), (0.20, "QL3"))
"""Largest non-vegetated RMSEz of each quality level [m]; USGS Lidar Base Specification."""


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
    mean, median = float(d @ often) / n, _quantile(d, often, 0.5)
    return {
        "n": n,
        "mean": mean,
        "median": median,
        "rmse": float(np.sqrt((d * d) @ often / n)),
        "sd": float(np.sqrt((d - mean) ** 2 @ often / (n - 1))) if n > 1 else None,
        "nmad": NMAD_FACTOR * _quantile(np.abs(d - median), often, 0.5),
        "p95": _quantile(np.abs(d), often, 0.95),
        "min": float(d.min()),
        "max": float(d.max()),
    }


def _quantile(values: NDArray[np.float64], often: NDArray[np.int64], share: float) -> float:
    """Quantile of values that occur so often, linear between neighbours as numpy has it."""
    order = np.argsort(values, kind="stable")
    upto = np.cumsum(often[order])
    rank = share * float(upto[-1] - 1)
    below = math.floor(rank)
    ranks = [below, min(below + 1, int(upto[-1]) - 1)]
    low, high = values[order[np.searchsorted(upto, ranks, side="right")]].tolist()
    return float(low + (high - low) * (rank - below))


def accuracy_report(
    dtm: Mapping[str, Tally], dsm: Mapping[str, Tally], *, remove_bias: bool = False
) -> dict[str, Any]:
    """Accuracy as ``report.json`` holds it.

    Parameters
    ----------
    dtm, dsm : mapping of str to Tally
        By class of surface, of all places together; may be empty.
    remove_bias : bool
        Subtract the vertical bias between the sensors from every difference first.

    Returns
    -------
    dict
        ``dtm`` and ``dsm``: :func:`statistics` by class, ``all`` always among them;
        ``vertical_bias_m``: median of the DTM on open ground (else of all of it, else of
        the DSM on ground; None without any); ``bias_removed_m``: what was subtracted;
        ``usgs_quality_level``: the best level whose RMSEz the open ground meets, or None.
    """
    bias = _bias(dtm, dsm)
    removed = bias if remove_bias and bias is not None else 0.0
    report: dict[str, Any] = {
        product: {
            name: statistics(found.errors_m - removed, found.counts)
            for name, found in {"all": Tally(), **counted}.items()
        }
        for product, counted in (("dtm", dtm), ("dsm", dsm))
    }
    rmse = report["dtm"].get("open_ground", report["dtm"]["all"])["rmse"]
    report["vertical_bias_m"] = bias
    report["bias_removed_m"] = removed
    report["usgs_quality_level"] = _quality_level(rmse)
    return report


def _bias(dtm: Mapping[str, Tally], dsm: Mapping[str, Tally]) -> float | None:
    for found in (dtm.get("open_ground"), dtm.get("all"), dsm.get("ground")):
        if found is not None and found.n:
            return _quantile(found.errors_m, found.counts, 0.5)
    return None


def _quality_level(rmse_m: float | None) -> str | None:
    if rmse_m is None:
        return None
    return next((name for limit, name in USGS_LEVELS if rmse_m <= limit), None)
