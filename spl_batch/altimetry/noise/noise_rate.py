"""Noise rate along the track and the axis that it scales [W17 4.1.1, Eq. 4.1].

Everything lies on cells of an absolute along-track grid and is a function of the photons
of a cell and its neighbours, so no cut of the track can change it.

The empty window of the source is "the top or the bottom part of the vertical data profile".
A gate that follows the terrain leaves a few hundred metres, so the window here is all of
the gate that is farther than a buffer from the surface: the fullest three bins of height of
a cell and its two neighbours (as the first step of DCC does, [W17] 3.2.3), the median of
which over five cells passes over a bin that noise filled.
"""

from collections.abc import Callable, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from spl_batch.altimetry.noise.crowding import CROWD_CELLS, LONGEST_CELLS, crowded_slope
from spl_batch.altimetry.noise.empty_window import empty_window
from spl_batch.altimetry.noise.fog import BINS, JOINED_CELLS, find_fog, fog_at, outside
from spl_batch.altimetry.noise.gate import STRETCH_CELLS, gates, stretches
from spl_batch.altimetry.noise.layers_above import BIN_M, GROUND_CELLS, PATCH_CELLS, above, foot
from spl_batch.altimetry.noise.mist import find_mist, hidden
from spl_batch.altimetry.noise.neighbourhoods import aspects, neighbours
from spl_batch.altimetry.noise.noise_at import local_column
from spl_batch.altimetry.noise.planes import CAP_UNITS, UNIT_M, median_noise, usual_noise
from spl_batch.altimetry.noise.windows import of_window
from spl_batch.altimetry.photon_table import Background, Cells, Scale
from spl_batch.altimetry.settings import RateSettings, SignalSettings
from spl_batch.altimetry.water.between_banks import BANK_CELLS
from spl_batch.altimetry.water.between_banks import MOST_CELLS as MOST_RIVER_CELLS
from spl_batch.altimetry.water.emptiest import Photons, sums_around
from spl_batch.altimetry.water.faint_surface import BLOCK_CELLS
from spl_batch.altimetry.water.leaning_floor import bed
from spl_batch.altimetry.water.level_water import (
    DEPTHS,
    NO_WATER,
    REACH_CELLS,
    SURFACE_M,
    find_layers,
    find_water,
)
from spl_batch.altimetry.water.levelness import SWELL_CELLS
from spl_batch.altimetry.water.trees_over import WOOD_CELLS
from spl_batch.constants import QUANTA_PER_M
from spl_batch.lattice.tiles import quanta

HALO_CELLS: Final = (
    CROWD_CELLS
    + LONGEST_CELLS
    + JOINED_CELLS
    + GROUND_CELLS
    + 3 * REACH_CELLS
    + 2 * (PATCH_CELLS + REACH_CELLS + WOOD_CELLS)
    + 3 * STRETCH_CELLS
    + 2 * BLOCK_CELLS
    + 3 * (REACH_CELLS + 1)
    + SWELL_CELLS
    + MOST_RIVER_CELLS
    + 2 * (BANK_CELLS + 1)
    + 2 * REACH_CELLS
    + 1
)
"""Cells to each side that :func:`observe` looks at [count]."""

NOTHING_SEEN: Final = 3.0
"""Upper 95 % bound of what is expected where nothing is counted [count]."""

WINDOW_LEAST_M: Final = 4.0
"""Least gate away from a surface: no noise there tells of so much of it [m]."""


