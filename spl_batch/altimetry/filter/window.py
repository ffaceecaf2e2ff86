"""Signal of a window of track: one likelihood for land and water, day and night.

Photons of a window are noise, whose density is smooth along the track and in height, or signal,
which may be a surface, canopy or a floor: signal is denser than noise by an unknown factor. A
photon is scored by the areas that its first neighbours reach
(:mod:`~spl_batch.altimetry.filter.posterior`), and noise is what scores low, over the area in which
a photon would score low; both are repeated until they agree. How noise scores is not assumed: a
noise photon sees the others as a point without a photon does (Slivnyak's theorem; Baddeley,
*Spatial Point Processes*, 2007, 2.3), so points strewn evenly over the gate are scored as photons
are. That gives the noise among the photons above every score, hence the F1 to be expected, and the
score where it is largest is the threshold.

Below water it is another medium: where the signal shows a water surface, the noise below falls with
depth, and what lies deeper than the surface has a threshold and a shape of its own.

The points are those of Roberts' sequence (M. Roberts, *The Unreasonable Effectiveness of
Quasirandom Sequences*, 2018), numbered by cell. A window is a function of its photons and those of
its margin alone, so no cut of the track can change it.
"""

from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from spl_batch.altimetry.filter.neighbours import (
    LAYER_M,
    SLOPES,
    columns,
    leaning,
    log_areas,
)
from spl_batch.altimetry.filter.noise_field import Boxes, below_water, density, gate
from spl_batch.altimetry.filter.posterior import Ratios, noise_posterior, ratios, with_prior
from spl_batch.altimetry.settings import SignalSettings
from spl_batch.altimetry.water.surface import NO_WATER, SURFACE_M, water_levels
from spl_batch.constants import QUANTA_PER_M

_ROUNDS: Final = 8
_AGREED: Final = 0.005
"""Rounds at most; change of the noise that ends them sooner, as a share of it."""
_FIRST: Final = 0.3
"""Share of all photons that is noise before anything is known."""

_SURE_NOISE: Final = 0.8
"""Share of the noise whose scores are lowest: photons below are noise for its density."""

_CLUMP: Final = 20.0
"""Photons that noise comes in, at most, where it passes for signal [count]."""

_SURE_SD: Final = 5.0
"""Standard deviations by which signal has to exceed what noise alone gives."""

_BINS: Final = np.linspace(-6.0, 6.0, 601)
"""Edges of bins of ln(-score)."""

_NOISE_SHARE: Final = (0.01, 0.999)
_PHOTONS_PER_PLACE: Final = 4
_LEAST_PLACES: Final = 32
_MOST_PLACES: Final = 4096
_STEPS: Final = (np.uint64(0xC13FA9A902A6328F), np.uint64(0x91E10DA5C79E7B1D))
"""1 / g and 1 / g^2 of 2^64, g being the plastic number, g^3 = g + 1."""
_HALF: Final = np.uint64(32)


@dataclass(frozen=True, slots=True)
class Assessed:
    """What is known of the photons of a window and of its cells."""

    score: NDArray[np.float32]  #: (n,): mean ln P(noise).
    signal: NDArray[np.bool_]  #: (n,): those labelled signal.
    ground: NDArray[np.bool_]  #: (n,): those that the ground is sought among.
    cell: NDArray[np.int64]  #: (n,): cell of each photon, rows of what follows.
    index: NDArray[np.int64]  #: (c,): number of each cell.
    level: NDArray[np.int64]  #: (c,): its water surface [quanta]; ``NO_WATER`` for none.
    gate_m: NDArray[np.float64]  #: (c,): length of the gate [m].
    expected: NDArray[np.float64]  #: (c,): noise photons expected [count].
    false: NDArray[np.float64]  #: (c,): those of them expected among the signal [count].


class _Points(NamedTuple):
    """Photons, or strewn points where one may be."""

    box: NDArray[np.int64]
    slope: NDArray[np.float64]
    area_m2: NDArray[np.float64]  #: Area that each represents; empty for photons.


class _Found(NamedTuple):
    """What one shape of neighbourhood finds."""

    score: NDArray[np.float64]
    above: NDArray[np.float64]  #: ln(-score) of each photon.
    other: NDArray[np.float64]  #: The same of each strewn point.
    field: NDArray[np.float64]  #: (cells, heights): noise density [1/m2].
    each: NDArray[np.float64]  #: Noise photons that each point represents.


