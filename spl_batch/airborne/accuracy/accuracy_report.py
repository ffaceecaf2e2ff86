"""Statistics of differences, as the report holds them."""

from collections.abc import Mapping
from typing import Any

from spl_batch.airborne.accuracy.error_tally import Tally
from spl_batch.numerics.error_statistics import quantile, statistics


def accuracy_report(
    dtm: Mapping[str, Tally],
    dsm: Mapping[str, Tally],
    *,
    remove_bias: bool = False,
) -> dict[str, Any]:
    """Accuracy as ``report.json`` holds it.

    Parameters
    ----------
    dtm, dsm : mapping of str to Tally
        By class of surface, of all places together; may be empty.
    returns : mapping of str to Tally, optional
        The same of the returns that the filter keeps.
    remove_bias : bool
        Subtract the vertical bias between the sensors from every difference first.

    Returns
    -------
    dict
        ``dtm`` and ``dsm``: :func:`statistics` by class, ``all`` always among them;
        ``vertical_bias_m``: median of the DTM on open ground (else of all of it, else of
        the DSM on ground; None without any); ``bias_removed_m``: what was subtracted.
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
    report["vertical_bias_m"] = bias
    report["bias_removed_m"] = removed
    return report


def _bias(dtm: Mapping[str, Tally], dsm: Mapping[str, Tally]) -> float | None:
    for found in (dtm.get("open_ground"), dtm.get("all"), dsm.get("ground")):
        if found is not None and found.n:
            return quantile(found.errors_m, found.counts, 0.5)
    return None
