"""Planes through windows of pixels: the source's, and weighted ones whose windows grow.

[G15 2.5.1, Eq. 2-15 to 2-26] regresses the down coordinate on north and east in a window around
each pixel: :func:`planes` with weights 1.

:func:`growing_windows` differs. It regresses the inverse of the depth along the optical axis,
:math:`1/z = a + b x + c y`, on the image coordinates x and y. A plane in space is exactly such a
plane in the image, and x and y are free of error, while north and east carry the range's. Each
pixel has the weight that its hits give it. The window is chosen by the intersection of confidence
intervals: it grows as long as the intervals of all windows so far have a value in common. So it is
wide where the surface is even and narrow where it bends.

- **[G97]** A. Goldenshluger, A. Nemirovski: *On spatial adaptive estimation of nonparametric
  regression*. Mathematical Methods of Statistics 6, 1997.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import convolve1d

Floats = NDArray[np.float64]

FLATTEST = 1e-4
"""Least determinant of a window's second moments over their squared trace: else it is a line."""


def planes(value: Floats, weight: Floats, x: Floats, y: Floats, half: int) -> tuple[Floats, Floats]:
    """Weighted least-squares plane around each pixel, in windows that end at the rim.

    Parameters
    ----------
    value, weight, x, y : (rows, cols) float64
        What is regressed on x and y, finite; inverse variances, 0 where there is none.
    half : int
        Half the edge of the window; 1 is 3 x 3 [pixel].

    Returns
    -------
    plane, spread : (rows, cols, 3) float64
        Value at the pixel, slopes along x and y, and their standard deviations; NaN without a
        plane.
    """
    products = np.stack([x**0, x, y, value, x * x, x * y, y * y, x * value, y * value])
    window = np.ones(2 * half + 1)
    for axis in (1, 2):
        products = convolve1d(
            products if axis == 2 else products * weight, window, axis=axis, mode="constant"
        )
    total = products[0]
    with np.errstate(invalid="ignore", divide="ignore"):
        mx, my, mv = products[1:4] / total
        xx, xy, yy, xv, yv = products[4:] - total * [mx * mx, mx * my, my * my, mx * mv, my * mv]
        determinant = xx * yy - xy * xy
        determinant[~(determinant > FLATTEST * (xx + yy) ** 2)] = np.nan
        slope_x, slope_y = (xv * yy - yv * xy) / determinant, (yv * xx - xv * xy) / determinant
        dx, dy = x - mx, y - my
        lever = (dx * dx * yy - 2.0 * dx * dy * xy + dy * dy * xx) / determinant
        plane = np.stack([mv + slope_x * dx + slope_y * dy, slope_x, slope_y], axis=-1)
        spread = np.sqrt(
            np.stack([1.0 / total + lever, yy / determinant, xx / determinant], axis=-1)
        )
    return plane, spread


def growing_windows(
    value: Floats, weight: Floats, halves: Sequence[int], agreement: float
) -> tuple[Floats, NDArray[np.int64]]:
    """Weighted plane around each pixel, in the widest window that agrees with all narrower ones.

    The value at the pixel and the two slopes each choose a window: a value suffers sooner from
    curvature than a slope does.

    Parameters
    ----------
    value, weight : (rows, cols) float64
        As :func:`planes` takes them.
    halves : sequence of int
        Half edges of the windows, rising [pixel].
    agreement : float
        Half width of an interval, in standard deviations.

    Returns
    -------
    plane : (rows, cols, 3) float64
        Value, slope along columns, slope along rows [1/pixel]; NaN without a plane.
    chosen : (rows, cols, 2) int64
        Half edges for value and slopes; 0 without a plane.
    """
    index: Floats = np.indices(value.shape, dtype=np.float64)
    y, x = index[0], index[1]
    found, chosen = np.full((*value.shape, 3), np.nan), np.zeros((*value.shape, 2), np.int64)
    low, high = np.full(found.shape, -np.inf), np.full(found.shape, np.inf)
    for half in halves:
        plane, spread = planes(value, weight, x, y, half)
        known = np.isfinite(plane[..., 0])
        low = np.fmax(low, plane - agreement * spread)
        high = np.fmin(high, plane + agreement * spread)
        agrees = low <= high
        for part, fine in enumerate((agrees[..., 0], agrees[..., 1:].all(axis=-1))):
            columns = slice(0, 1) if part == 0 else slice(1, 3)
            found[known & fine, columns] = plane[known & fine, columns]
            chosen[known & fine, part] = half
        if half >= max(value.shape):
            break
    return found, chosen
