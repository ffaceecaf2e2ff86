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

:func:`shrunk_polynomial` is one through all pixels, shrunk towards a plane as far as noise explains
it. The plane's three numbers are free. Those of the higher terms, Legendre polynomials of image
coordinates, have a normal prior whose variance falls from order to order. The result is a mean over
sizes and falls of that prior, weighted by how likely the pixels are under each, the plane's numbers
and the terms integrated out [M92]: the most likely one alone is far off now and then. So a level
surface keeps the plane's small error, and a wave gets its curvature.

- **[M92]** D. MacKay: *Bayesian interpolation*. Neural Computation 4, 1992.
"""

from collections.abc import Sequence

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray
from scipy.ndimage import convolve1d

Floats = NDArray[np.float64]

FLATTEST = 1e-4
"""Least determinant of a window's second moments over their squared trace: else it is a line."""


def planes(value: Floats, weight: Floats, x: Floats, y: Floats, half: int) -> tuple[Floats, Floats]:
    """Weighted least-squares plane around each pixel, in windows that end at the rim.

    ``value``, ``weight``, ``x``, ``y``: (rows, cols), what is regressed on x and y, finite; inverse
    variances, 0 where there is none. ``half``: half the edge of the window; 1 is 3 x 3 [pixel].

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
    curvature than a slope does. ``halves``: half edges of the windows, rising [pixel];
    ``agreement``: half width of an interval, in standard deviations.

    Returns
    -------
    (rows, cols, 3) float64, (rows, cols, 2) int64
        Value, slope along columns, slope along rows [1/pixel], NaN without a plane; half edges for
        value and slopes, 0 without a plane.
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


SIZES = 10.0 ** np.arange(-5.0, -0.9, 0.25)
"""Standard deviations of the prior of order 2 that are tried, over the mean value [1]."""

FALLS = (0.1, 0.2, 0.4, 0.8)
"""Factors from one order's standard deviation to the next that are tried [1]."""


def shrunk_polynomial(value: Floats, weight: Floats, x: Floats, y: Floats, order: int) -> Floats:
    """Value and slopes of the most likely surface: (rows, cols, 3) float64.

    ``value`` is read where the inverse variance in ``weight`` is > 0. ``x``, ``y``: coordinates, of
    mean 0. ``order``: the highest; 0 gives zeros, as do too few pixels for a plane.
    """
    known = weight > 0
    terms = [(p, q) for p in range(order + 1) for q in range(order + 1 - p)]
    terms.sort(key=sum)
    while len(terms) > 3 and int(known.sum()) < 2 * len(terms):
        highest = sum(terms[-1])
        terms = [t for t in terms if sum(t) < highest]
    if order < 1 or int(known.sum()) < 6:
        return np.zeros((*value.shape, 3))
    size = max(float(np.abs(x).max()), float(np.abs(y).max()))
    u, v = x / size, y / size
    root = np.sqrt(weight[known])
    design = _products(u[known], v[known], terms) * root[:, None]
    wanted = value[known] * root
    numbers = _most_likely(design, wanted, np.array([sum(t) for t in terms]))
    return np.stack(
        [
            _products(u, v, terms) @ numbers,
            _products(u, v, terms, along_u=True) @ numbers / size,
            _products(u, v, terms, along_v=True) @ numbers / size,
        ],
        axis=-1,
    )


def _most_likely(design: Floats, wanted: Floats, orders: NDArray[np.int64]) -> Floats:
    """Numbers of all terms; rows of the design are over their standard deviations."""
    plane, triangle = np.linalg.qr(design[:, :3])
    bent = design[:, 3:] - plane @ (plane.T @ design[:, 3:])
    left = wanted - plane @ (plane.T @ wanted)
    free = len(wanted) - design.shape[1]
    # Not by BLAS, whose sums over pixels may depend on the number of its threads.
    moments, right = np.einsum("ki,kj->ij", bent, bent), np.einsum("ki,k->i", bent, left)
    # Small and well scaled: quicker than the singular values of all pixels.
    best = np.linalg.lstsq(moments, right)[0]
    # Weights that promise too much must not buy curvature: what is left sets the scale.
    noise = max(float(((left - bent @ best) ** 2).sum()) / free, 1.0)
    moments, right = moments / noise, right / noise
    mean = float(np.abs(wanted).sum() / np.abs(design[:, 0]).sum())
    # A plane alone is likely as exp(0); it counts as much as the falls of one size.
    costs, found = [0.0] * len(FALLS), [np.zeros(len(best))] * len(FALLS)
    for fall in FALLS:
        for size in SIZES:
            prior = mean * size * fall ** (orders[3:] - 2.0)
            scaled = np.eye(len(best)) + prior[:, None] * moments * prior
            numbers = prior * np.linalg.solve(scaled, prior * right)
            costs.append(float(np.linalg.slogdet(scaled)[1] - right @ numbers))
            found.append(numbers)
    likely = np.exp(-0.5 * (np.array(costs) - min(costs)))
    chosen = likely @ np.array(found) / likely.sum()
    flat = np.linalg.solve(triangle, plane.T @ (wanted - design[:, 3:] @ chosen))
    return np.concatenate([flat, chosen])


def _products(
    u: Floats,
    v: Floats,
    terms: list[tuple[int, int]],
    *,
    along_u: bool = False,
    along_v: bool = False,
) -> Floats:
    """Products of Legendre polynomials, or their derivatives: (..., terms) float64."""
    count = max(map(sum, terms)) + 1
    basis = np.eye(count)
    values = [[legendre.legval(w, row) for row in basis] for w in (u, v)]
    slopes = [[legendre.legval(w, legendre.legder(row)) for row in basis] for w in (u, v)]
    first = slopes[0] if along_u else values[0]
    second = slopes[1] if along_v else values[1]
    products: Floats = np.stack([first[p] * second[q] for p, q in terms], axis=-1)
    return products
