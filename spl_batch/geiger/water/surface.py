"""Surface of an acquisition from its hits: points and normals of its pixels.

``windowed`` is the source's chain [G15 3.6.2]: points by Eq. 3-9, median and fast non-local means
of the down coordinate (Eq. 2-4, 2-8 to 2-13), a regression plane in a window of 3 x 3 or 5 x 5
pixels, its normal (Eq. 2-14 to 2-26). The non-local means are scikit-image's: a pixel's own weight
is 2, where Eq. 2-9 gives it the greatest of the others', and the sum of a patch's squared
differences is compared with h squared times its pixels, where Eq. 2-13 compares its square with
h squared. Dead pixels take their neighbours' median.

``adaptive`` neither filters nor fixes a window. It regresses the inverse of the depth along the
optical axis on the image coordinates, :math:`1/z = a + b x + c y`: there a plane in space is a
plane too, and they are free of error, while north and east carry the range's.

First comes a polynomial over the whole array, as most waves are longer than it is wide, shrunk
towards a plane as far as noise explains it (:func:`shrunk_polynomial`). The plane's three numbers
are free; those of the higher terms, Legendre polynomials, have a normal prior whose variance falls
from order to order. The result is a mean over sizes and falls of that prior, weighted by how likely
the pixels are under each, all terms integrated out [M92]: the most likely one alone is far off now
and then. What it leaves goes to planes in windows that grow as long as the confidence intervals of
all so far have a value in common (:func:`growing_windows`, [G97]). A pixel's weight is the inverse
variance of its mean, from the spread of single hits and from what the calibration leaves; one far
from the median of those around it takes no part.

Either way a pixel without a range takes its point from its neighbours, if one within two pixels has
a range.

- **[G97]** A. Goldenshluger, A. Nemirovski: *On spatial adaptive estimation of nonparametric
  regression*. Mathematical Methods of Statistics 6, 1997.
- **[M92]** D. MacKay: *Bayesian interpolation*. Neural Computation 4, 1992.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.polynomial import legendre
from numpy.typing import NDArray
from scipy.ndimage import convolve1d, distance_transform_edt, maximum_filter
from skimage.restoration import denoise_nl_means

from spl_batch.geiger.water.pixel_geometry import HALF_C_M_NS, Floats, View
from spl_batch.geiger.water.ranges import Calibration, Hits, used_pixels
from spl_batch.geiger.water.settings import (
    AdaptiveSettings,
    CameraSettings,
    PixelSettings,
    SurfaceSettings,
    WindowedSettings,
)


def planes(value: Floats, weight: Floats, x: Floats, y: Floats, half: int) -> tuple[Floats, Floats]:
    """Weighted least-squares plane around each pixel, in windows that end at the rim.

    ``value``, ``weight``, ``x``, ``y``: (rows, cols), what is regressed on x and y, finite; inverse
    variances, 0 where there is none. ``half``: half the edge of the window; 1 is 3 x 3 [pixel].

    Value at the pixel, slopes along x and y, (rows, cols, 3), and their standard deviations; NaN
    without a plane.
    """
    products = np.stack([x**0, x, y, value, x * x, x * y, y * y, x * value, y * value]) * weight
    for axis in (1, 2):
        products = convolve1d(products, np.ones(2 * half + 1), axis=axis, mode="constant")
    total = products[0]
    with np.errstate(invalid="ignore", divide="ignore"):
        mx, my, mv = products[1:4] / total
        xx, xy, yy, xv, yv = products[4:] - total * [mx * mx, mx * my, my * my, mx * mv, my * mv]
        determinant = xx * yy - xy * xy
        # With less over the squared trace of its second moments a window is a line.
        determinant[~(determinant > 1e-4 * (xx + yy) ** 2)] = np.nan
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
) -> Floats:
    """Weighted plane around each pixel, in the widest window that agrees with all narrower ones.

    The value at the pixel and the two slopes each choose a window: a value suffers sooner from
    curvature than a slope does. ``halves``: half edges of the windows, rising [pixel];
    ``agreement``: half width of an interval, in standard deviations.

    Value, slope along columns, slope along rows [1/pixel]: (rows, cols, 3); NaN without a plane.
    """
    index: Floats = np.indices(value.shape, dtype=np.float64)
    y, x = index[0], index[1]
    found = np.full((*value.shape, 3), np.nan)
    low, high = np.full(found.shape, -np.inf), np.full(found.shape, np.inf)
    for half in halves:
        plane, spread = planes(value, weight, x, y, half)
        known = np.isfinite(plane[..., 0])
        low = np.fmax(low, plane - agreement * spread)
        high = np.fmin(high, plane + agreement * spread)
        agrees = low <= high
        for part in (slice(0, 1), slice(1, 3)):
            wider = known & agrees[..., part].all(axis=-1)
            found[wider, part] = plane[wider, part]
        if half >= max(value.shape):
            break
    return found


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
            _products(u, v, terms, 0) @ numbers / size,
            _products(u, v, terms, 1) @ numbers / size,
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
    u: Floats, v: Floats, terms: list[tuple[int, int]], along: int | None = None
) -> Floats:
    """Products of Legendre polynomials, or their derivatives along one: (..., terms) float64."""
    basis = np.eye(max(map(sum, terms)) + 1)
    values = [
        [legendre.legval(w, legendre.legder(row) if axis == along else row) for row in basis]
        for axis, w in enumerate((u, v))
    ]
    return np.asarray(np.stack([values[0][p] * values[1][q] for p, q in terms], axis=-1))


@dataclass(frozen=True, slots=True)
class Surface:
    """A surface in the local frame: north, east, down."""

    #: (rows, cols): of each pixel, before any smoothing [m]; NaN where it gives none.
    range_m: Floats
    intensity: Floats  #: (rows, cols): share of frames with a hit.
    points_m: Floats  #: (rows, cols, 3): on the surface [m]; NaN where it is not known.
    #: (rows, cols, 3): unit vectors out of the water, so with a negative last part; NaN likewise.
    normals: Floats


def ranges(
    hits: Hits,
    dead: NDArray[np.bool_],
    calibration: Calibration,
    camera: CameraSettings,
    pixels: PixelSettings,
) -> Floats:
    """Range of each pixel that has one: (rows, cols) float64 [m], NaN elsewhere."""
    bright = ~dead & (hits.intensity >= pixels.intensity_min) & (hits.hits > 0)
    measured = np.where(bright, hits.mean_bin() * camera.bin_ns, np.nan)
    return calibration.ranges(measured, hits.intensity)


def make_surface(
    hits: Hits,
    dead: NDArray[np.bool_],
    calibration: Calibration,
    view: View,
    camera: CameraSettings,
    pixels: PixelSettings,
    settings: SurfaceSettings,
) -> Surface:
    """Surface of one acquisition.

    ``dead``: (rows, cols) bool, pixels that take no part. ``view``: where each pixel looks.
    """
    range_m = ranges(hits, dead, calibration, camera, pixels)
    if settings.method == "windowed":
        points, normals = _windowed(range_m, view, settings.windowed)
    else:
        variance = _variance(hits, calibration, camera)
        points, normals = _adaptive(range_m, variance, view, settings.adaptive)
    # What no pixel within two has seen, the array's unused rows too, is not made up.
    seen = maximum_filter(np.isfinite(range_m), size=5, mode="constant")
    seen &= used_pixels(camera)
    points[~seen] = np.nan
    normals[~seen] = np.nan
    return Surface(range_m, hits.intensity, points, normals)


def _variance(hits: Hits, calibration: Calibration, camera: CameraSettings) -> Floats:
    """Variance of each pixel's range: (rows, cols) float64 [m2]; inf without a hit."""
    to_m = HALF_C_M_NS / calibration.settings.scale
    single = hits.spread_bins()
    # Rounding to bins spreads hits by 1 / sqrt(12) at the least; few hits may not show it.
    spread = max(0.0 if np.isnan(single) else single, 12**-0.5) * camera.bin_ns * to_m
    variance = np.full(hits.hits.shape, np.inf)
    np.divide(spread**2, hits.hits, out=variance, where=hits.hits > 0)
    return variance + (calibration.residual_ns * to_m) ** 2


