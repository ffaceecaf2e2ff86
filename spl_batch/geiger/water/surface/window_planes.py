"""Planes through windows of pixels: the source's, and weighted ones whose windows grow.

[G15 2.5.1, Eq. 2-15 to 2-26] regresses the down coordinate on north and east in a window around
each pixel. :func:`fixed_windows` does that.

:func:`growing_windows` differs. It regresses the inverse of the depth along the optical axis,
:math:`1/z = a + b x + c y`, on the image coordinates x and y. A plane in space is exactly such a
plane in the image, and x and y are free of error, while north and east carry the range's. Each
pixel has the weight that its hits give it. The window is chosen by the intersection of confidence
intervals: it grows as long as the intervals of all windows so far have a value in common. So it is
wide where the surface is even and narrow where it bends.

- **[G97]** A. Goldenshluger, A. Nemirovski: *On spatial adaptive estimation of nonparametric
  regression*. Mathematical Methods of Statistics 6, 1997.
"""

import math

import numpy as np
from numpy.typing import NDArray

from spl_batch.numerics.compiled import njit
from spl_batch.numerics.planes.robust_plane import plane_of_moments


@njit()
def fixed_windows(
    north: NDArray[np.float64],
    east: NDArray[np.float64],
    down: NDArray[np.float64],
    half: int,
    out: NDArray[np.float64],
) -> None:
    """Least-squares plane ``down = A north + B east + C`` around each pixel [G15 Eq. 2-25].

    Parameters
    ----------
    north, east, down : (rows, cols) float64
        Coordinates [m]; NaN where there are none.
    half : int
        Half the edge of the window; 1 is 3 x 3 [pixel].
    out : (rows, cols, 3) float64
        Filled with the plane's down at the pixel, A and B; NaN where no plane is defined.
    """
    rows, cols = down.shape
    plane = np.empty(3)
    for i in range(rows):
        for j in range(cols):
            out[i, j] = np.nan
            if math.isnan(down[i, j]):
                continue
            count, mn, me, md = 0.0, 0.0, 0.0, 0.0
            n0, e0, d0 = north[i, j], east[i, j], down[i, j]
            nn = ne = ee = nd = ed = 0.0
            for p in range(max(i - half, 0), min(i + half + 1, rows)):
                for q in range(max(j - half, 0), min(j + half + 1, cols)):
                    if math.isnan(down[p, q]):
                        continue
                    dn, de, dd = north[p, q] - n0, east[p, q] - e0, down[p, q] - d0
                    count += 1.0
                    mn, me, md = mn + dn, me + de, md + dd
                    nn, ne, ee = nn + dn * dn, ne + dn * de, ee + de * de
                    nd, ed = nd + dn * dd, ed + de * dd
            mn, me, md = mn / count, me / count, md / count
            nn, ne, ee = nn - count * mn * mn, ne - count * mn * me, ee - count * me * me
            nd, ed = nd - count * mn * md, ed - count * me * md
            if count >= 3 and plane_of_moments(mn, me, md, nn, ne, ee, nd, ed, 1e-4, plane):
                out[i, j, 0] = d0 + plane[0]
                out[i, j, 1] = plane[1]
                out[i, j, 2] = plane[2]


@njit()
def _moments(
    value: NDArray[np.float64],
    weight: NDArray[np.float64],
    i: int,
    j: int,
    half: int,
    out: NDArray[np.float64],
) -> None:
    """Weighted sums around a pixel, coordinates counted from it: 1, x, y, xx, xy, yy, v, xv, yv."""
    rows, cols = value.shape
    out[:] = 0.0
    for p in range(max(i - half, 0), min(i + half + 1, rows)):
        y = float(p - i)
        for q in range(max(j - half, 0), min(j + half + 1, cols)):
            w = weight[p, q]
            if w <= 0.0:
                continue
            x, v = float(q - j), value[p, q]
            out[0] += w
            out[1] += w * x
            out[2] += w * y
            out[3] += w * x * x
            out[4] += w * x * y
            out[5] += w * y * y
            out[6] += w * v
            out[7] += w * x * v
            out[8] += w * y * v


@njit()
def _fit(sums: NDArray[np.float64], fit: NDArray[np.float64], spread: NDArray[np.float64]) -> bool:
    """Plane at the pixel and the standard deviations of its three numbers, weights being 1/var."""
    total = sums[0]
    if total <= 0.0:
        return False
    mx, my, mv = sums[1] / total, sums[2] / total, sums[6] / total
    xx, xy = sums[3] - total * mx * mx, sums[4] - total * mx * my
    yy = sums[5] - total * my * my
    xv, yv = sums[7] - total * mx * mv, sums[8] - total * my * mv
    if not plane_of_moments(mx, my, mv, xx, xy, yy, xv, yv, 1e-4, fit):
        return False
    determinant = xx * yy - xy * xy
    spread[1] = math.sqrt(yy / determinant)
    spread[2] = math.sqrt(xx / determinant)
    lever = (mx * mx * yy - 2.0 * mx * my * xy + my * my * xx) / determinant
    spread[0] = math.sqrt(1.0 / total + lever)
    return True


@njit()
def growing_windows(
    value: NDArray[np.float64],
    weight: NDArray[np.float64],
    halves: NDArray[np.int64],
    agreement: float,
    out: NDArray[np.float64],
    chosen: NDArray[np.int64],
) -> None:
    """Weighted plane around each pixel, in the widest window that agrees with all narrower ones.

    The value at the pixel and the two slopes each choose a window: a value suffers sooner from
    curvature than a slope does.

    Parameters
    ----------
    value : (rows, cols) float64
        What is regressed on row and column; read where the weight is > 0.
    weight : (rows, cols) float64
        Inverse of the value's variance; 0 where there is none.
    halves : (m,) int64
        Half edges of the windows, rising [pixel].
    agreement : float
        Half width of an interval, in standard deviations.
    out : (rows, cols, 3) float64
        Filled with value, slope along columns, slope along rows [1/pixel]; NaN without a plane.
    chosen : (rows, cols, 2) int64
        Filled with the half edges for value and slopes; 0 without a plane.
    """
    rows, cols = value.shape
    sums, fit, spread = np.empty(9), np.empty(3), np.empty(3)
    low, high = np.empty(3), np.empty(3)
    for i in range(rows):
        for j in range(cols):
            out[i, j] = np.nan
            chosen[i, j] = 0
            low[:], high[:] = -np.inf, np.inf
            flat = steep = True
            for m in range(len(halves)):
                _moments(value, weight, i, j, halves[m], sums)
                if not _fit(sums, fit, spread):
                    continue
                for k in range(3):
                    low[k] = max(low[k], fit[k] - agreement * spread[k])
                    high[k] = min(high[k], fit[k] + agreement * spread[k])
                flat = flat and low[0] <= high[0]
                steep = steep and low[1] <= high[1] and low[2] <= high[2]
                if flat:
                    out[i, j, 0] = fit[0]
                    chosen[i, j, 0] = halves[m]
                if steep:
                    out[i, j, 1:] = fit[1:]
                    chosen[i, j, 1] = halves[m]
                wide = halves[m] >= max(rows, cols)
                if not (flat or steep) or wide:
                    break
