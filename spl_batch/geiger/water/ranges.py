"""Ranges of pixels: hits, calibration, range walk.

Mean time of each pixel from frames [G15 2.2.5, 2.2.6, 3.4.2]: Eq. 2-1 is the intensity, Eq. 2-3 the
mean. A frame holds for each pixel the bin of its only hit, 0 for none. All sums are integers:
pieces of a file come in any order. The source's gate was chosen by eye; here it lies around the
highest value of the histogram, smoothed by a window of five bins. Dead pixels are found.

Ranges from mean times, and the fit of that from frames of a target [G15 3.4.3-3.4.4]: the measured
time of a pixel is

    m = R0 t + R1 - walk(I) + delay of the pixel,

t being the actual time of flight. The source's own fit: R0 and R1 by a line through the means of
dim pixels (Eq. 3-1, 3-2), then ``walk = A exp(B I)`` through what brighter ones lack (Eq. 3-4,
3-5). The joint fit: R0, R1 and the echo's spread of the first-photon law
(:func:`first_photon`) by weighted least squares over all pixels and distances, in turn with a
delay for each pixel, shrunk towards nothing as far as the spread of its hits explains it.

Deviations from the source. The target is flat and across the axis, so an outer pixel's range is
longer than the axis'; the source takes one distance for all. The walk was defined as a difference
of measured times: it is added to the measured time, before the scale is divided out.

The first-photon law: a pixel that expects n photo-electrons of an echo fires at the first of them.
Their times spread by a normal law with standard deviation s; I = 1 - exp(-n) is the share of frames
with a hit, whose mean is early by s g(I), with g the mean over -I of z n phi(z) exp(-n Phi(z)). It
follows from Poisson's law alone; [G15 3.4.4] instead fits an exponential to its measurements.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter
from scipy.optimize import curve_fit
from scipy.special import ndtr

from spl_batch.geiger.water.pixel_geometry import HALF_C_M_NS, Floats
from spl_batch.geiger.water.settings import (
    CalibrationSettings,
    CameraSettings,
    GateSettings,
    PixelSettings,
)

SUMS = ("hits", "total", "square", "outside")


class Gate(NamedTuple):
    """Bins that count: ``low <= bin < high``."""

    low: int
    high: int


@dataclass(frozen=True, slots=True)
class Hits:
    """What frames add up to."""

    frames: int  #: Frames that were added up [count].
    gate: Gate
    #: (rows, cols): hits; sums of bins from the gate's start, and of their squares; hits outside
    #: the gate.
    hits: NDArray[np.int64]
    total: NDArray[np.int64]
    square: NDArray[np.int64]
    outside: NDArray[np.int64]

    def __add__(self, other: "Hits") -> "Hits":
        """Sums of the frames of both, from the start of the gate of the first."""
        sums = (getattr(self, k) + getattr(other, k) for k in SUMS)
        return Hits(self.frames + other.frames, self.gate, *sums)

    @property
    def intensity(self) -> Floats:
        """Share of frames with a hit in the gate [G15 Eq. 2-1]: (rows, cols) float64."""
        return np.asarray(self.hits / self.frames)

    def mean_bin(self) -> Floats:
        """Mean bin [G15 Eq. 2-3]: (rows, cols) float64; NaN without a hit."""
        mean: Floats = np.full(self.hits.shape, np.nan)
        np.divide(self.total, self.hits, out=mean, where=self.hits > 0)
        return mean + self.gate.low

    def spread_bins(self) -> float:
        """Standard deviation of single hits about their pixel's mean; NaN where none repeats."""
        twice = self.hits > 1
        inner = self.square[twice] - self.total[twice] ** 2 / self.hits[twice]
        free = int((self.hits[twice] - 1).sum())
        return float(np.sqrt(max(inner.sum(), 0.0) / free)) if free else float("nan")


def used_pixels(camera: CameraSettings) -> NDArray[np.bool_]:
    """Pixels in rows that take part: (rows, cols) bool."""
    used = np.ones((camera.rows, camera.cols), dtype=np.bool_)
    used[camera.rows - camera.last_rows_unused :] = False
    return used


