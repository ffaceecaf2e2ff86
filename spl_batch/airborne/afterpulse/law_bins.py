"""Bins of lags in which a law of afterpulses is fitted: wider where farther behind the return."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.afterpulse.lag_counts import LAG_EDGES_M

COARSE: Final = (0.1, 0.15)
"""Width of the bins of a law: at least so much [m], and so much of the lag behind the dead time."""


def coarse_bins(
    dead_m: float, stated_m: float
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:  # fmt: skip
    """Edges of the bins of a law [m], the first at the dead time; where they are among the fine.

    One is the stated longest lag, or the next of the fine ones behind it.
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
    """The fine edge at the stated longest lag or next behind it; a bin lies before it at least."""
    at = int(np.searchsorted(LAG_EDGES_M, dead_m, side="right"))
    last = len(LAG_EDGES_M) - 1
    return min(max(int(np.searchsorted(LAG_EDGES_M, stated_m - 1e-9)), at), last)
