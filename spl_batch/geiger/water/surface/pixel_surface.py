"""Surface of an acquisition from its hits: places and normals of its pixels.

``windowed`` is the source's chain [G15 3.6.2]: places by Eq. 3-9, median and fast non-local means
of the down coordinate (Eq. 2-4, 2-8 to 2-13), a regression plane in a window of 3 x 3 or 5 x 5
pixels, its normal (Eq. 2-14 to 2-26). The non-local means are scikit-image's. A pixel's own weight
is 2 there; Eq. 2-9 gives it the greatest of the others'. The sum of a patch's squared differences
is compared with h squared times its pixels; Eq. 2-13 compares its square with h squared. Dead
pixels take their neighbours' median.

``adaptive`` neither filters nor fixes a window. It regresses the inverse of the depth along the
optical axis on the image coordinates: there a plane in space is a plane too, and they are free of
error, while north and east carry the range's. First comes a polynomial over the whole array, as
most waves are longer than it is wide, shrunk towards a plane as far as noise explains it
(:mod:`~spl_batch.geiger.water.surface.window_planes`). What it leaves goes to planes in growing
windows (:mod:`~spl_batch.geiger.water.surface.window_planes`). A pixel's weight is the inverse
variance of its mean, from the spread of single hits in the acquisition and from what the
calibration leaves. A pixel far from the median of those around it takes no part.

Either way a pixel without a range, such as a dead one, takes its place from its neighbours, if one
within two pixels has a range.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, maximum_filter
from skimage.restoration import denoise_nl_means

from spl_batch.geiger.water.pixel_geometry import HALF_C_M_NS, View
from spl_batch.geiger.water.ranges.calibration import Calibration
from spl_batch.geiger.water.ranges.hits import Hits, used_pixels
from spl_batch.geiger.water.settings import (
    AdaptiveSettings,
    CameraSettings,
    PixelSettings,
    SurfaceSettings,
    WindowedSettings,
)
from spl_batch.geiger.water.surface.window_planes import growing_windows, planes, shrunk_polynomial

Floats = NDArray[np.float64]

LENT_PX: Final = 2
"""How far from a pixel with a range the surface is told [pixel]."""


@dataclass(frozen=True, slots=True)
class Surface:
    """A surface in the local frame: north, east, down."""

    #: (rows, cols): of each pixel, before any smoothing [m]; NaN where it tells nothing.
    range_m: Floats
    intensity: Floats  #: (rows, cols): share of frames with a hit.
    places_m: Floats  #: (rows, cols, 3): on the surface [m]; NaN where it is not known.
    #: (rows, cols, 3): unit vectors out of the water, so with a negative last part; NaN likewise.
    normals: Floats
    #: (rows, cols, 2): half edges of the windows of place and normal [pixel]; 0 where there is
    #: none.
    half_windows: NDArray[np.int64]


def ranges(
    hits: Hits,
    dead: NDArray[np.bool_],
    calibration: Calibration,
    camera: CameraSettings,
    pixels: PixelSettings,
) -> Floats:
    """Range of each pixel that tells one: (rows, cols) float64 [m], NaN elsewhere."""
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
        places, normals, halves = _windowed(range_m, view, settings.windowed)
    else:
        variance = _variance(hits, calibration, camera)
        places, normals, halves = _adaptive(range_m, variance, view, settings.adaptive)
    # What no pixel nearby has seen, the array's unused rows too, is not made up.
    seen = maximum_filter(np.isfinite(range_m), size=2 * LENT_PX + 1, mode="constant")
    seen &= used_pixels(camera)
    places[~seen] = np.nan
    normals[~seen] = np.nan
    halves[~seen] = 0
    return Surface(range_m, hits.intensity, places, normals, halves)


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
) -> tuple[Floats, Floats, NDArray[np.int64]]:
    around = window_median(range_m, 2)
    sound = np.isfinite(range_m)
    sound[sound] = (range_m - around)[sound] ** 2 <= settings.outlier**2 * 1.2 * variance[sound]
    inverse = np.where(sound, view.norm / np.where(sound, range_m, 1.0), 0.0)
    weight = np.zeros_like(inverse)
    slope = view.norm[sound] / range_m[sound] ** 2
    weight[sound] = 1.0 / (slope**2 * variance[sound])
    trend = shrunk_polynomial(inverse, weight, view.x, view.y, settings.order_max)
    left = inverse - trend[..., 0]
    plane, halves = growing_windows(left, weight, settings.half_windows, settings.agreement)
    # Rows of the image run against x, columns along y.
    value = trend[..., 0] + plane[..., 0]
    along_x = trend[..., 1] + plane[..., 2] / (view.x[1, 0] - view.x[0, 0])
    along_y = trend[..., 2] + plane[..., 1] / (view.y[0, 1] - view.y[0, 0])
    axis = value - along_x * view.x - along_y * view.y
    normals = -np.stack([along_x, along_y, axis], axis=-1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    return view.places(view.norm / value), view.to_local(normals), halves


def _windowed(
    range_m: Floats, view: View, settings: WindowedSettings
) -> tuple[Floats, Floats, NDArray[np.int64]]:
    # A dead pixel has a place as soon as its neighbours lend it a range.
    filled = np.where(np.isfinite(range_m), range_m, window_median(range_m, settings.median // 2))
    places = view.places(filled)
    down = denoised(window_median(places[..., 2], settings.median // 2), settings)
    half = settings.window // 2
    known = np.isfinite(down)
    north, east, sound = (np.where(known, v, 0.0) for v in (*np.moveaxis(places, -1, 0)[:2], down))
    plane, _ = planes(sound, known.astype(np.float64), north, east, half)
    plane[~known] = np.nan
    normals = np.stack([plane[..., 1], plane[..., 2], -np.ones_like(down)], axis=-1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    places[..., 2] = plane[..., 0]
    known = np.isfinite(plane[..., 0])
    places[~known] = np.nan
    normals[~known] = np.nan
    halves = np.repeat(np.where(known, half, 0)[..., None], 2, axis=2)
    return places, normals, halves


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
