"""Errors of surfaces against the truth [G15 3.7, Eq. 3-16 to 3-27].

Down is positive: a positive bias means too deep. The source's angle of a surface, Eq. 3-25, is that
of the mean of its normals; the mean of its pixels' angles, in which slopes cannot cancel, is given
beside it. Expectations are means over what is known.

Deviation: the source's truth is one depth and one normal. Here each pixel of each acquisition may
have its own, so that waves can be judged.
"""

from typing import NamedTuple

import numpy as np

from spl_batch.geiger.water.pixel_geometry import Floats, floor_points, refracted


class SurfaceError(NamedTuple):
    """Errors of one surface."""

    #: Of the down coordinate [G15 Eq. 3-16 to 3-18].
    bias_m: float
    variance_m2: float
    mse_m2: float
    normal_deg: float  #: Between the mean normal and the mean true one [G15 Eq. 3-25].
    pixel_normal_deg: float  #: Mean angle between a pixel's normal and its true one.
    pixels: int


PIXEL_SUMS = ("count", "error", "square", "angle")
"""Sums over acquisitions from which the errors of a pixel follow."""


def pixel_sums(error_m: Floats, angle_deg: Floats) -> Floats:
    """What an acquisition adds to :data:`PIXEL_SUMS`: (4, rows, cols) float64.

    ``error_m``, ``angle_deg``: (rows, cols) each, NaN where unknown.
    """
    known = np.isfinite(error_m) & np.isfinite(angle_deg)
    return np.where(known, [known, error_m, error_m**2, angle_deg], 0.0)


def pixel_maps(sums: Floats) -> dict[str, Floats]:
    """Errors of each pixel [G15 Eq. 3-19 to 3-26]; NaN where unknown.

    Bias [m], variance [m2], MSE [m2] and angle [deg], (rows, cols) float64 each.
    """
    with np.errstate(invalid="ignore", divide="ignore"):
        bias, mse, angle = sums[1:] / sums[0]
    variance = np.maximum(mse - bias**2, 0.0)
    return {"bias_m": bias, "variance_m2": variance, "mse_m2": mse, "normal_deg": angle}


def angles_deg(normals: Floats, true: Floats) -> Floats:
    """Angle between unit vectors [G15 Eq. 3-26]: (...) float64 [deg]."""
    # The chord keeps small angles that a cosine near one would lose.
    chord = np.linalg.norm(normals - true, axis=-1)
    return np.asarray(np.degrees(2.0 * np.arcsin(np.minimum(chord / 2.0, 1.0))))


def surface_error(
    points_m: Floats, normals: Floats, true_down_m: Floats, true_normals: Floats
) -> tuple[SurfaceError, Floats, Floats]:
    """Errors of a surface, NaN where nothing is known, and those of its pixels.

    ``points_m``, ``normals``: (rows, cols, 3), the surface [m]; NaN where unknown. ``true_down_m``:
    true down coordinate along each line of sight [m]. ``true_normals``: out of the water. Of each
    pixel down less true down [m], and the angle between the normals [deg].
    """
    error = points_m[..., 2] - true_down_m
    angle = angles_deg(normals, true_normals)
    known = np.isfinite(error) & np.isfinite(angle)
    if not known.any():
        return SurfaceError(*(float("nan"),) * 5, pixels=0), error, angle
    bias, variance = float(error[known].mean()), float(error[known].var())
    means = [v[known].mean(axis=0) for v in (normals, true_normals)]
    between = float(angles_deg(*(mean / np.linalg.norm(mean) for mean in means)))
    each, pixels = float(angle[known].mean()), int(known.sum())
    made = SurfaceError(bias, variance, bias**2 + variance, between, each, pixels)
    return made, error, angle


class FloorError(NamedTuple):
    """How far rays end from where they truly do after a way through the water."""

    #: Mean distance of the ends of single pixels' rays: without refraction, refracted by a level
    #: surface, refracted by the surface found [m].
    straight_m: float
    level_m: float
    refracted_m: float
    #: Distance of the mean of all ends: the position of a beam that covers these pixels [m].
    straight_beam_m: float
    level_beam_m: float
    refracted_beam_m: float


def floor_error(
    look: Floats,
    found: tuple[Floats, Floats],
    true: tuple[Floats, Floats],
    in_water_m: float,
    index_water: float,
) -> FloorError:
    """Errors of the ends of rays; NaN where no pixel is known, or no way in water.

    ``look``: (rows, cols, 3), lines of sight. ``found``, ``true``: points on the surface [m] and
    unit normals out of the water.
    """
    known = np.isfinite(found[0]).all(axis=-1) & np.isfinite(found[1]).all(axis=-1)
    if not known.any() or in_water_m <= 0:
        return FloorError(*(float("nan"),) * 6)
    beam = look[known]
    points, normals, true_points, true_normals = (v[known] for v in (*found, *true))
    level = np.broadcast_to(np.array([0.0, 0.0, -1.0]), normals.shape)
    ends = floor_points(true_points, refracted(beam, true_normals, index_water), in_water_m)
    ways = (beam, refracted(beam, level, index_water), refracted(beam, normals, index_water))
    off = [floor_points(points, way, in_water_m) - ends for way in ways]
    single = [float(np.linalg.norm(o, axis=-1).mean()) for o in off]
    whole = [float(np.linalg.norm(o.mean(axis=0))) for o in off]
    return FloorError(*single, *whole)


def middle(shape: tuple[int, int], edge: int) -> tuple[slice, slice]:
    """Footprint of a green beam: the pixels in the middle of an array [G15 3.1.3]."""
    rows, cols = ((n - min(edge, n)) // 2 for n in shape)
    return slice(rows, rows + min(edge, shape[0])), slice(cols, cols + min(edge, shape[1]))