def _adaptive(
    range_m: Floats, variance: Floats, view: View, settings: AdaptiveSettings
) -> tuple[Floats, Floats]:
    around = window_median(range_m, 2)
    sound = np.isfinite(range_m)
    sound[sound] = (range_m - around)[sound] ** 2 <= settings.outlier**2 * 1.2 * variance[sound]
    inverse = np.where(sound, view.norm / np.where(sound, range_m, 1.0), 0.0)
    weight = np.zeros_like(inverse)
    slope = view.norm[sound] / range_m[sound] ** 2
    weight[sound] = 1.0 / (slope**2 * variance[sound])
    trend = shrunk_polynomial(inverse, weight, view.x, view.y, settings.order_max)
    left = inverse - trend[..., 0]
    plane = growing_windows(left, weight, settings.half_windows, settings.agreement)
    # Rows of the image run against x, columns along y.
    value = trend[..., 0] + plane[..., 0]
    along_x = trend[..., 1] + plane[..., 2] / (view.x[1, 0] - view.x[0, 0])
    along_y = trend[..., 2] + plane[..., 1] / (view.y[0, 1] - view.y[0, 0])
    axis = value - along_x * view.x - along_y * view.y
    normals = -np.stack([along_x, along_y, axis], axis=-1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    return view.points(view.norm / value), normals @ view.rotation.T


def _windowed(range_m: Floats, view: View, settings: WindowedSettings) -> tuple[Floats, Floats]:
    # A dead pixel has a point as soon as its neighbours lend it a range.
    filled = np.where(np.isfinite(range_m), range_m, window_median(range_m, settings.median // 2))
    points = view.points(filled)
    down = denoised(window_median(points[..., 2], settings.median // 2), settings)
    half = settings.window // 2
    known = np.isfinite(down)
    north, east, sound = (np.where(known, v, 0.0) for v in (*np.moveaxis(points, -1, 0)[:2], down))
    plane, _ = planes(sound, known.astype(np.float64), north, east, half)
    plane[~known] = np.nan
    normals = np.stack([plane[..., 1], plane[..., 2], -np.ones_like(down)], axis=-1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    points[..., 2] = plane[..., 0]
    known = np.isfinite(plane[..., 0])
    points[~known] = np.nan
    normals[~known] = np.nan
    return points, normals


def window_median(image: Floats, half: int) -> Floats:
    """Median of a square window [G15 Eq. 2-4]: (rows, cols), edges mirrored.

    NaN takes no part, and is where the whole window is.
    """
    padded = np.pad(image, half, mode="symmetric")
    windows = sliding_window_view(padded, (2 * half + 1, 2 * half + 1)).reshape(*image.shape, -1)
    median: Floats = np.full(image.shape, np.nan)
    any_value = np.isfinite(windows).any(axis=-1)
    median[any_value] = np.nanmedian(windows[any_value], axis=-1)
    return median


def denoised(image: Floats, settings: WindowedSettings) -> Floats:
    """Fast non-local means [G15 Eq. 2-8 to 2-13]: (rows, cols) float64; NaN stays NaN."""
    missing = ~np.isfinite(image)
    if missing.all():
        return image
    if missing.any():
        near = distance_transform_edt(missing, return_distances=False, return_indices=True)
        image = image[tuple(near)]
    smooth: Floats = denoise_nl_means(
        image,
        patch_size=settings.patch,
        patch_distance=settings.search // 2,
        h=settings.strength_m,
        fast_mode=True,
        preserve_range=True,
    )
    smooth[missing] = np.nan
    return smooth
