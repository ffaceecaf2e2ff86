"""Share of pure noise that the scan for conductors keeps, and the point-wise test allows for.

Domain: space. ``filter.alpha`` is the share of pure noise that the whole filter keeps. What the
scan (:mod:`~spl_batch.airborne.filter.wires.wire_scan`) keeps of it depends on the density of the
noise, and is drawn as in :mod:`~spl_batch.airborne.filter.ellipsoid.null_distribution`. The
point-wise test gets the rest of alpha (:func:`spent`), at least half: a scan that would take more
is made stricter (:func:`fitted`). What both keep is counted twice, on the safe side.

The default settings' table ships (``wire_null.json``, written by
``python -m benchmarks.airborne.filter.null_table``); others draw a coarser one on first use.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.airborne.filter.ellipsoid.null_distribution import (
    POINTS,
    SMOOTH,
    repeated,
    shipped_or_drawn,
)
from spl_batch.airborne.filter.filter_interface import Cloud
from spl_batch.airborne.filter.wires.wire_scan import BESIDE_M, scan
from spl_batch.airborne.settings import FilterSettings, WireSettings
from spl_batch.lattice.tiles import quanta

FILE: Final = "wire_null.json"

IRRELEVANT: Final = frozenset({"enabled", "classify"})
"""Settings that the share does not depend on."""

DENSITIES: Final = 10.0 ** np.linspace(-2, 0, 51)
"""Noise densities of the table [1/m3]; its first and last shares hold beyond. The returns that make
a tube significant are a whole number: the share jumps by up to a factor of four, and steps are
small against that."""

COARSE: Final = DENSITIES[::10]
"""Noise densities that are drawn where no shipped table fits: too few to show ups and downs."""

MOST: Final = 0.5
"""Largest part of the filter's alpha that the scan gets. Half moves 9 + 4 labels, twice nothing."""


@dataclass(frozen=True, slots=True)
class WireNull:
    """Share of pure noise that the scan keeps."""

    density: NDArray[np.float64]  #: (d,): log noise density [1/m3], ascending.
    share: NDArray[np.float64]  #: (d,): share kept at the settings' alpha.
    power: float  #: The share goes with this power of alpha.

    def at(self, density: NDArray[np.float64]) -> NDArray[np.float64]:
        """Share of noise of these densities that is kept: (n,)."""
        log_density = np.log(np.maximum(density, np.finfo(np.float64).tiny))
        found: NDArray[np.float64] = np.interp(log_density, self.density, self.share)
        return found


def fitted(settings: FilterSettings) -> WireSettings:
    """The scan with an alpha at which it takes no more than its part of the filter's."""
    wires = settings.wires
    return wires.model_copy(update={"alpha": wires.alpha * _stricter(settings)})


def spent(density: NDArray[np.float64], settings: FilterSettings) -> NDArray[np.float64]:
    """Share of pure noise of these densities that the :func:`fitted` scan keeps: (n,)."""
    if not settings.wires.enabled:
        return np.zeros(len(density))
    table = wire_null(settings.wires)
    part = float(np.power(_stricter(settings), table.power))
    return part * table.at(density)


def _stricter(settings: FilterSettings) -> float:
    """Part of the scan's alpha that the filter's leaves it."""
    table = wire_null(settings.wires)
    most = float(table.share.max())
    allowed = MOST * settings.alpha
    return float((allowed / most) ** (1.0 / table.power)) if most > allowed else 1.0


def parse_table(content: Mapping[str, Any]) -> WireNull:
    """Table of a JSON file's content."""
    density, share = (np.array(content[name], dtype=np.float64) for name in ("density", "share"))
    return WireNull(density, share, float(content["power"]))


def smoothed(share: NDArray[np.float64]) -> NDArray[np.float64]:
    """Shares smoothed over :data:`SMOOTH` neighbouring densities; beyond the ends these go on.

    A chance tube keeps many points at once, so drawn shares scatter far more than their number of
    points shows.
    """
    weights = np.bartlett(SMOOTH + 2)[1:-1]
    padded = np.pad(share, SMOOTH // 2, mode="edge")
    smooth: NDArray[np.float64] = np.convolve(padded, weights / weights.sum(), mode="valid")
    return smooth


def _drawn(own: Mapping[str, Any], shipped: WireNull) -> WireNull:
    share = draw_shares(WireSettings(**own), POINTS, COARSE)
    return WireNull(np.log(COARSE), smoothed(share), shipped.power)


wire_null = shipped_or_drawn(resources.files(__package__) / FILE, IRRELEVANT, parse_table, _drawn)
"""Table of a scan's settings."""


def draw_shares(
    wires: WireSettings,
    points: int,
    densities: NDArray[np.float64] = DENSITIES,
) -> NDArray[np.float64]:
    """Share of uniform noise of some densities [1/m3] that the scan keeps: (d,)."""
    wires = wires.model_copy(update={"enabled": True})
    seeds = (np.random.default_rng([i, points]) for i in range(len(densities)))
    drawn = zip(seeds, densities.tolist(), strict=True)
    return np.array([_share(rng, density, points, wires) for rng, density in drawn])


def _share(rng: np.random.Generator, density: float, points: int, wires: WireSettings) -> float:
    side = np.cbrt(points / density)
    # A tube through a point, and what lies in one that agrees with it.
    around = min(2.0 * wires.half_length_m + BESIDE_M, side)
    up = min(wires.slope_max * around + BESIDE_M, side)
    size, margin = (
        np.array([quanta(float(length)) for length in box])
        for box in ((side, side, side), (around, around, up))
    )
    xyz, _, core = repeated(rng, density, size, margin)
    nothing = np.zeros(len(xyz), np.bool_)
    cloud = Cloud(xyz, (0, 0, 0), np.full(len(xyz), density), core, nothing)
    return float(scan(cloud, wires).signal.mean())
