"""Noise of a window: a density smooth along the track and in height, over the gate of each cell.

Noise density is what photons that no surface explains have, over the area where a photon would be
one of them: both are taken from the same scores, so a surface adds to neither. It is the mean of
the track around, nearer by nearer, times how much more or less lies at a height. Each step is
believed as far as it has photons (a gamma prior of the step before).
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.optimize import isotonic_regression

BOX_M: Final = 2.0
"""Height of a box that photons are counted in [m]."""

_MOST_BOXES: Final = 4096
_LONE: Final = 2
"""Photons of a cell in 5 m of height that noise may be, at most, or as many as the mean of its
heights where that is more: by day there are dozens [count]."""

_GATE_PHOTONS: Final = 30
"""Such photons that show how far a gate reaches [count]."""

_REACHES: Final = (64, 32, 16, 8, 4, 2, 1, 0)
"""Cells to each side that are asked for a gate: the fewest in which enough is seen [count]."""

_GATE_LEAST_M: Final = 4.0
_PLACES: Final = (50, 15, 5)
"""Cells to each side that have one noise, nearer by nearer [count]."""

_PROFILE_CELLS: Final = 50
_PROFILE_BOXES: Final = 10
"""Cells and boxes to each side over which noise is smooth by height [count]."""

_BELIEF: Final = 10.0
"""Photons that the step before is worth [count]."""


def gate(
    cell: NDArray[np.int64], z_m: NDArray[np.float64], cells: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Lower and upper end of the heights that each cell records, (c,) each [m].

    As far as photons around show them; ``cell``: of each photon, from 0.
    """
    low, high = np.full(cells, np.inf), np.full(cells, -np.inf)
    np.minimum.at(low, cell, z_m)
    np.maximum.at(high, cell, z_m)

    def ends(reach: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        size = 2 * reach + 1
        lowest: NDArray[np.float64] = ndimage.minimum_filter1d(low, size, mode="nearest")
        return lowest, ndimage.maximum_filter1d(high, size, mode="nearest")

    widest, *narrower = _REACHES
    low_m, high_m = ends(widest)
    key = cell * (1 << 32) + np.floor(z_m / 5.0).astype(np.int64)
    _, inverse, times = np.unique(key, return_inverse=True, return_counts=True)
    mean = 5.0 * np.bincount(cell)[cell] / np.maximum(high_m - low_m, 5.0)[cell]
    lone = np.bincount(cell, times[inverse] <= np.maximum(_LONE, mean), cells).astype(np.float64)
    for reach in narrower:
        seen = around(lone, reach) >= _GATE_PHOTONS
        lowest, highest = ends(reach)
        low_m, high_m = np.where(seen, lowest, low_m), np.where(seen, highest, high_m)
    # Far from any photon there is no gate to speak of.
    low_m = np.where(np.isfinite(low_m), low_m, 0.0)
    high_m = np.where(np.isfinite(high_m), high_m, 0.0)
    return low_m, np.maximum(high_m, low_m + _GATE_LEAST_M)


def around(values: NDArray[np.float64], reach: int) -> NDArray[np.float64]:
    """Sums over ``reach`` cells to each side, (c,) float64."""
    sums: NDArray[np.float64] = ndimage.convolve1d(values, np.ones(2 * reach + 1), mode="constant")
    return sums


class Boxes:
    """Boxes of cell and height, and the noise in each."""

    def __init__(self, z_m: NDArray[np.float64], cells: int) -> None:
        self.low_m = float(np.floor(z_m.min(initial=0.0) / BOX_M) * BOX_M)
        span_m = float(z_m.max(initial=0.0)) - self.low_m
        self.box_m = BOX_M * max(1.0, np.ceil(span_m / BOX_M / _MOST_BOXES))
        self.shape = cells, int(span_m // self.box_m) + 1

    def of(self, cell: NDArray[np.int64], z_m: NDArray[np.float64]) -> NDArray[np.int64]:
        """Box of each photon or point, (n,) int64."""
        height = ((z_m - self.low_m) // self.box_m).astype(np.int64)
        boxes: NDArray[np.int64] = cell * self.shape[1] + np.clip(height, 0, self.shape[1] - 1)
        return boxes

    def table(
        self, box: NDArray[np.int64], weight: NDArray[np.float64] | None = None
    ) -> NDArray[np.float64]:
        """Sums by box, (cells, heights) float64."""
        size = self.shape[0] * self.shape[1]
        return np.bincount(box, weight, size).astype(np.float64).reshape(self.shape)


def density(
    counts: NDArray[np.float64], area_m2: NDArray[np.float64], surface: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Noise density of each box, (cells, heights) float64 [1/m2]: by itself in air and in water.

    ``counts``, ``area_m2``: photons that are noise, and area in which a photon would be, of each
    box; ``surface``: (cells,), box of the water surface of each cell, -1 for none.
    """
    along = _by_cell(counts, area_m2)
    wet = surface[:, None] >= 0
    below = wet & (np.arange(counts.shape[1]) <= surface[:, None])
    medium = wet + below.astype(np.int64)
    found = np.empty(counts.shape)
    for one in np.unique(medium).tolist():
        mine = medium == one
        seen, expected = (
            _sums(np.where(mine, values, 0.0), _PROFILE_CELLS, _PROFILE_BOXES)
            for values in (counts, area_m2 * along)
        )
        np.copyto(found, along * (seen + _BELIEF) / (expected + _BELIEF), where=mine)
    return found


def below_water(
    field: NDArray[np.float64],
    counts: NDArray[np.float64],
    area_m2: NDArray[np.float64],
    surface: NDArray[np.int64],
) -> NDArray[np.float64]:
    """The field with noise that falls with depth below water, (cells, heights) float64 [1/m2].

    What lies below a bright surface is light that came back late: the less, the deeper one looks.
    The density that counts fit best so is their isotonic regression (R. Barlow et al., Statistical
    Inference under Order Restrictions, 1972). ``field`` and the rest as of :func:`density`.
    """
    along = _by_cell(counts, area_m2)
    at = surface[:, None] - np.arange(counts.shape[1])
    seen, expected = (
        _sums(np.where(at >= 0, np.take_along_axis(values, np.maximum(at, 0), 1), 0.0),
              _PROFILE_CELLS, 0)
        for values in (counts, area_m2 * along)
    )  # fmt: skip
    found = field.copy()
    for cell in np.flatnonzero(surface >= 0).tolist():
        weight = expected[cell] + 1.0
        falling = isotonic_regression((seen[cell] + 1.0) / weight, weights=weight, increasing=False)
        top = int(surface[cell])
        found[cell, : top + 1] = along[cell] * falling.x[top::-1]
    return found


def _by_cell(counts: NDArray[np.float64], area_m2: NDArray[np.float64]) -> NDArray[np.float64]:
    """Noise density of each cell, nearer by nearer, (cells, 1) float64 [1/m2]."""
    each, length = counts.sum(axis=1), area_m2.sum(axis=1)
    along = np.full(len(each), (each.sum() + 1.0) / (length.sum() + 1.0))
    for reach in _PLACES:
        believed = 2.0 * _BELIEF
        along = (around(each, reach) + believed) / (around(length, reach) + believed / along)
    return along[:, None]


def _sums(values: NDArray[np.float64], cells: int, boxes: int) -> NDArray[np.float64]:
    """Sums over so many cells and boxes to each side, (cells, heights) float64."""
    out = values
    for axis, size in enumerate((2 * cells + 1, 2 * boxes + 1)):
        out = ndimage.uniform_filter1d(out, size, axis, mode="constant") * size
    return out
