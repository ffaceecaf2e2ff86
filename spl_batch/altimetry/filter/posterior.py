"""Log posterior of being noise from the distances to the first neighbours [W17 Eq. 4.4-4.6].

The kernel works on the integer lattice of :mod:`spl_batch.numerics.neighbours.kdtree`, so a
photon's result depends on its neighbours alone, not on what else the table holds.
"""

import math

import numpy as np
from numpy.typing import NDArray

from spl_batch.numerics.compiled import njit
from spl_batch.numerics.neighbours.kdtree import (
    LEAF,
    U1,
    U3,
    build,
    check_cap,
    leaf_slots,
    nearest_keys,
)

_LARGE: float = 40.0  # 1 is nothing beside its exponential
_FULL: float = 1e280  # the next factor still fits


def noise_posterior(
    uv: NDArray[np.int32],
    query: NDArray[np.bool_],
    cap: NDArray[np.int64],
    area_scale: NDArray[np.float64],
    log_prior: NDArray[np.float64],
    within: NDArray[np.float64],
    beyond: NDArray[np.float64],
    grid: tuple[float, float],
    most: NDArray[np.int64] | None = None,
) -> NDArray[np.float64]:
    """Mean over k of ln P(noise | distance to the k-th neighbour).

    Parameters
    ----------
    uv : (n, 2) int32
        Scaled along-track position and height [quanta].
    query : (n,) bool
        Photons whose posterior is wanted.
    cap : (n,) int64
        Farthest neighbour of each photon, inclusive [quanta].
    area_scale : (n,) float64
        Noise photons expected in a disc, over the squared radius [1/quanta2].
    log_prior : (n,) float64
        ln of P(signal) / P(noise).
    within, beyond : (K, m) float64
        ln of the likelihood of signal over that of noise for k = 1..K: neighbour k at a
        distance within which x noise photons are expected, or farther than that.
    grid : (float, float)
        ln x of the first column, and columns per unit of ln x; linear between columns.

    most : (n,) int64, optional
        Neighbours of each photon that count, K at most; all of them by default [count].

    Returns
    -------
    (q,) float64
        For the query photons in table order; 0 and below.
    """
    check_cap(int(cap.max(initial=1)))
    n = len(uv)
    out = np.zeros(n)
    if n:
        xyz = np.zeros((n, 3), np.int32)
        xyz[:, 0], xyz[:, 2] = uv[:, 0], uv[:, 1]
        tree = build(xyz)
        first, step = grid
        if most is None:
            most = np.full(n, len(within), np.int64)
        _posterior(
            tree.points, tree.boxes, tree.depth, query, cap,
            area_scale, log_prior, within, beyond, first, step, most, out,
        )  # fmt: skip
    return out[query]


@njit(inline="always")
def _at(table, k, position):  # type: ignore[no-untyped-def]
    """Value of a row between its columns, the ends continued."""
    last = table.shape[1] - 1
    if position <= 0.0:
        return table[k, 0]
    if position >= last:
        return table[k, last]
    i = int(position)
    share = position - i
    return table[k, i] * (1.0 - share) + table[k, i + 1] * share


@njit()
def _posterior(  # type: ignore[no-untyped-def]
    points, boxes, depth, query, cap, area_scale, log_prior, within, beyond, first, step, most, out
):
    """Every query photon, in tree order, so that the cache stays warm."""
    n, depth = np.uint64(points.shape[1]), np.uint64(depth)
    keys = np.empty(within.shape[0], dtype=np.int64)
    distance, fresh = np.empty(LEAF, dtype=np.float64), np.empty(LEAF, dtype=np.int64)
    stack, bound = np.empty(64, dtype=np.uint64), np.empty(64, dtype=np.float64)
    for leaf in range(U1 << depth, U1 << (depth + U1)):
        low, high = leaf_slots(leaf, depth, n)
        for slot in range(low, high):
            row = points[U3, slot]
            if not query[row]:
                continue
            counted = min(len(keys), most[row])
            found = nearest_keys(
                points, boxes, depth, leaf, slot, cap[row], keys[:counted], distance, fresh,
                stack, bound,
            )  # fmt: skip
            offset = math.log(area_scale[row]) - first
            farthest = 2.0 * math.log(float(cap[row]))
            # Logarithms of 1 + exp(ratio) are taken of products: they cost as much as the search.
            total, product = 0.0, 1.0
            for k in range(counted):
                if k < found:
                    # Photons at one place are a quantum apart at least.
                    d2 = max(float(keys[k] >> 32), 1.0)
                    ratio = _at(within, k, (math.log(d2) + offset) * step) + log_prior[row]
                else:
                    ratio = _at(beyond, k, (farthest + offset) * step) + log_prior[row]
                if ratio > _LARGE:
                    total -= ratio
                    continue
                product *= 1.0 + math.exp(ratio)
                if product > _FULL:
                    total -= math.log(product)
                    product = 1.0
            out[row] = (total - math.log(product)) / counted
