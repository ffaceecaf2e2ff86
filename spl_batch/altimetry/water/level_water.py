"""Level water along the track, and the noise below it.

A bright water surface lends the depths below it 10 to 100 times the noise of the air above: light
scattered in the water and photons that the detector gives late. One density for all heights calls
that noise signal, so below a surface it is counted by depth.

A surface shows itself by being level: the fullest metre of height is the same one in many cells.
No kind of ground but a plain is like that, and below a plain there is nothing to be found either
way. Nothing above the surface changes: canopies are not touched.

What is a layer of its own below the surface, a floor, is no noise: boxes that hold more than the
depths around them, with what is beside them along the track, are left out, and so are those of a
floor that slopes or rolls (:mod:`spl_batch.altimetry.water.rolling_floor`,
:mod:`spl_batch.altimetry.water.leaning_floor`). Of the rest the density by depth is taken that
never grows (:mod:`spl_batch.altimetry.water.column_noise`).
"""

import math
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from spl_batch.altimetry.water.between_banks import above_rivers, between_banks
from spl_batch.altimetry.water.column_noise import falling_density
from spl_batch.altimetry.water.emptiest import Photons, emptiest_band, sums_around
from spl_batch.altimetry.water.faint_surface import CLEAR, faint_surface
from spl_batch.altimetry.water.layers_of_cells import LEAST_CELLS, agreed, common_metre, fullest
from spl_batch.altimetry.water.leaning_floor import Below, depths_of, leaning_floor
from spl_batch.altimetry.water.levelness import is_water
from spl_batch.altimetry.water.rolling_floor import emptier_boxes, standing_out
from spl_batch.altimetry.water.rough_surface import lit_below, rough_land, roughness, smooth_sums
from spl_batch.altimetry.water.surface_height import heights_of, piece_of
from spl_batch.altimetry.water.trees_over import grown_over
from spl_batch.constants import QUANTA_PER_M

NO_WATER: Final = np.iinfo(np.int32).min
"""Level of a cell that shows no water surface."""

DEPTHS: Final = 60
"""Metres of depth that noise is told apart by; below them it is one density [count]."""

SURFACE_M: Final = 1.0
"""Half-thickness of what counts as the surface itself, waves included [m]."""

REACH_CELLS: Final = 25
"""Cells to each side that a level and its noise are seen over [count]."""

_SEEN: Final = 2
"""Photons that show a surface in a cell of a brighter floor [count]."""

_FLOOR_CELLS: Final = 2
"""Cells to each side that a floor is looked for with [count]."""

_FLOOR_DEPTHS: Final = 9
"""Depths whose median a floor stands out of [count]."""

_FLOOR_SD: Final = 3.0

_KNOWN: Final = 0.25
"""Share of a depth along a kilometre that is no floor, where its noise is counted."""

_TIMES: Final = 3
"""Times that noise is told by what the last floor found leaves [count]."""

_FLOORS: Final = 3
"""Cells around with a floor, at least, that tell water from a plain [count]."""

WAVE_M: Final = 0.3
"""Waves reach as far above a surface as below it; farther off the two are compared [m]."""

UNDER_SHARE: Final = 0.03
"""What lies just below a surface over its photons, at most: a layer of more may be a floor."""


class Water(NamedTuple):
    """What cells show of water."""

    #: (n,): height of the surface [quanta]; ``NO_WATER`` where there is none.
    level: NDArray[np.int32]
    #: (n, DEPTHS): noise by metre of depth, from the second one down [1/m2]; 0 where there is no
    #: water.
    column: NDArray[np.float32]
    first: NDArray[np.float32]  #: (n,): noise of the first metre, likewise [1/m2].
    #: (n,): height of the surface, not lowered by what lies below it [quanta].
    top: NDArray[np.int32]
    #: (n,): steps between the densest layers of cells next to each other, their median [m/m]; 1
    #: where too few are.
    slope: NDArray[np.float32]
    fullest: NDArray[np.int64]  #: (n,): middle of the densest metre [quanta].
    calm: NDArray[np.bool_]  #: (n,): whether the surface is too level for land.
    maybe: NDArray[np.bool_]  #: (n,): whether level cells between banks may be a river.
    dark: NDArray[np.bool_]  #: (n,): whether such water shows no light below: it may be a plain.
    #: (n, 2): height of a floor in the middle of the cell, and its slope [m, m/m]; NaN where none.
    floor: NDArray[np.float32]


