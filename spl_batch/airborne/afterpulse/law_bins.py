"""Bins of lags in which a law of afterpulses is fitted: the wider, the farther behind."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.afterpulse.lag_counts import LAG_EDGES_M

COARSE: Final = (0.1, 0.15)
"""Least width of a bin [m], and least share of the lag behind the dead time."""


def coarse_bins(
    dead_m: float, stated_m: float
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:  # fmt: skip
    """Edges of the bins of a law [m], all of them fine edges; the first is at the dead time.

    One is the stated longest lag, or the next fine edge behind it.
    """
    stated = stated_edge(dead_m, stated_m)
    at = int(np.searchsorted(LAG_EDGES_M, dead_m, side="right")) - 1
    chosen, last = [at], len(LAG_EDGES_M) - 1
    while at < last:
        low = max(float(LAG_EDGES_M[at]), dead_m)
        wide = low + max(COARSE[0], COARSE[1] * (low - dead_m)) - 1e-9
        end = stated if at < stated else last
        at = min(int(np.searchsorted(LAG_EDGES_M, wide)), end)
        chosen.append(at)
    edges = LAG_EDGES_M[chosen].copy()
    edges[0] = dead_m
    return edges, np.array(chosen, dtype=np.int64)


def stated_edge(dead_m: float, stated_m: float) -> int:
    """Fine edge at the stated longest lag or next behind it, with a bin before it at least."""
    at = int(np.searchsorted(LAG_EDGES_M, dead_m, side="right"))
    last = len(LAG_EDGES_M) - 1
    return min(max(int(np.searchsorted(LAG_EDGES_M, stated_m - 1e-9)), at), last)
