"""Statistics of differences, as the report holds them."""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.accuracy.differences import Differences

STATISTICS: Final = ("n", "mean", "median", "rmse", "sd", "nmad", "p95", "min", "max")
"""Keys of :func:`statistics`."""

NMAD_FACTOR: Final = 1.4826
"""Normalised median absolute deviation over MAD: equals the SD for Gaussian errors."""

USGS_LEVELS: Final = ((0.05, "QL0"), (0.10, "QL1/QL2"), (0.20, "QL3"))
"""Largest non-vegetated RMSEz of each quality level [m]; USGS Lidar Base Specification."""


def statistics(difference: NDArray[np.floating[Any]]) -> dict[str, float | int | None]:
    """Summary of errors.

    Parameters
    ----------
    difference : (n,) float
        Errors [m]; those that are not finite are left out.

    Returns
    -------
    dict
        ``n`` [count]; ``mean, median, rmse, sd`` (n - 1 degrees of freedom), ``nmad``
        (1.4826 x median absolute deviation), ``p95`` (95th percentile of absolute errors),
        ``min, max`` [m]; None where there are too few for a number.
    """
    d = np.asarray(difference, dtype=np.float64)
    d = d[np.isfinite(d)]
    if len(d) == 0:
        return {key: 0 if key == "n" else None for key in STATISTICS}
    median = float(np.median(d))
    return {
        "n": len(d),
        "mean": float(d.mean()),
        "median": median,
        "rmse": float(np.sqrt(np.mean(d * d))),
        "sd": float(d.std(ddof=1)) if len(d) > 1 else None,
        "nmad": NMAD_FACTOR * float(np.median(np.abs(d - median))),
        "p95": float(np.percentile(np.abs(d), 95)),
        "min": float(d.min()),
        "max": float(d.max()),
    }


def accuracy_report(
    dtm: Differences, dsm: Differences, *, remove_bias: bool = False
) -> dict[str, Any]:
    """Accuracy as ``report.json`` holds it.

    Parameters
    ----------
    dtm, dsm : Differences
        Merged; may be empty.
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
            name: statistics(values.astype(np.float64) - removed)
            for name, values in {"all": np.empty(0, np.float32), **differences}.items()
        }
        for product, differences in (("dtm", dtm), ("dsm", dsm))
    }
    rmse = report["dtm"].get("open_ground", report["dtm"]["all"])["rmse"]
    report["vertical_bias_m"] = bias
    report["bias_removed_m"] = removed
    report["usgs_quality_level"] = _quality_level(rmse)
    return report


def _bias(dtm: Differences, dsm: Differences) -> float | None:
    for values in (dtm.get("open_ground"), dtm.get("all"), dsm.get("ground")):
        if values is not None and len(values):
            return float(np.median(values.astype(np.float64)))
    return None


def _quality_level(rmse_m: float | None) -> str | None:
    if rmse_m is None:
        return None
    return next((name for limit, name in USGS_LEVELS if rmse_m <= limit), None)
