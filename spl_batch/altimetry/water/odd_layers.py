"""Layers that a track shows and that may be no ground and no floor.

A detector repeats a bright surface at a fixed depth below it (X. Lu et al., Earth Space Sci. 8,
2021), and a cloud, a ship or spray stands above it. Photons cannot tell such layers from a floor
or from land, so they stay what they are called, and are counted here.
"""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.altimetry.water.level_water import WAVE_M

STRETCH_M: Final = 200.0
"""Stretch of track that a layer is looked for in [m]."""

_LEAST: Final = 3
"""Photons that show a layer in a stretch [count]."""

_LEAST_STRETCHES: Final = 5
_SHARE: Final = 0.8
"""Stretches that hold a layer at one depth, as such and of those with water."""

_DEPTHS: Final = 120
_BINS_PER_M: Final = 2


class Layer(NamedTuple):
    """Photons of a layer, where it lies along the track, and its depth [m]."""

    photons: int
    from_m: float
    to_m: float
    depth_m: float


class Layers:
    """Signal of a beam above and below its water, counted by stretch and depth."""

    def __init__(self, first_m: float, last_m: float) -> None:
        self.first = int(first_m // STRETCH_M)
        n = max(int(last_m // STRETCH_M) - self.first + 1, 1)
        self.above = np.zeros(n, np.int64)
        self.surface = np.zeros(n, np.int64)
        self.beside = np.zeros((2, n), np.int64)
        self.depths = np.zeros((n, _DEPTHS), np.int32)

    def add(
        self, along_m: NDArray[np.float64], depth_m: NDArray[np.float64], half_m: float
    ) -> None:
        """Count signal photons over water; ``half_m`` is the half-thickness of its surface."""
        row = (along_m // STRETCH_M).astype(np.int64) - self.first
        above, below = depth_m < -half_m, depth_m > half_m
        n = len(self.above)
        self.above += np.bincount(row[above], minlength=n)
        self.surface += np.bincount(row[~above & ~below], minlength=n)
        for kind, off in enumerate((depth_m, -depth_m)):
            self.beside[kind] += np.bincount(row[(off > WAVE_M) & (off <= half_m)], minlength=n)
        deep = np.minimum((depth_m[below] * _BINS_PER_M).astype(np.int64), _DEPTHS - 1)
        np.add.at(self.depths, (row[below], deep), 1)

    def facts(self) -> dict[str, list[float]]:
        """The three layers, as a receipt holds them."""
        found = {"over": self.over_water(), "under": self.under_surface(), "echo": self.echo()}
        return {name: [float(v) for v in layer] for name, layer in found.items()}

    def over_water(self) -> Layer:
        """Signal above the surface, of the stretches that show water."""
        own = np.flatnonzero((self.surface > 0) & (self.above >= _LEAST))
        return self._layer(own, int(self.above[own].sum()), 0.0)

    def under_surface(self) -> Layer:
        """Photons of the surface that lie below it, over those that lie as far above it."""
        low, high = self.beside
        own = np.flatnonzero(low >= high + _LEAST)
        return self._layer(own, int(max(low.sum() - high.sum(), 0)), WAVE_M)

    def echo(self) -> Layer:
        """The fullest metre of depth that nearly all of the water shows, if there is one."""
        metre = self.depths[:, :-1] + self.depths[:, 1:]
        shown = metre >= _LEAST
        stretches = shown.sum(axis=0)
        wet = np.count_nonzero(self.surface)
        # What the deepest bin holds has no depth.
        fixed = (stretches >= max(_LEAST_STRETCHES, _SHARE * wet)) & (
            np.arange(_DEPTHS - 1) < _DEPTHS - 2
        )
        if not fixed.any():
            return Layer(0, 0.0, 0.0, 0.0)
        at = int(np.where(fixed, metre.sum(axis=0), -1).argmax())
        own = np.flatnonzero(shown[:, at])
        return self._layer(own, int(metre[own, at].sum()), (at + 1.0) / _BINS_PER_M)

    def _layer(self, own: NDArray[np.intp], photons: int, depth_m: float) -> Layer:
        if not len(own):
            return Layer(0, 0.0, 0.0, 0.0)
        ends = (self.first + own[0]) * STRETCH_M, (self.first + own[-1] + 1) * STRETCH_M
        return Layer(photons, float(ends[0]), float(ends[1]), depth_m)
