"""Statistics of differences, as the report holds them."""

from collections.abc import Mapping
from typing import Any, Final

from spl_batch.airborne.accuracy.error_tally import Tally
from spl_batch.numerics.error_statistics import quantile, statistics

USGS_LEVELS: Final = ((0.05, "QL0"), (0.10, "QL1/QL2"), (0.20, "QL3"))
"""Largest non-vegetated RMSEz of each quality level [m]; USGS Lidar Base Specification."""


def accuracy_report(
    dtm: Mapping[str, Tally],
    dsm: Mapping[str, Tally],
    returns: Mapping[str, Tally] | None = None,
    *,
    remove_bias: bool = False,
) -> dict[str, Any]:
    """Accuracy as ``report.json`` holds it, of all places together by class of surface.

    ``dtm`` and ``dsm``: :func:`statistics` by class, ``all`` always among them; ``returns``: the
    same without it; ``vertical_bias_m``: median of the DTM on open ground (else of all of it, else
    of the DSM on ground; None without any); ``bias_removed_m``: what was subtracted from every
    difference; ``usgs_quality_level``: the best level whose RMSEz the open ground meets, or None.
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
    report["returns"] = {
        name: statistics(found.errors_m - removed, found.counts)
        for name, found in (returns or {}).items()
        if found.n
    }
    rmse = report["dtm"].get("open_ground", report["dtm"]["all"])["rmse"]
    report["vertical_bias_m"] = bias
    report["bias_removed_m"] = removed
    report["usgs_quality_level"] = _quality_level(rmse)
    return report


def _bias(dtm: Mapping[str, Tally], dsm: Mapping[str, Tally]) -> float | None:
    for found in (dtm.get("open_ground"), dtm.get("all"), dsm.get("ground")):
        if found is not None and found.n:
            return quantile(found.errors_m, found.counts, 0.5)
    return None


def _quality_level(rmse_m: float | None) -> str | None:
    if rmse_m is None:
        return None
    return next((name for limit, name in USGS_LEVELS if rmse_m <= limit), None)
