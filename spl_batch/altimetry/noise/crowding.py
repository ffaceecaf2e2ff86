"""In neighbourhoods of which shape photons crowd, where no cell shows its ground.

The fullest metre of a cell is ground where signal is dense. Where a cell holds a few photons of it
under a bright sky, chance fills another metre, and steps between cells tell of no slope. What a
stretch shows all the same is how many photons lie by others: in boxes of one area that noise fills
alike whatever their shape. Over level ground long and low boxes hold more pairs, over steep ground
short and high ones; noise adds as many to all of them.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from spl_batch.altimetry.water.emptiest import sums_around
from spl_batch.constants import QUANTA_PER_M

CROWD_CELLS: Final = 50
"""Cells to each side whose pairs are counted [count]."""

SHAPES: Final = (3.0, 5.0, 8.0, 12.0, 20.0)
"""Lengths over heights that are compared."""

LONGEST_CELLS: Final = 6
"""Cells that the longest box is as long as [count]."""

_AREAS: Final = 6
"""Areas of boxes, each half of the one before [count]."""

_NOISE: Final = 2.0
"""Noise photons that a box holds at most, as far as there is an area for that [count]."""

_SHARE: Final = 0.9
"""Pairs of the best shape that a shorter one has to have."""


def crowded_slope(
    index: NDArray[np.int64],
    places: tuple[NDArray[np.int64], NDArray[np.intp], NDArray[np.int32]],
    empty: tuple[NDArray[np.int64], NDArray[np.float64]],
    gate_m2: NDArray[np.float64],
    cell_m: float,
) -> NDArray[np.float32]:
    """Slope up to which photons around each cell crowd in long boxes, (n,) float32 [m/m].

    One over length over height of the boxes; 1 where the shortest do best, which is no limit.

    Parameters
    ----------
    index : (n,) int64
        Cell numbers, in order.
    places : ((p,) int64, (p,) intp, (p,) int32)
        Photons along the track [quanta], rows of their cells, heights [quanta].
    empty : ((n,) int64, (n,) float64)
        Photons in the empty window of each cell, and its area [count, m2].
    gate_m2 : (n,) float64
        Area of the gate of each cell [m2].
    """
    count = np.bincount(places[1], minlength=len(index))
    values = np.stack([empty[0], empty[1], count, gate_m2], axis=1)
    dark, seen_m2, photons, whole_m2 = sums_around(index, values, CROWD_CELLS).T
    density = dark / np.maximum(seen_m2, 1.0)
    noise = np.minimum(density * whole_m2, photons)
    longest_m = LONGEST_CELLS * cell_m
    areas = longest_m**2 / SHAPES[-1] / 2.0 ** np.arange(_AREAS)
    chosen = np.minimum((density[:, None] * areas > _NOISE).sum(axis=1), _AREAS - 1)
    slope = np.ones(len(index), np.float32)
    slopes = np.array([1.0, *(1.0 / shape for shape in SHAPES[1:])])
    for level in np.unique(chosen).tolist():
        mine = chosen == level
        pairs = [_pairs(index, *places, cell_m, (float(areas[level]), s)) for s in SHAPES]
        total = sums_around(index, np.stack(pairs, axis=1), CROWD_CELLS)[mine]
        by_chance = (2.0 * photons - noise) * density * areas[level]
        more = total - by_chance[mine, None]
        best = more.max(axis=1, keepdims=True)
        enough = more >= best - (1.0 - _SHARE) * np.maximum(best, 0.0)
        slope[mine] = slopes[np.argmax(enough, axis=1)]
    return slope


def _pairs(
    index: NDArray[np.int64],
    along: NDArray[np.int64],
    cell: NDArray[np.intp],
    height: NDArray[np.int32],
    cell_m: float,
    box: tuple[float, float],
) -> NDArray[np.float64]:
    """Others in the boxes of each cell's photons, two lattices meaned: (cells,) float64 [count].

    ``box`` is the area of one [m2], and its length over its height.
    """
    area_m2, shape = box
    length = round(float(np.sqrt(area_m2 * shape)) * QUANTA_PER_M)
    step = round(float(np.sqrt(area_m2 / shape)) * QUANTA_PER_M)
    size = round(cell_m * QUANTA_PER_M)
    first, last = index * size // length, ((index + 1) * size - 1) // length
    # Boxes are numbered without those that no cell reaches into.
    gaps = np.cumsum(np.maximum(first - np.concatenate([first[:1], last[:-1]]) - 1, 0))
    at = along // length - (first[:1] + gaps)[cell]
    groups = int(at.max(initial=-1)) + 1
    total = np.zeros(len(index))
    for shift in (0, step // 2):
        row = (height + shift) // step
        lowest = np.full(groups, np.iinfo(np.int32).max, np.int32)
        highest = np.full(groups, np.iinfo(np.int32).min, np.int32)
        np.minimum.at(lowest, at, row)
        np.maximum.at(highest, at, row)
        rows = np.maximum(highest.astype(np.int64) - lowest + 1, 0)
        number = (np.cumsum(rows) - rows - lowest)[at] + row
        others = np.bincount(number)[number] - 1
        total += np.bincount(cell, others, len(index)) / 2.0
    return total
