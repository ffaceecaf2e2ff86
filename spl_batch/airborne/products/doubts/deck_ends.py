"""Ends of a bridge deck that stayed ground, while its middle was cut off.

An end that lies little above the ground passes for ground. What was cut off shows it: it goes on
level from the end, above the terrain model, without ground. The ground on both sides of an end is
lower; behind it the deck meets ground that is not, while a bank on which a road leads to a bridge
goes on. An end touches what was cut off; cells of a rim in a deck's way do not. A crest that was
cut off in its middle looks the same. Nothing is changed. Our own rule: no source has one.
"""

from collections.abc import Iterator
from typing import Final

import numpy as np
from scipy import ndimage

from spl_batch.airborne.products.doubts.raised_places import (
    Grid,
    Mask,
    RaisedPlace,
    raised_places,
)
from spl_batch.numerics.compiled import njit

DOMAIN: Final = "space"

LEVEL_M: Final = 0.5
"""What is level with an end is no farther above or below [m]."""

LEAD_M: Final = 6.0
RUN_M: Final = 4.0
"""What was cut off begins so near to each cell of an end, and is so long at least [m, m]."""

LONG: Final = 4
"""So many times that length is looked for: a deck's direction is where it goes on longest."""

ABOVE_M: Final = 1.0
"""How far it stands above the model somewhere on the way [m]."""

ASIDE_M: Final = 6.0
LOWER_M: Final = 0.5
"""Ground on both sides of an end lies so near, and so much lower [m, m]."""

BACK_M: Final = 10.0
"""So near behind an end lies ground that has none half as much lower on both sides [m]."""

LEAST_M2: Final = 1.0
"""Smaller ends are not told: a footbridge's end is often a single cell of a metre [m2]."""

DIRECTIONS: Final = 16
"""Directions of a deck that are tried [count]."""


def deck_ends(dtm: Grid, lowest: Grid, held: Mask, cell_m: float) -> Iterator[RaisedPlace]:
    """Ends of decks in a terrain model, row by row.

    Parameters
    ----------
    dtm : (rows, columns) float64
        Terrain [m]; NaN where it is void.
    lowest : (rows, columns) float64
        Height of the lowest signal [m]; NaN without any.
    held : (rows, columns) bool
        Cells with ground.
    cell_m : float
        Edge of a cell [m].
    """
    lead, run, aside, back = (
        max(round(length / cell_m), 1) for length in (LEAD_M, RUN_M, ASIDE_M, BACK_M)
    )
    with np.errstate(invalid="ignore"):
        over = ~held & (lowest - dtm >= ABOVE_M)
    near = held & ndimage.maximum_filter(over, 2 * (lead + run) + 1, mode="constant")
    above = np.zeros(dtm.shape)
    _measure(dtm, lowest, held, near, lead, run, aside, back, above)
    with np.errstate(invalid="ignore"):
        cut_off = ~held & (lowest - dtm >= LEVEL_M)
    beside = ndimage.binary_dilation(cut_off, np.ones((3, 3), np.bool_))
    for end in raised_places(above, above > 0.0, cell_m):
        if end.area_m2 >= LEAST_M2 and beside[end.cells[0], end.cells[1]].any():
            yield end


@njit()
def _measure(
    dtm: Grid, lowest: Grid, held: Mask, near: Mask,
    lead: int, run: int, aside: int, back: int, above: Grid,
) -> None:  # fmt: skip
    """How far cells of ends stand above the ground on both sides."""
    rows, columns = dtm.shape
    length = np.zeros(DIRECTIONS, np.int64)
    for r in range(rows):
        for c in range(columns):
            if not near[r, c] or np.isnan(dtm[r, c]):
                continue
            for k in range(DIRECTIONS):
                angle = 2.0 * np.pi * k / DIRECTIONS
                north, east = np.sin(angle), np.cos(angle)
                length[k] = _length(dtm, lowest, held, r, c, north, east, lead, run)
            for k in range(DIRECTIONS):
                # Across a deck it is shorter.
                if length[k] < run or length[k] < length.max():
                    continue
                angle = 2.0 * np.pi * k / DIRECTIONS
                north, east = np.sin(angle), np.cos(angle)
                lower = _lower_aside(dtm, held, r, c, north, east, aside)
                if lower < LOWER_M or lower <= above[r, c]:
                    continue
                if _meets_ground(dtm, held, r, c, north, east, aside, back):
                    above[r, c] = lower


@njit()
def _length(
    dtm: Grid, lowest: Grid, held: Mask, row: int, column: int, north: float, east: float,
    lead: int, run: int,
) -> int:  # fmt: skip
    """Steps for which something level goes on from an end without ground, and above the model."""
    height, bare, high = dtm[row, column], 0, False
    for k in range(1, lead + LONG * run + 1):
        r, c = row + int(np.rint(k * north)), column + int(np.rint(k * east))
        if r < 0 or c < 0 or r >= dtm.shape[0] or c >= dtm.shape[1] or bare == LONG * run:
            break
        if held[r, c]:
            if bare > 0 or k > lead or not abs(dtm[r, c] - height) <= LEVEL_M:
                break
            continue
        if not abs(lowest[r, c] - height) <= LEVEL_M:
            break
        bare += 1
        high = high or lowest[r, c] - dtm[r, c] >= ABOVE_M
    return bare if high else 0


@njit()
def _lower_aside(
    dtm: Grid, held: Mask, row: int, column: int, north: float, east: float, aside: int
) -> float:
    """How far the ground on both sides lies below a cell, the less of both [m]."""
    least = np.inf
    for side in (-1, 1):
        most = 0.0
        for k in range(1, aside + 1):
            r = row - int(np.rint(side * k * east))
            c = column + int(np.rint(side * k * north))
            if r < 0 or c < 0 or r >= dtm.shape[0] or c >= dtm.shape[1]:
                break
            if held[r, c]:
                most = max(most, dtm[row, column] - dtm[r, c])
        least = min(least, most)
    return least


@njit()
def _meets_ground(
    dtm: Grid, held: Mask, row: int, column: int, north: float, east: float, aside: int, back: int
) -> bool:
    """Whether level ground lies behind a cell that none on both sides is much lower than."""
    for k in range(1, back + 1):
        r, c = row - int(np.rint(k * north)), column - int(np.rint(k * east))
        if r < 0 or c < 0 or r >= dtm.shape[0] or c >= dtm.shape[1]:
            return False
        if held[r, c]:
            if abs(dtm[r, c] - dtm[row, column]) > LEVEL_M:
                return False
            if _lower_aside(dtm, held, r, c, north, east, aside) < LOWER_M / 2:
                return True
    return False