def observe(along: NDArray[np.int64], height: NDArray[np.int32], settings: RateSettings) -> Cells:
    """Count the photons of each cell, find the surface, and count what is away from it.

    Parameters
    ----------
    along : (n,) int64
        Along-track distance [quanta].
    height : (n,) int32
        Height [quanta].

    Returns
    -------
    Cells
        Right where :data:`HALO_CELLS` cells to each side are given too.
    """
    size, bin_q = quanta(settings.cell_m), quanta(settings.slice_m)
    index, cell, count = np.unique(along // size, return_inverse=True, return_counts=True)
    bins = height // bin_q
    base = int(bins.min(initial=0))
    width = int(bins.max(initial=0)) - base + 1
    table = np.bincount(cell * width + (bins - base), minlength=len(index) * width)
    table = table.reshape(len(index), width)
    peak = _surface(index, table)
    inside_m = (along - index[cell] * size - size // 2) / QUANTA_PER_M
    layers = find_layers(index, cell, height)
    middle = (peak + base) * bin_q + bin_q // 2
    # A level floor may be brighter than the surface above it.
    upper = np.maximum(middle, layers[1] * (QUANTA_PER_M // 2))
    low, high = gates(index, cell, height, (middle, upper), settings)
    noise = _usual(index, table, [end / bin_q - base for end in (low, high)])
    ground = foot(index, cell, height, layers[0], noise)
    photons, cell_m = (index, cell, height), settings.cell_m
    over = above(*photons, (ground.quanta, ground.known), (low, high), cell_m)
    fog = find_fog(over, ground)
    mist = find_mist(over, fog)
    if not ground.near.all():
        over = above(*photons, hidden(index, layers[0], ground), (low, high), cell_m)
        mist = np.where(mist[:, 2:] > 0.0, mist, find_mist(over, fog))
    clear = outside(cell, height, fog)
    if len(clear) < len(cell):
        cell, height, inside_m = cell[clear], height[clear], inside_m[clear]
        along = along[clear]
        table = np.bincount(cell * width + (height // bin_q - base), minlength=table.size)
        table = table.reshape(len(index), width)
        peak = _surface(index, table)
        layers = find_layers(index, cell, height)
    water = find_water(index, cell, height, layers, (low, high), settings.cell_m, inside_m)
    wet = water.level != NO_WATER
    peak = np.where(wet, water.level // bin_q - base, peak)
    middle = (peak + base) * bin_q + bin_q // 2
    surface = np.where(wet, water.level, middle)
    window = Photons(index, cell, height), (low, high), surface, wet, fog, settings
    empty_count, empty_length = empty_window(*window)
    empty = empty_count, empty_length / QUANTA_PER_M * cell_m
    gate_m2 = (high.astype(np.int64) - low) / QUANTA_PER_M * cell_m
    crowded = crowded_slope(index, (along, cell, height), empty, gate_m2, cell_m)
    return Cells(
        index=index,
        count=count.astype(np.int64),
        low=low,
        high=high,
        peak=middle.astype(np.int32),
        empty_count=empty_count,
        empty_length=empty_length,
        level=water.level,
        column=water.column,
        first=water.first,
        top=water.top,
        calm=water.calm,
        maybe=water.maybe,
        dark=water.dark,
        slope=np.minimum(water.slope, crowded),
        fog_low=fog.low,
        fog=fog.density,
        mist=mist,
        floor=water.floor,
    )


def _usual(
    index: NDArray[np.int64],
    table: NDArray[np.int64],
    gate: Sequence[NDArray[np.float64]],
) -> NDArray[np.float64]:
    """Photons of each cell if its gate held no more anywhere than in its emptiest quarter.

    Parameters
    ----------
    gate : ((n,) float64, (n,) float64)
        Ends of the gate [bins of the table].
    """
    low, high = gate
    bins = np.arange(table.shape[1])
    whole = (bins >= low[:, None]) & (bins + 1 <= high[:, None])
    around = sums_around(index, table, PATCH_CELLS)
    cells = sums_around(index, np.ones((len(index), 1)), PATCH_CELLS)
    each = np.where(whole, around / np.maximum(cells, 1.0), np.inf)
    middle = np.take_along_axis(np.sort(each, axis=1), (whole.sum(axis=1) // 4)[:, None], axis=1)
    found: NDArray[np.float64] = np.where(whole.sum(axis=1) > 2, middle[:, 0], 0.0) * (high - low)
    return found


def _surface(index: NDArray[np.int64], table: NDArray[np.int64]) -> NDArray[np.int64]:
    """Bin of the surface of each cell."""
    around = _neighbours(index, lambda at: table[at])
    total = np.sum(around, axis=0)
    if not len(total):
        return np.zeros(0, np.int64)
    three = ndimage.convolve1d(total, np.ones(3, np.int64), axis=1, mode="constant")
    best = three.argmax(1)
    # Missing neighbours repeat the cell itself, so that the median stays among real ones.
    steps = np.stack(_neighbours(index, lambda at: best[at], reach=2, missing=best))
    middle: NDArray[np.int64] = np.sort(steps, axis=0)[2]
    return middle


def _neighbours(
    index: NDArray[np.int64],
    values: Callable[[NDArray[np.intp]], NDArray[np.int64]],
    reach: int = 1,
    missing: NDArray[np.int64] | None = None,
) -> list[NDArray[np.int64]]:
    """Values of the cells at -reach..reach from each cell; zero or ``missing`` for absent ones."""
    found = []
    for step in range(-reach, reach + 1):
        at = np.clip(np.searchsorted(index, index + step), 0, max(len(index) - 1, 0))
        there = index[at] == index + step
        value = values(at)
        other = np.zeros_like(value) if missing is None else missing
        found.append(np.where(there if value.ndim == 1 else there[:, None], value, other))
    return found


def far(
    along: NDArray[np.int64], height: NDArray[np.int32], cells: Cells, settings: RateSettings
) -> NDArray[np.uint8]:
    """1 for photons farther than the buffer from the surface of their cell, (n,) uint8.

    Those of a cloud are none: what passes of them tells nothing of the noise elsewhere.
    """
    cell = np.searchsorted(cells.index, along // quanta(settings.cell_m))
    away = np.abs(height.astype(np.int64) - cells.peak[cell]) > quanta(settings.buffer_m)
    away &= fog_at(cell, height, cells.fog_low, cells.fog) == 0.0
    flag: NDArray[np.uint8] = away.astype(np.uint8)
    return flag


def far_length_m(cells: Cells, settings: RateSettings) -> NDArray[np.float64]:
    """Length of gate of each cell that :func:`far` speaks of, (n,) float64 [m]."""
    buffer = quanta(settings.buffer_m)
    peak = cells.peak.astype(np.int64)
    near = np.minimum(cells.high, peak + buffer) - np.maximum(cells.low, peak - buffer)
    near_m = np.maximum(near, 0) / QUANTA_PER_M + BIN_M * np.count_nonzero(cells.fog, axis=1)
    left: NDArray[np.float64] = np.maximum(cells.gate_m - near_m, 0.0)
    return left


def join(parts: Sequence[Cells]) -> Cells:
    """Cells of consecutive pieces of track."""
    columns = [part.to_arrays() for part in parts]
    return Cells(**{name: np.concatenate([c[name] for c in columns]) for name in columns[0]})


def density_from_window(cells: Cells, settings: RateSettings) -> NDArray[np.float64]:
    """Noise density from the empty window of a cell and those around it, (n,) [1/m2]."""
    cell_m = settings.cell_m
    counts = np.concatenate([[0], np.cumsum(cells.empty_count)])
    areas = np.concatenate([[0.0], np.cumsum(cells.empty_length / QUANTA_PER_M * cell_m)])
    reach, _ = stretches(cells.index, cells.empty_count, settings.smooth_cells)
    first = np.searchsorted(cells.index, cells.index - reach)
    stop = np.searchsorted(cells.index, cells.index + reach, side="right")
    area = areas[stop] - areas[first]
    count = counts[stop] - counts[first]
    expected = np.where(count > 0, count, NOTHING_SEEN)
    # Where no noise shows how far the gate reaches, what photons span is none of its length.
    area = np.where(count > 0, area, np.maximum(area, (stop - first) * cell_m * WINDOW_LEAST_M))
    density: NDArray[np.float64] = expected / area
    return density


def unseen(cells: Cells, settings: RateSettings) -> float:
    """Share of cells whose stretch shows no photon of noise at all."""
    reach, seen = stretches(cells.index, cells.empty_count, settings.smooth_cells)
    del reach
    return float(np.mean(seen == 0)) if len(seen) else 0.0


def density_from_product(
    cells: Cells, background: Background, settings: RateSettings
) -> NDArray[np.float64]:
    """Noise density that the product states, meaned over each cell, (n,) [1/m2]."""
    edges = np.stack([cells.index, cells.index + 1]) * settings.cell_m
    at = background.along_m
    step = np.diff(at)
    middle = (background.per_m2[1:] + background.per_m2[:-1]) / 2
    total = np.concatenate([[0.0], np.cumsum(middle * step)])
    inside = np.clip(edges, at[0], at[-1])
    width = inside[1] - inside[0]
    mean = np.diff(np.interp(inside, at, total), axis=0)[0] / np.where(width > 0, width, 1.0)
    here = np.interp(edges.mean(0), at, background.per_m2)
    density: NDArray[np.float64] = np.where(width > 0, mean, here)
    return density


def density_from_both(
    cells: Cells, background: Background, settings: RateSettings, window_m: float
) -> NDArray[np.float64]:
    """How the product's rate varies, at the level of the empty window, (n,) [1/m2].

    A product counts in another window than the gate, in other units and through other
    corrections; a few per cent too much noise is a third of a weak signal.
    """
    stated = density_from_product(cells, background, settings)
    empty_m2 = cells.empty_length / QUANTA_PER_M * settings.cell_m
    counted = np.stack([cells.empty_count.astype(np.float64), stated * empty_m2])
    at, sums = of_window(cells.index, counted, settings, window_m)
    seen, expected = sums[:, at]
    return stated * np.where(expected > 0, seen / np.where(expected > 0, expected, 1.0), 1.0)


def scale(
    cells: Cells,
    density: NDArray[np.float64],
    rate: RateSettings,
    signal: SignalSettings,
) -> Scale:
    """What neighbourhoods of each cell follow, and the noise expected in it.

    Parameters
    ----------
    density : (n,) float64
        Noise density of each [1/m2].
    rate, signal : RateSettings, SignalSettings
        Cells; aspect, reach, and whether to scale at all.
    """
    column = local_column(cells.index, cells.level, cells.column, density)
    first = local_column(cells.index, cells.level, cells.first[:, None], density)[:, 0]
    noise, below = _expected(cells, density, column, rate)
    usual = usual_noise(cells.index, density, signal)
    return Scale(
        cells.index, usual, aspects(cells, signal), noise, below, density,
        cells.level, column, first, cells.top, cells.calm, cells.fog_low, cells.fog,
        bed(cells.index, cells.floor, rate.cell_m), neighbours(cells, density, rate, signal),
        *_mdbscan_axis(cells, density, rate, signal),
    )  # fmt: skip


def _mdbscan_axis(
    cells: Cells, density: NDArray[np.float64], rate: RateSettings, signal: SignalSettings
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Stretch of each cell on the axis of mDBSCAN, and its start: (n,) float64 [m/m, m].

    As in the source the whole beam has one; it knows no water.
    """
    reference = median_noise(density)
    dry_m = float(np.clip(1.0 / np.sqrt(reference * signal.aspect), *UNIT_M))
    least = CAP_UNITS / (dry_m * signal.reach_m)
    # By night all of the track is at the least: it keeps its length.
    normal = max(reference, least)
    wanted = density if signal.scaling else np.full(len(density), reference)
    stretch = np.maximum(wanted, least) / normal
    gap_m = np.maximum(np.diff(cells.index, prepend=cells.index[:1]) - 1, 0) * rate.cell_m
    apart = np.minimum(gap_m * least / normal, 2 * CAP_UNITS / (normal * dry_m))
    lengths = np.concatenate([[0.0], np.cumsum(stretch * rate.cell_m)[:-1]])
    return stretch, np.cumsum(apart) + lengths[: len(stretch)]


def _expected(
    cells: Cells,
    density: NDArray[np.float64],
    column: NDArray[np.float32],
    rate: RateSettings,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Noise photons expected in each cell, and those below a water surface: (n,) float64."""
    wet = cells.level != NO_WATER
    surface = np.where(wet, cells.level, cells.low).astype(np.int64)
    surface = surface - np.where(wet, round(SURFACE_M * QUANTA_PER_M), 0)
    above = np.clip(cells.high - surface, 0, None) / QUANTA_PER_M
    gate_m = np.maximum(surface - cells.low, 0) / QUANTA_PER_M
    length = np.clip(gate_m[:, None] - np.arange(DEPTHS), 0.0, 1.0)
    length[:, -1] = np.maximum(gate_m - (DEPTHS - 1), 0.0)
    below = (column * length).sum(axis=1)
    below = np.where(wet, below, 0.0) * rate.cell_m
    steps = cells.fog_low[:, None] / QUANTA_PER_M + BIN_M * np.arange(BINS)
    inside = np.clip(cells.high[:, None] / QUANTA_PER_M - steps, 0.0, BIN_M)
    more = (np.maximum(cells.fog - density[:, None], 0.0) * inside).sum(axis=1)
    cloud = np.where(cells.fog.any(axis=1), more, 0.0) * rate.cell_m
    return density * above * rate.cell_m + cloud + below, below