def histogram(frames: NDArray[np.uint16], used: NDArray[np.bool_], bins: int) -> NDArray[np.int64]:
    """Hits of each bin, (bins + 1,) int64, of the pixels that are ``used``, (rows, cols) bool.

    ``frames``: (n, rows, cols), bins, not beyond the last one; 0 is no hit.
    """
    counts = np.bincount(frames[:, used].ravel(), minlength=bins + 1).astype(np.int64)
    counts[0] = 0
    return counts


def find_gate(counts: NDArray[np.int64], settings: GateSettings) -> Gate | None:
    """Gate around the peak of a histogram, (bins + 1,) [G15 3.4.2]; None without a hit."""
    centre = settings.centre_bin
    if centre is None:
        around = np.convolve(counts[1:], np.ones(5, dtype=np.int64), mode="same")  # smoothed
        if not around.any():
            return None
        # The middle of a flat top, so that the gate does not lean to one side.
        top = np.flatnonzero(around == around.max())
        centre = int(top[(len(top) - 1) // 2]) + 1
    low = max(centre - settings.width_bins // 2, 1)
    return Gate(low, min(low + settings.width_bins, len(counts)))


def add_up(frames: NDArray[np.uint16], gate: Gate) -> Hits:
    """Sums of frames, (n, rows, cols), bins, within a gate; 0 is no hit."""
    inside = (frames >= gate.low) & (frames < gate.high) & (frames > 0)
    step = np.where(inside, frames, gate.low).astype(np.int32) - gate.low
    hits = inside.sum(axis=0)
    return Hits(
        len(frames),
        gate,
        hits,
        step.sum(axis=0, dtype=np.int64),
        np.einsum("fij,fij->ij", step, step, dtype=np.int64),
        np.count_nonzero(frames, axis=0) - hits,
    )


def dead_pixels(hits: Hits, used: NDArray[np.bool_], settings: PixelSettings) -> NDArray[np.bool_]:
    """Pixels that cannot be trusted: (rows, cols) bool; ``used``: those that may take part."""
    # Where most neighbours are dead too their median is nothing to compare with.
    around = median_filter(hits.hits, size=5, mode="reflect")
    dead: NDArray[np.bool_] = (hits.hits < settings.dead_share * around) | (hits.hits == 0) | ~used
    dead |= hits.outside > settings.hot_share * hits.frames
    for row, col in settings.dead:
        dead[row, col] = True
    return dead


HITS_MIN = 5
"""Fewest hits of a pixel that takes part in a fit [count]."""

BRIGHTEST = 0.97
"""Intensity above which the number of photons cannot be estimated [G15 3.4.4]."""


@dataclass(frozen=True, slots=True)
class Calibration:
    """What turns mean times into ranges."""

    settings: CalibrationSettings  #: Numbers of the laws, fitted ones put in.
    pixel_ns: Floats  #: (rows, cols): delay of each pixel [ns].
    #: Standard deviation of what a fit leaves beyond the spread of hits; 0 without a fit [ns].
    residual_ns: float = 0.0

    def walk_ns(self, intensity: Floats) -> Floats:
        """How early hits are: (rows, cols) float64 [ns]."""
        s = self.settings
        if s.range_walk == "first_photon":
            return s.pulse_ns * first_photon(intensity)
        if s.range_walk == "exponential":
            return exponential(intensity, s.walk_ns, s.walk_exponent)
        return np.zeros_like(intensity)

    def ranges(self, measured_ns: Floats, intensity: Floats) -> Floats:
        """Ranges along the lines of sight [G15 Eq. 2-2, 3-3, 3-5]: (rows, cols) float64 [m].

        Of the mean times of pixels [ns], NaN stays NaN, and shares of frames with a hit.
        """
        s = self.settings
        late = measured_ns + self.walk_ns(intensity) - self.pixel_ns - s.offset_ns
        return HALF_C_M_NS * late / s.scale


@dataclass(frozen=True, slots=True)
class Observation:
    """Frames of a target at a known distance."""

    distance_m: float  #: Of the target along the axis [m].
    actual_ns: Floats  #: (rows, cols): actual time of flight of each pixel [ns].
    measured_ns: Floats  #: (rows, cols): mean time [ns].
    hits: NDArray[np.int64]  #: (rows, cols): hits; 0 for pixels that take no part.
    intensity: Floats  #: (rows, cols): share of frames with a hit.
    spread_ns: float  #: Standard deviation of single hits [ns].


def observation(
    hits: Hits, dead: NDArray[np.bool_], norm: Floats, distance_m: float, bin_ns: float
) -> Observation:
    """What a fit needs from frames of a target.

    ``norm``: (rows, cols), range over depth along the axis. ``dead``: pixels that are left out.
    """
    enough = ~dead & (hits.hits >= HITS_MIN)
    return Observation(
        distance_m,
        distance_m * norm / HALF_C_M_NS,
        hits.mean_bin() * bin_ns,
        np.where(enough, hits.hits, 0),
        hits.intensity,
        hits.spread_bins() * bin_ns,
    )


def faults_of(observations: Sequence[Observation], settings: CalibrationSettings) -> list[str]:
    """Why nothing can be fitted, each with a remedy; empty where it can."""
    faults = [
        f"calibration.frames[{k}]: no pixel has {HITS_MIN} hits within the gate; "
        "take more frames or check gate:"
        for k, seen in enumerate(observations)
        if not seen.hits.any()
    ]
    dim = {seen.distance_m for seen in observations if _dim(seen, settings).any()}
    if settings.range_walk == "exponential" and len(dim) < 2 and not faults:
        faults.append(
            f"calibration.frames: {len(dim)} of their distances have pixels with an intensity "
            f"between dim_min {settings.dim_min} and dim_max {settings.dim_max}, two are needed; "
            "attenuate the laser more, raise dim_max, or set range_walk: first_photon"
        )
    return faults


def fit(observations: Sequence[Observation], settings: CalibrationSettings) -> Calibration:
    """Fit the laws that the settings name; :func:`faults_of` must have found nothing."""
    if settings.range_walk == "exponential":
        return _fit_source(observations, settings)
    return _fit_joint(observations, settings)


def _dim(seen: Observation, settings: CalibrationSettings) -> NDArray[np.bool_]:
    """Pixels without range walk."""
    dim = (seen.intensity > settings.dim_min) & (seen.intensity < settings.dim_max)
    return dim & (seen.hits > 0)


def _fit_source(observations: Sequence[Observation], settings: CalibrationSettings) -> Calibration:
    """Line through dim pixels, exponential through the rest [G15 Eq. 3-1 to 3-5]."""
    dim = [(seen, rows) for seen in observations if (rows := _dim(seen, settings)).any()]
    actual = [seen.actual_ns[rows].mean() for seen, rows in dim]
    measured = [seen.measured_ns[rows].mean() for seen, rows in dim]
    scale, offset = np.polyfit(actual, measured, 1)
    bright = [
        np.stack([s.intensity, scale * s.actual_ns + offset - s.measured_ns, s.hits])[:, rows]
        for s in observations
        for rows in [_fitted(s) & (s.intensity > settings.dim_min)]
    ]
    intensity, early, hits = np.concatenate(bright, axis=1)
    start: Any = (settings.walk_ns or 0.02, settings.walk_exponent)
    (a, b), _ = curve_fit(
        exponential, intensity, early, p0=start, sigma=1.0 / np.sqrt(hits), maxfev=2000
    )
    walk = {"walk_ns": max(float(a), 0.0), "walk_exponent": float(b)}
    clock = {"scale": float(scale), "offset_ns": float(offset)}
    return _with_delays(observations, settings.model_copy(update=clock | walk))


def _fitted(seen: Observation) -> NDArray[np.bool_]:
    """Pixels that take part in a fit."""
    return (seen.hits > 0) & (seen.intensity < BRIGHTEST)


def _fit_joint(observations: Sequence[Observation], settings: CalibrationSettings) -> Calibration:
    """All numbers at once, in turn with the pixels' delays until neither moves."""
    walks = settings.range_walk == "first_photon"
    made = Calibration(settings, np.zeros_like(observations[0].actual_ns))
    last: Floats = np.zeros(3)
    for _ in range(50):  # delays and law in turn, until nothing changes
        normal, right = np.zeros((3, 3)), np.zeros(3)
        for seen in observations:
            rows = _fitted(seen)
            early = first_photon(seen.intensity[rows]) if walks else np.zeros(int(rows.sum()))
            design = np.stack([seen.actual_ns[rows], np.ones(len(early)), -early], axis=1)
            weighted = design * seen.hits[rows, None]
            normal += weighted.T @ design
            right += weighted.T @ (seen.measured_ns[rows] - made.pixel_ns[rows])
        numbers = np.asarray(np.linalg.lstsq(normal, right)[0], dtype=np.float64)
        found = dict(zip(("scale", "offset_ns", "pulse_ns"), numbers.tolist(), strict=True))
        found["pulse_ns"] = max(found["pulse_ns"], 0.0) if walks else settings.pulse_ns
        made = _with_delays(observations, settings.model_copy(update=found))
        if np.abs(numbers - last).max() < 1e-9:
            break
        last = numbers
    return made


def _with_delays(observations: Sequence[Observation], fitted: CalibrationSettings) -> Calibration:
    """Mean delay of each pixel over the observations, shrunk, and the rest of their spread."""
    none = Calibration(fitted, np.zeros_like(observations[0].actual_ns))
    hits, delay, expected = (np.zeros_like(none.pixel_ns) for _ in range(3))
    for seen in observations:
        rows = _fitted(seen)
        left = seen.measured_ns + none.walk_ns(seen.intensity)
        left -= fitted.scale * seen.actual_ns + fitted.offset_ns
        hits[rows] += seen.hits[rows]
        delay[rows] += seen.hits[rows] * left[rows]
        expected[rows] += seen.hits[rows] * seen.spread_ns**2
    known = hits > 0
    mean, variance = delay[known] / hits[known], expected[known] / hits[known] ** 2
    # The delays' own variance: what their means show beyond the spread of hits.
    own = max(float(np.average(mean**2 - variance, weights=hits[known])), 0.0)
    if not fitted.pixel_offsets:
        return Calibration(fitted, none.pixel_ns, own**0.5)
    share = own / (own + variance) if own else np.zeros_like(variance)
    pixel = np.zeros_like(none.pixel_ns)
    pixel[known] = share * mean
    left_over = float(np.average(share * variance, weights=hits[known]))
    return Calibration(fitted, pixel, left_over**0.5)


MOST: Final = 10.0
"""Photo-electrons up to which the law is tabulated: I = 0.99995."""

_STEP: Final = 0.02


@cache
def _table() -> tuple[Floats, Floats]:
    expected = np.arange(0.0, MOST + _STEP / 2, _STEP)
    z = np.linspace(-9.0, 9.0, 3601)
    density = np.exp(-0.5 * z**2) / np.sqrt(2.0 * np.pi)
    n = expected[1:, None]
    early = -np.trapezoid(z * n * density * np.exp(-n * ndtr(z)), z, axis=1) / -np.expm1(-n[:, 0])
    return expected, np.concatenate([[0.0], early])


def first_photon(intensity: Floats) -> Floats:
    """How early hits are, in standard deviations of the echo, by their share of frames: g, >= 0."""
    expected, early = _table()
    n = -np.log1p(-np.minimum(intensity, -np.expm1(-MOST)))
    return np.asarray(np.interp(n, expected, early))


def exponential(intensity: Floats, amplitude: float, exponent: float) -> Floats:
    """``A exp(B I)`` [G15 Eq. 3-5]: (...) float64, in the unit of A."""
    return np.asarray(amplitude * np.exp(exponent * intensity))
