"""Mean time of each pixel from frames: gate, intensity, mean bin, dead pixels.

[G15 2.2.5, 2.2.6, 3.4.2]; Eq. 2-1 is the intensity, Eq. 2-3 the mean. A frame holds for each pixel
the bin of its only hit, 0 for none. All sums are integers: pieces of a file come in any order.

Deviations. The source's gate was chosen by eye from a histogram; here it lies around the highest
value of the histogram, smoothed by a window of five bins. Dead pixels are found: those with far
fewer hits than the pixels around, and those that fire outside the gate in many frames.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from spl_batch.geiger.water.settings import CameraSettings, GateSettings, PixelSettings

SMOOTHED_BINS = 5
SUMS = ("hits", "total", "square", "outside")
"""Sums of a pixel."""


@dataclass(frozen=True, slots=True)
class Gate:
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
    def intensity(self) -> NDArray[np.float64]:
        """Share of frames with a hit in the gate [G15 Eq. 2-1]: (rows, cols) float64."""
        share: NDArray[np.float64] = self.hits / self.frames
        return share

    def mean_bin(self) -> NDArray[np.float64]:
        """Mean bin [G15 Eq. 2-3]: (rows, cols) float64; NaN without a hit."""
        mean: NDArray[np.float64] = np.full(self.hits.shape, np.nan)
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
    """Gate around the peak of a histogram [G15 3.4.2]; None without a hit.

    ``counts``: (bins + 1,), hits of each bin; bin 0 is no hit.
    """
    centre = settings.centre_bin
    if centre is None:
        around = np.convolve(counts[1:], np.ones(SMOOTHED_BINS, dtype=np.int64), mode="same")
        if not around.any():
            return None
        # The middle of a flat top, so that the gate does not lean to one side.
        top = np.flatnonzero(around == around.max())
        centre = int(top[(len(top) - 1) // 2]) + 1
    low = max(centre - settings.width_bins // 2, 1)
    return Gate(low, min(low + settings.width_bins, len(counts)))


def add_up(frames: NDArray[np.uint16], gate: Gate) -> Hits:
    """Sums of frames within a gate.

    ``frames``: (n, rows, cols) uint16, bins; 0 is no hit.
    """
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
