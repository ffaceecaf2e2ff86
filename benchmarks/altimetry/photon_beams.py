"""A beam of photons in memory, cleaned and measured without a run."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import special

from spl_batch.altimetry.filter import chance
from spl_batch.altimetry.filter import signal as signals
from spl_batch.altimetry.filter.likelihood import Ratios, ratios
from spl_batch.altimetry.ground.profile import profile
from spl_batch.altimetry.noise import noise_rate as rates
from spl_batch.altimetry.noise import windows
from spl_batch.altimetry.noise.noise_at import below_surface
from spl_batch.altimetry.photon_table import Background
from spl_batch.altimetry.settings import (
    BaselineSettings,
    ProfileSettings,
    RateSettings,
    SignalSettings,
)
from spl_batch.altimetry.simulate import Track
from spl_batch.altimetry.water.level_water import NO_WATER
from spl_batch.constants import QUANTA_PER_M

RATE, SIGNAL, PROFILE = RateSettings(), SignalSettings(), ProfileSettings()
"""Settings of all beams, but where others are named."""

Photons = tuple[NDArray[np.int64], NDArray[np.int32]]
Mask = NDArray[np.bool_]


class Beam:
    """A beam in memory: cells, rate and scaled axis, as the tasks of a run make them."""

    def __init__(
        self,
        photons: Photons,
        background: Background | None,
        signal: SignalSettings = SIGNAL,
        source: str = "auto",
    ) -> None:
        self.along, self.height = photons
        self.signal = signal
        self.cells = rates.observe(self.along, self.height, RATE)
        if background is None or source == "window":
            density = rates.density_from_window(self.cells, RATE)
        elif source == "product":
            density = rates.density_from_product(self.cells, background, RATE)
        else:
            density = rates.density_from_both(self.cells, background, RATE, signal.window_m)
        self.scale = rates.scale(self.cells, density, RATE, signal)

    def keep(
        self, score: NDArray[np.float32], table: Ratios | None = None, *, ground: bool = False
    ) -> Mask:
        """Photons that are signal, or those that the ground is sought among, as in a run."""
        window_m, settings = self.signal.window_m, self.signal
        window = np.unique(windows.window_of(self.scale.index, RATE, window_m))

        def counted(along: Any, height: Any, score: Any, value: Any) -> NDArray[np.float64]:
            one = np.zeros((2, len(window), signals.SCORE_BINS))
            np.add.at(one, (*self._zone(along, height, window), signals.score_bins(score)), value)
            return np.moveaxis(windows.running(window, np.moveaxis(one, 1, 2)), 2, 1)

        far = rates.far(self.along, self.height, self.cells, RATE)
        photons = self.along, self.height
        counts, away = (counted(*photons, score, value) for value in (1, far))
        wet = self.scale.level != NO_WATER
        noise = [self.scale.noise - self.scale.below, self.scale.below, wet]
        _, sums = windows.of_window(self.scale.index, np.stack(noise), RATE, window_m)
        every = np.ones(len(self.cells.index), np.bool_)
        along, height, each, told = chance.places(self.cells, self.scale, every, RATE)
        prior = signals.log_prior(self.cells, self.scale, RATE, window_m)
        likelihoods = table or ratios(settings.neighbours, settings.contrast_max)
        both = RATE, self.signal
        found = chance.score_places((along, height), photons, self.scale, prior, both, likelihoods)
        expected = counted(along, height, found, each / chance.SHARE_QUANTA)
        stray = each / chance.SHARE_QUANTA * rates.far(along, height, self.cells, RATE)
        strays = counted(along, height, found, stray)
        seen = np.stack([chance.noise_seen(counts[0], expected[0], sums[2]), np.ones(len(window))])
        sums[0] *= seen[0]
        for values in (expected, strays):
            values[0] *= seen[0, :, None]
        least = np.empty((2, len(window)), np.int64)
        away_too = np.ones((2, len(window)), np.bool_)
        for z in range(2):
            wanted = np.maximum(counts[z].sum(axis=1) - sums[z], 0.0)
            least[z] = signals.thresholds(counts[z], away[z], wanted, settings.false_share)
            if settings.selection == "f1":
                least[z] = chance.best_thresholds(
                    counts[z], expected[z], away[z], strays[z], wanted, settings.false_share
                )
                away_too[z] = chance.more_far_than_noise(
                    counts[z], expected[z], away[z], strays[z], least[z]
                )
            if ground:
                limits = PROFILE.photons_factor * wanted, PROFILE.false_share
                least[z] = np.minimum(least[z], signals.thresholds(counts[z], away[z], *limits))
        alone = [
            chance.noise_alone(
                float(counts[0, w, b:].sum()),
                float(expected[0, w, b:].sum()),
                expected[0, w].sum() / max(counts[0, w].sum(), 1),
                settings.neighbours,
            )
            for w, b in enumerate(least[0])
        ]
        unsure = np.array(alone) > chance.LIKE_NOISE
        there = self._zone(along, height, window)
        passed = signals.score_bins(found) >= least[there]
        passed &= (rates.far(along, height, self.cells, RATE) == 0) | away_too[there]
        photons_told = told * seen[self._zone(along, height, window)] / chance.SHARE_QUANTA
        self.told = float(photons_told[passed].sum())
        self.expected_at = along, height, photons_told
        self.told_at = along[passed], height[passed], photons_told[passed]
        zone, at = self._zone(*photons, window)
        kept: Mask = signals.score_bins(score) >= least[zone, at]
        kept &= (far == 0) | away_too[zone, at]
        self.doubtful = np.count_nonzero(kept & (zone == 0) & unsure[at])
        return kept

    def depth_m(self, along: Any, height: Any) -> NDArray[np.float64]:
        """Depth of places below the water, (n,) float64 [m]; NaN where none is seen."""
        index = along // round(RATE.cell_m * QUANTA_PER_M)
        level = self.scale.level[np.searchsorted(self.scale.index, index)].astype(np.float64)
        return np.where(level > NO_WATER, (level - height) / QUANTA_PER_M, np.nan)

    def _zone(self, along: Any, height: Any, window: Any) -> tuple[Any, Any]:
        """Zone and window of places."""
        index = along // round(RATE.cell_m * QUANTA_PER_M)
        cell = np.searchsorted(self.scale.index, index)
        below = below_surface(cell, height, self.scale).astype(np.int64)
        at = np.searchsorted(window, windows.window_of(index, RATE, self.signal.window_m))
        return below, at

    def score(self, table: Ratios | None = None) -> NDArray[np.float32]:
        """Scores of all photons; by another table of likelihoods where one is given."""
        prior = signals.log_prior(self.cells, self.scale, RATE, self.signal.window_m)
        every = np.ones(len(self.along), np.bool_)
        return signals.score(
            self.along, self.height, every, self.scale, prior, RATE, self.signal, table
        )

    def mdbscan(self, settings: BaselineSettings) -> Mask:
        """Signal by mDBSCAN."""
        chosen = self.signal.model_copy(update={"mdbscan": settings})
        mean = signals.mean_density(self.cells, self.scale, RATE, chosen)
        return signals.mdbscan(self.along, self.height, self.scale, mean, RATE, settings)


def lattice(along_m: NDArray[np.float64], height_m: NDArray[np.float64]) -> Photons:
    """Photons on the lattice."""
    whole = [np.rint(v * QUANTA_PER_M) for v in (along_m, height_m)]
    return whole[0].astype(np.int64), whole[1].astype(np.int32)


def fixed(contrast: float) -> Ratios:
    """Likelihoods of signal that is always this many times as dense as noise."""
    first, last, columns = np.log(1e-7), np.log(400.0), 1024
    x = np.exp(np.linspace(first, last, columns))
    k = np.arange(1, SIGNAL.neighbours + 1)[:, None]
    within = k * np.log(contrast) - (contrast - 1.0) * x
    beyond = np.log(np.maximum(special.gammaincc(k, contrast * x), 1e-300)) - np.log(
        np.maximum(special.gammaincc(k, x), 1e-300)
    )
    return Ratios(within, beyond, float(first), (columns - 1) / float(last - first))


MEASURES = (
    "precision", "recall", "F1", "photons RMSE", "profile RMSE", "cells", "in 1 sigma", "in 2 sigma"
)  # fmt: skip
"""RMSE [m]; share of cells with a ground, and of those whose error is as small as is told."""


def measures(track: Track, kept: Mask, some: Mask | None = None) -> list[float]:
    """As :data:`MEASURES` names them."""
    signal = track.truth > 0
    both = np.count_nonzero(kept & signal)
    precision = both / max(np.count_nonzero(kept), 1)
    recall = both / np.count_nonzero(signal)
    off = (track.height_m - track.ground_m)[kept]
    along, height = lattice(track.along_m, track.height_m)
    rows = np.flatnonzero(kept if some is None else some | kept)
    rows = rows[np.lexsort((height[rows], along[rows]))]
    columns = profile(along[rows], height[rows], kept[rows], (-(10**9), 10**9), PROFILE).columns
    error = columns["ground"] - np.interp(columns["along_track"], *track.reference_m.T)
    known = np.isfinite(error)
    cells = track.along_m.max() / PROFILE.cell_m
    return [
        precision,
        recall,
        2 * both / max(np.count_nonzero(kept) + np.count_nonzero(signal), 1),
        float(np.sqrt(np.mean(off**2))) if len(off) else np.nan,
        float(np.sqrt(np.mean(error[known] ** 2))) if known.any() else np.nan,
        np.count_nonzero(known) / cells,
        *((np.abs(error) < n * columns["ground_error"])[known].mean() for n in (1.0, 2.0)),
    ]