def find_layers(
    index: NDArray[np.int64], cell: NDArray[np.intp], height: NDArray[np.int32]
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Half-metre of each cell's fullest metre, and of what may be a surface: (n,) int64 each.

    That is a layer above it where half of the cells around have one at that height, or where the
    stretch around has, though each cell hardly shows it. Where they have one deeper than any floor,
    that counts in place of the fullest. The third is the highest layer that the cell itself shows.
    """
    mode, highest, lower = fullest(cell, height, len(index))
    ground = agreed(index, mode, lower, REACH_CELLS, level=False)
    upper = agreed(index, mode, highest, REACH_CELLS, level=True)
    upper = np.maximum(upper, faint_surface(index, cell, height, mode, LEAST_CELLS))
    upper = np.where(ground < mode, ground, upper)
    return ground, upper, highest


def find_water(
    index: NDArray[np.int64],
    cell: NDArray[np.intp],
    height: NDArray[np.int32],
    layers: tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]],
    gate: tuple[NDArray[np.int32], NDArray[np.int32]],
    cell_m: float,
    inside_m: NDArray[np.float64],
) -> Water:
    """Level of the water surface and noise below it of each cell.

    Parameters
    ----------
    index : (n,) int64
        Cell numbers, in order.
    cell : (p,) intp
        Row of each photon's cell.
    height : (p,) int32
        Photons [quanta].
    layers : ((n,) int64, (n,) int64, (n,) int64)
        By :func:`find_layers`.
    gate : ((n,) int32, (n,) int32)
        Lower and upper end of each cell's gate [quanta].
    inside_m : (p,) float64
        Photons along the track, from the middle of their cells [m].
    """
    n = len(index)
    water = Water(
        np.full(n, NO_WATER, np.int32),
        np.zeros((n, DEPTHS), np.float32),
        np.zeros(n, np.float32),
        np.full(n, NO_WATER, np.int32),
        np.ones(n, np.float32),
        np.zeros(n, np.int64),
        np.zeros(n, np.bool_),
        np.zeros(n, np.bool_),
        np.zeros(n, np.bool_),
        np.full((n, 2), np.nan, np.float32),
    )
    if not n:
        return water
    mode, chosen, highest = layers
    level = _level(index, chosen, cell, height)
    half_m = QUANTA_PER_M // 2
    water.fullest[:] = mode * half_m + half_m // 2
    water.slope[:] = _slope(index, mode, cell_m)
    half = round(SURFACE_M * QUANTA_PER_M)
    piece = piece_of(inside_m, cell_m)
    level = heights_of(index, cell, height, level, level != NO_WATER, half, piece)
    over_m = (height - level[cell].astype(np.int64)) / QUANTA_PER_M
    wet = level != NO_WATER
    lit = lit_below(index, cell, over_m, wet, SURFACE_M, REACH_CELLS)
    grown = grown_over(Photons(index, cell, height), gate, level, (wet, lit), half)
    level[grown] = NO_WATER
    edges_m = WAVE_M, SURFACE_M
    level[rough_land(index, cell, over_m, level != NO_WATER, edges_m, REACH_CELLS)] = NO_WATER
    river_m, maybe = between_banks(index, cell, height, highest, cell_m)
    river = np.isfinite(river_m)
    # Where the metre that cells share is another one, it is none of the river.
    other = river & ~(np.abs(level / QUANTA_PER_M - river_m) <= WAVE_M)
    level[other] = np.rint(river_m[other] * QUANTA_PER_M)
    water.level[:] = level
    water.maybe[:] = maybe
    wet = level != NO_WATER
    if wet.any():
        column, floor = _columns(index, cell, height, gate[0], level, cell_m, inside_m)
        water.floor[:] = floor
        expected = _continued(column)
        water.top[:] = _top(cell, height, level, expected * cell_m)
        first = first_metre(index, cell, height, water.top, cell_m, column[:, 0], expected)
        water.column[wet], water.first[wet] = column[wet], first[wet]
        level_m = np.where(wet, level / QUANTA_PER_M, np.nan)
        below = chosen >= mode + CLEAR
        lit = lit_below(index, cell, over_m, wet, SURFACE_M, REACH_CELLS)
        calm = is_water(index, level_m, below, lit, cell_m, REACH_CELLS)
        water.calm[:] = river | (calm & ~above_rivers(index, level_m, river_m, REACH_CELLS))
        water.maybe[water.calm] = False
        floors = sums_around(index, np.isfinite(floor[:, :1]), REACH_CELLS)[:, 0]
        water.dark[:] = water.calm & ~river & ~lit & ~below & (floors < _FLOORS)
    return water


def _level(
    index: NDArray[np.int64],
    mode: NDArray[np.int64],
    cell: NDArray[np.intp],
    height: NDArray[np.int32],
) -> NDArray[np.int32]:
    """Height of the metre that is the fullest in many cells, of those that it is in [quanta].

    A cell whose fullest metre lies lower, a bright floor, shows the surface by some photons.
    """
    n = len(index)
    common, shared = common_metre(index, mode, REACH_CELLS)
    half = QUANTA_PER_M // 2
    inside = np.abs(height // half - common[cell]) <= 1
    there = np.bincount(cell[inside], minlength=n)
    wet = shared & ((common == mode) | ((common > mode) & (there >= _SEEN)))
    return np.where(wet, common * half + half // 2, NO_WATER).astype(np.int32)


def _slope(index: NDArray[np.int64], mode: NDArray[np.int64], cell_m: float) -> NDArray[np.float64]:
    """Median step between the densest layers of neighbouring cells around each [m/m]."""
    step = np.abs(np.diff(mode)) * (0.5 / cell_m)
    beside = np.diff(index) == 1
    first = np.searchsorted(index, index - REACH_CELLS)
    stop = np.searchsorted(index, index + REACH_CELLS, side="right")
    slope = np.ones(len(index))
    for i in range(len(index)):
        steps = step[first[i] : stop[i] - 1][beside[first[i] : stop[i] - 1]]
        if len(steps) >= LEAST_CELLS:
            slope[i] = np.median(steps)
    return slope


def _columns(
    index: NDArray[np.int64],
    cell: NDArray[np.intp],
    height: NDArray[np.int32],
    low: NDArray[np.int32],
    level: NDArray[np.int32],
    cell_m: float,
    inside_m: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Noise by depth of every cell, floors left out: (n, DEPTHS) float64 [1/m2].

    And the line of a floor in each: height in the middle and slope, (n, 2) [m, m/m].
    """
    n = len(index)
    wet = level != NO_WATER
    depth_q = level[cell].astype(np.int64) - height - round(SURFACE_M * QUANTA_PER_M)
    below = wet[cell] & (depth_q >= 0)
    row = np.minimum(depth_q[below] // QUANTA_PER_M, DEPTHS - 1)
    count = np.bincount(cell[below] * DEPTHS + row, minlength=n * DEPTHS).reshape(n, DEPTHS)
    gate_m = (level.astype(np.int64) - low) / QUANTA_PER_M - SURFACE_M
    length = np.clip(gate_m[:, None] - np.arange(DEPTHS), 0.0, 1.0)
    length[:, -1] = np.maximum(gate_m - (DEPTHS - 1), 0.0)
    area = np.where(wet[:, None], length * cell_m, 0.0)
    over_m = (height - level[cell].astype(np.int64)) / QUANTA_PER_M
    rough = roughness(index, cell, over_m, wet, (WAVE_M, SURFACE_M), REACH_CELLS)
    near = smooth_sums(index, count, rough, np.zeros(count.shape, np.bool_), _FLOOR_CELLS)
    around = ndimage.median_filter(near, size=(1, _FLOOR_DEPTHS), mode="mirror")
    # In turbid water noise grows steeply towards the surface: the first two metres hold as much as
    # those below them, seen over a kilometre, let expect.
    bright = near > around + _FLOOR_SD * np.sqrt(np.maximum(around, 1.0))
    bright = ndimage.binary_dilation(bright, np.ones((1, 3), np.bool_))
    seen = np.maximum(sums_around(index, np.where(bright, 0.0, 1.0), REACH_CELLS), 1.0)
    wide = smooth_sums(index, count, rough, bright, REACH_CELLS) * (2 * _FLOOR_CELLS + 1) / seen
    steeper = np.maximum((wide[:, 2] + 0.1) / (wide[:, 4] + 0.1), 1.0)
    around[:, 0] = np.maximum(around[:, 0], wide[:, 2] * steeper)
    around[:, 1] = np.maximum(around[:, 1], wide[:, 2] * np.sqrt(steeper))
    floor = near > around + _FLOOR_SD * np.sqrt(np.maximum(around, 1.0))
    # What lies in a metre lies in the ends of those beside it as well.
    floor[:, :-1] = ndimage.binary_dilation(floor[:, :-1], np.ones((1, 3), np.bool_))
    floor[:, -1] = False
    own = (index, count, rough, area)
    out = _without(floor, *own)
    # A floor that slopes or rolls stands out of what the emptier boxes of a kilometre show.
    lowest = emptier_boxes(index, count, area > 0.99 * cell_m, REACH_CELLS)
    expected = np.minimum(out * area, lowest)
    photons = Below(index, cell[below], inside_m[below], depth_q[below] / QUANTA_PER_M)
    line = np.full((n, 2), np.nan)
    for _ in range(_TIMES):
        expected[:, : rough.shape[1]] += rough
        left = floor.copy()
        left[:, :-1] |= standing_out(count[:, :-1], expected[:, :-1], area[:, :-1] > 0.0)
        line = leaning_floor(photons, expected[:, :-1], cell_m)
        left[:, :-1] |= depths_of(line, DEPTHS - 1, cell_m)
        out = _without(left, *own)
        expected = out * area
    top_m = level / QUANTA_PER_M - SURFACE_M
    return out, np.stack([top_m - line[:, 0], -line[:, 1]], axis=1)


def _without(
    floor: NDArray[np.bool_],
    index: NDArray[np.int64],
    count: NDArray[np.int64],
    rough: NDArray[np.float64],
    area: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Noise by depth of a kilometre without the boxes of a floor, (n, DEPTHS) float64 [1/m2]."""
    out = np.zeros(count.shape)
    left = sums_around(index, np.where(floor, 0.0, area), REACH_CELLS)
    # What a floor leaves of a depth along a kilometre is its edges: the depths beside it tell.
    known = left >= _KNOWN * sums_around(index, area, REACH_CELLS)
    seen = smooth_sums(index, count, rough, floor, REACH_CELLS)
    falling_density(np.where(known, seen, 0.0), np.where(known, left, 0.0), out)
    return out


def _continued(column: NDArray[np.float64]) -> NDArray[np.float64]:
    """Noise of the first metre of water as that below it lets expect, (n,) float64 [1/m2]."""
    steeper = np.maximum(column[:, 0], 1e-12) / np.maximum(column[:, 1], 1e-12)
    expected: NDArray[np.float64] = column[:, 0] * np.clip(steeper, 1.0, math.e)
    return expected


def _top(
    cell: NDArray[np.intp],
    height: NDArray[np.int32],
    level: NDArray[np.int32],
    noise: NDArray[np.float64],
) -> NDArray[np.int32]:
    """The levels, or the median of each cell's surface less its noise where that is higher.

    What lies below a surface lowers both: scattered light the mean, a brighter floor the median.

    Parameters
    ----------
    noise : (n,) float64
        Photons of it in the first metre of each cell [count].
    """
    top = level.copy()
    near = np.abs(height.astype(np.int64) - level[cell]) <= round(SURFACE_M * QUANTA_PER_M)
    near &= level[cell] != NO_WATER
    order = np.lexsort((height[near], cell[near]))
    count = np.bincount(cell[near], minlength=len(level))
    some = count > 0
    above = np.clip((count - np.rint(noise).astype(np.int64)) // 2, 0, count - 1)
    top[some] = height[near][order][(np.cumsum(count) - 1 - above)[some]]
    return np.maximum(level, top)


def first_metre(
    index: NDArray[np.int64],
    cell: NDArray[np.intp],
    height: NDArray[np.int32],
    top: NDArray[np.int32],
    cell_m: float,
    deeper: NDArray[np.float64],
    expected: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Noise of the first metre of water, which the surface and its waves hide: (n,) [1/m2].

    Waves rise as far as they fall, so what more lies below the surface than above it is none of
    theirs. That is noise as far as the water below lets expect it, or as it is a small share of
    the surface. A layer of more may be a floor. Then the water below tells, or the emptiest band
    between surface and floor where that holds more.

    Parameters
    ----------
    top : (n,) int32
        Surface [quanta]; ``NO_WATER`` where there is none.
    deeper, expected : (n,) float64
        Noise of the second metre, and of the first as those below let expect [1/m2].
    """
    n = len(top)
    wet = top != NO_WATER
    depth_m = (top[cell].astype(np.int64) - height) / QUANTA_PER_M
    over = ((-SURFACE_M, -WAVE_M), (-2.0 * SURFACE_M, -SURFACE_M))
    bands = ((WAVE_M, SURFACE_M), *over, (-SURFACE_M, SURFACE_M))
    counted = [
        np.bincount(cell[wet[cell] & (depth_m > low) & (depth_m <= high)], minlength=n)
        for low, high in bands
    ]
    below, above, sky, surface = sums_around(index, np.stack(counted, axis=1), REACH_CELLS).T
    high_m = SURFACE_M - WAVE_M
    area = np.maximum(sums_around(index, wet[:, None] * cell_m, REACH_CELLS)[:, 0], cell_m)
    found = ((below - above) / high_m + sky / SURFACE_M) / area
    most = np.maximum(expected, UNDER_SHARE * surface / high_m / area)
    known_m = np.where(wet[cell], depth_m, 0.0)
    between = emptiest_band(index, cell, known_m, (WAVE_M, SURFACE_M), REACH_CELLS)
    between += sky / SURFACE_M
    least = np.maximum(expected, np.minimum(between / area, most))
    first: NDArray[np.float64] = np.where(found <= most, np.maximum(found, deeper), least)
    return first