@dataclass(frozen=True, slots=True)
class _Seen:
    """Neighbours by one shape."""

    photons: _Points
    strewn: _Points
    boxes: Boxes  #: What noise is counted in.
    near: NDArray[np.float64]  #: (n, K): logarithms of areas, of photons.
    empty: NDArray[np.float64]  #: (q, K): of strewn points.
    reach_m2: float  #: Area within the reach.
    table: Ratios

    def agreed(self, field: NDArray[np.float64], surface: NDArray[np.int64]) -> _Found:
        """Scores and noise, repeated from a first field until they agree."""
        total = 0.0
        for turn in range(_ROUNDS):
            here, there = (field.reshape(-1)[side.box] for side in (self.photons, self.strewn))
            each = there * self.strewn.area_m2
            part = np.clip(each.sum() / len(here), *_NOISE_SHARE)
            table = with_prior(self.table, float(np.log((1.0 - part) / part)))
            score = noise_posterior(self.near, self.reach_m2, here, table)
            other = noise_posterior(self.empty, self.reach_m2, there, table)
            above, beside = (
                np.clip(np.log(np.maximum(-values, 1e-9)), _BINS[0], _BINS[-2])
                for values in (score, other)
            )
            found = _Found(score, above, beside, field, each)
            total, before = float(each.sum()), total
            if abs(total - before) <= _AGREED * total:
                break
            if turn < _ROUNDS - 1:
                field = density(*self._unexplained(found), surface)
        return found

    def _unexplained(self, found: _Found) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Photons that are noise, and the area where one would be, (cells, heights) each [m2]."""
        # The score below which most of the noise lies.
        count = np.cumsum(np.histogram(found.other, _BINS, weights=found.each)[0])
        sure = _BINS[1 + np.searchsorted(count, _SURE_NOISE * count[-1])]
        low, empty = found.above < sure, found.other < sure
        area_m2 = self.boxes.table(self.strewn.box[empty], self.strewn.area_m2[empty])
        return self.boxes.table(self.photons.box[low]), area_m2

    def below_water(self, field: NDArray[np.float64], surface: NDArray[np.int64]) -> _Found:
        """The same with noise of its own below water, which falls with depth."""
        found = self.agreed(field, surface)
        field = below_water(found.field, *self._unexplained(found), surface)
        return found._replace(each=field.reshape(-1)[self.strewn.box] * self.strewn.area_m2)


def assess(
    along: NDArray[np.int64],
    height: NDArray[np.int32],
    cell_m: float,
    settings: SignalSettings,
    photons_factor: float,
) -> Assessed:
    """Signal and noise in a window and its margin.

    ``along``, ``height``: photons in order along the track; one at least [quanta]. ``cell_m``:
    length of a cell of the absolute grid [m]. ``photons_factor``: photons that the ground is sought
    among, over those of signal.
    """
    size = round(cell_m * QUANTA_PER_M)
    start = int(along[0]) // size
    cells = int(along[-1]) // size - start + 1
    cell = along // size - start
    x_m, z_m = (along - start * size) / QUANTA_PER_M, height / QUANTA_PER_M
    low_m, high_m = gate(cell, z_m, cells)
    boxes = Boxes(z_m, cells)
    lean = leaning(x_m, z_m - boxes.low_m, np.searchsorted(cell, np.arange(cells + 1)), cell_m)

    def slopes(cell: NDArray[np.int64], z_m: NDArray[np.float64]) -> NDArray[np.float64]:
        layer = ((z_m - boxes.low_m) // LAYER_M).astype(np.int64)
        found: NDArray[np.float64] = SLOPES[lean[cell, np.clip(layer, 0, lean.shape[1] - 1)]]
        return found

    photons = _Points(boxes.of(cell, z_m), slopes(cell, z_m), np.empty(0))
    count = np.bincount(cell, minlength=cells)
    # Cells without photons may lie beyond the beam's ends, and between its pieces.
    gate_m = np.where(count > 0, high_m - low_m, 0.0)
    at, strewn_x, strewn_z, share = _strewn(start, count, low_m, gate_m, cell_m)
    strewn = _Points(boxes.of(at, strewn_z), slopes(at, strewn_z), share)
    known, seen = columns(x_m, z_m), []
    for form in settings.shapes:
        shape = form.neighbours, form.aspect, settings.reach_m
        near = log_areas(known, (x_m, z_m), photons.slope, shape, own=True)
        empty = log_areas(known, (strewn_x, strewn_z), strewn.slope, shape, own=False)
        table = ratios(form.neighbours, settings.contrast_max)
        reach_m2 = np.pi * settings.reach_m**2 / form.aspect
        seen.append(_Seen(photons, strewn, boxes, near, empty, reach_m2, table))
    dry = np.full(cells, -1)
    field = _FIRST * density(boxes.table(photons.box), boxes.table(strewn.box, share), dry)
    tried = [one.agreed(field, dry) for one in seen]
    every = np.ones(len(x_m), np.bool_), np.ones(len(at), np.bool_)
    best = _best(tried, *every, photons_factor)
    kept = best.found.above >= best.least
    index = np.arange(start, start + cells)
    level = water_levels(cell[kept], height[kept], index, cell_m)
    groups = [every]
    if (level != NO_WATER).any():
        row = boxes.of(np.zeros(cells, np.int64), level / QUANTA_PER_M)
        surface = np.where(level != NO_WATER, row, -1)
        tried = [
            one.below_water(before.field, surface) for one, before in zip(seen, tried, strict=True)
        ]
        mine, there = (
            (level[c] != NO_WATER) & (z < level[c] / QUANTA_PER_M - SURFACE_M)
            for c, z in ((cell, z_m), (at, strewn_z))
        )
        best = _best(tried, mine, there, photons_factor)
        floor = int(np.count_nonzero(best.found.above[mine] >= best.least))
        if stands_out(floor, best.found.each[there & (best.found.other >= best.least)].sum()):
            groups = [(mine, there), (~mine, ~there)]
    score, signal, ground = (np.empty(len(x_m), dtype) for dtype in (np.float32, bool, bool))
    each, passed = np.empty(len(at)), np.empty(len(at), np.bool_)
    for mine, there in groups:
        best = _best(tried, mine, there, photons_factor)
        score[mine] = best.found.score[mine]
        signal[mine] = best.found.above[mine] >= best.least
        ground[mine] = best.found.above[mine] >= best.least_ground
        each[there] = best.found.each[there]
        passed[there] = best.found.other[there] >= best.least
    return Assessed(
        score=score,
        signal=signal,
        ground=signal | ground,
        cell=cell,
        index=index,
        level=level,
        gate_m=gate_m,
        expected=np.bincount(at, each, cells).astype(np.float64),
        false=np.bincount(at, each * passed, cells).astype(np.float64),
    )


def stands_out(kept: int, noise: float) -> bool:
    """Whether so many photons are more than clumps of the noise expected among them."""
    return bool(kept - noise >= _SURE_SD * (_CLUMP * (noise + 1.0)) ** 0.5)


def _strewn(
    start: int,
    count: NDArray[np.int64],
    low_m: NDArray[np.float64],
    gate_m: NDArray[np.float64],
    cell_m: float,
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Cell of each point, where it lies along the track and in height [m], and its area [m2]."""
    many = np.clip(count // _PHOTONS_PER_PLACE, _LEAST_PLACES, _MOST_PLACES)
    many = np.where(count > 0, many, 0)
    cell = np.repeat(np.arange(len(count)), many)
    inside = np.arange(len(cell)) - np.repeat(np.cumsum(many) - many, many)
    # Unsigned products wrap around: the sequence modulo 1, to 2^-32.
    number = ((start + cell) * _MOST_PLACES + inside).astype(np.uint64)
    along, up = (((number * step) >> _HALF) / 2.0**32 for step in _STEPS)
    area_m2 = gate_m * cell_m / np.maximum(many, 1)
    return cell, (cell + along) * cell_m, low_m[cell] + up * gate_m[cell], area_m2[cell]


class _Best(NamedTuple):
    """The shape with the largest F1 to be expected, and its thresholds."""

    f1: float
    least: float
    least_ground: float
    found: _Found


def _best(
    tried: list[_Found],
    photons: NDArray[np.bool_],
    strewn: NDArray[np.bool_],
    photons_factor: float,
) -> _Best:
    """Shape and thresholds of some photons, by the strewn points among them."""
    each = [
        _Best(
            *_threshold(one.above[photons], one.other[strewn], one.each[strewn], photons_factor),
            one,
        )
        for one in tried
    ]
    return max(each, key=lambda one: one.f1)


def _threshold(
    photons: NDArray[np.float64],
    strewn: NDArray[np.float64],
    noise: NDArray[np.float64],
    photons_factor: float,
) -> tuple[float, float, float]:
    """F1 to be expected, the score where it is largest, and that of the ground's photons.

    Of the photons above a score those are signal that are not expected to be noise; of all, most
    that are so above any score. F1 is twice the signal taken over photons taken and all signal.
    """
    above = np.cumsum(np.histogram(photons, _BINS)[0][::-1])
    below = np.cumsum(np.histogram(strewn, _BINS, weights=noise)[0][::-1])
    wanted = max(float((above - below).max()), 1.0)
    signal = np.clip(above - below, 0.0, wanted)
    f1 = 2.0 * signal / (above + wanted)
    best = int(f1.argmax())
    more = int(np.searchsorted(above, photons_factor * max(wanted, float(above[best])), "right"))
    edges = _BINS[::-1][1:]
    return float(f1[best]), float(edges[best]), float(edges[max(min(more, len(edges)) - 1, best)])
