"""Nearest returns to the centres of cells, and the range of heights that they allow there."""

import numpy as np
from numpy.typing import NDArray

from spl_batch.numerics.compiled import njit

Index = NDArray[np.int64]
Points = tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int32]]

NEAREST = 5
"""Points that bound the height of a surface [count]."""

_ROUNDING = np.sqrt(np.finfo(np.float64).eps)


@njit()
def nearest_heights(
    xyz: Points,
    start: Index,
    lattice: tuple[int, int, int],
    reach: float,
    out: NDArray[np.float64],
) -> None:
    """Heights that the returns around the centres of cells allow there.

    Range of the :data:`NEAREST` nearest returns, and all at the same distance as the last of them,
    widened by what their slope makes of their distance.

    Parameters
    ----------
    xyz : three (n,) int32
        Points, those of a cell together [quanta].
    start : (rows * cols + 1,) int64
        Where each cell begins.
    lattice : (int, int, int)
        Columns; cells around those that are asked, where returns count too; edge [quanta].
    reach : float
        A centre farther than this from all returns is left out [quanta].
    out : (2, rows - 2 rim, cols - 2 rim) float64, written
        Lowest and highest [quanta]; NaN where too few returns are near.
    """
    _, rim, size = lattice
    nearest = np.empty(NEAREST)
    for row in range(out.shape[1]):
        for col in range(out.shape[2]):
            cell = row + rim, col + rim
            ring = _find_nearest(xyz, start, lattice, cell, nearest)
            out[0, row, col] = out[1, row, col] = np.nan
            if nearest[0] <= reach * reach and nearest[-1] <= ((rim + 0.5) * size) ** 2:
                low, high = _allowed(xyz, start, lattice, cell, ring, nearest[-1])
                out[0, row, col], out[1, row, col] = low, high


@njit()
def _find_nearest(
    xyz: Points,
    start: Index,
    lattice: tuple[int, int, int],
    cell: tuple[int, int],
    nearest: NDArray[np.float64],
) -> int:
    """Squared distances from a centre to the nearest returns; how many cells away they are."""
    x, y, _ = xyz
    cols, rim, size = lattice
    row, col = cell
    for k in range(len(nearest)):
        nearest[k] = np.inf
    ring = -1
    while ring < rim and (ring < 0 or nearest[-1] > ((ring + 0.5) * size) ** 2):
        ring += 1
        for r in range(row - ring, row + ring + 1):
            step = 1 if abs(r - row) == ring else 2 * ring
            for c in range(r * cols + col - ring, r * cols + col + ring + 1, max(step, 1)):
                for p in range(start[c], start[c + 1]):
                    d2 = (x[p] - (col + 0.5) * size) ** 2 + (y[p] - (row + 0.5) * size) ** 2
                    for k in range(len(nearest)):
                        nearest[k], d2 = min(nearest[k], d2), max(nearest[k], d2)
    return ring


@njit()
def _allowed(
    xyz: Points,
    start: Index,
    lattice: tuple[int, int, int],
    cell: tuple[int, int],
    ring: int,
    farthest2: float,
) -> tuple[float, float]:
    """Lowest and highest of the returns that are no farther, widened by their slope's share."""
    x, y, z = xyz
    cols, _, size = lattice
    row, col = cell
    # Whole numbers of half quanta: sums are exact in any order.
    n, low, high = 0, np.inf, -np.inf
    su = sv = sw = suu = suv = svv = suw = svw = 0.0
    for r in range(row - ring, row + ring + 1):
        for p in range(start[r * cols + col - ring], start[r * cols + col + ring + 1]):
            u, v, w = x[p] - (col + 0.5) * size, y[p] - (row + 0.5) * size, float(z[p])
            if u * u + v * v <= farthest2:
                low, high, n = min(low, w), max(high, w), n + 1
                su, sv, sw = su + u, sv + v, sw + w
                suu, suv, svv = suu + u * u, suv + u * v, svv + v * v
                suw, svw = suw + u * w, svw + v * w
    u, v, w = su / n, sv / n, sw / n
    uu, uv, vv = suu / n - u * u, suv / n - u * v, svv / n - v * v
    # Returns on one line, up to rounding, give no slope across it.
    rounding = _ROUNDING * (uu + vv)
    uu, vv = uu + rounding, vv + rounding
    uw, vw = suw / n - u * w, svw / n - v * w
    scale = uu * vv - uv * uv
    rise = np.hypot(vv * uw - uv * vw, uu * vw - uv * uw) / scale if scale > 0.0 else 0.0
    share = rise * np.sqrt(farthest2)
    return low - share, high + share
