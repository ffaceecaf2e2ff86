"""Dams that a terrain model builds across a valley where a bridge was cut off.

Below a deck that was cut off there is no ground return. Triangles span the gap, and those from one
end of the deck to the other stand above the floor as a dam does. The gap shows it: across the deck
the ground is lower on both sides than the model between them, along it the ground is as high or
higher, and what hides the floor is no higher than that: roofs and crowns are. From a crest that is
hidden the ground falls on beyond the gap, on both sides; a valley's floor does not. A bank between
walls looks the same if it was cut off. Nothing is changed. Our own rule: no source has one.
"""

from collections.abc import Iterator
from typing import Final

import numpy as np

from spl_batch.airborne.products.doubts.raised_places import (
    Grid,
    Mask,
    RaisedPlace,
    raised_places,
)
from spl_batch.numerics.compiled import njit

DOMAIN: Final = "space"

REACH_M: Final = 16.0
"""How far off the ground on each side may lie [m]."""

ABOVE_M: Final = 0.6
"""How far the model stands above the ground on both sides at least, and a dam somewhere by half as
much more [m]."""

DECK_M: Final = 1.0
"""What hides the floor lies no farther above the ground at its ends [m]."""

BEYOND_M: Final = 4.0
FALL_M: Final = 1.0
"""Ground that falls by more, so far beyond the gap, is a crest's side [m, m]."""

LEAST_M2: Final = 8.0
AWAY_M: Final = 2.0
"""Smaller dams are not told, nor such as ground lies nearer to everywhere: a narrow deck is twice
as wide [m2, m]."""

AXES: Final = 8
"""Directions across a dam that are tried [count]."""


def dams_over_gaps(dtm: Grid, lowest: Grid, away_m: Grid, cell_m: float) -> Iterator[RaisedPlace]:
    """Dams of a terrain model, row by row.

    Parameters
    ----------
    dtm : (rows, columns) float64
        Terrain [m]; NaN where it is void.
    lowest : (rows, columns) float64
        Height of the lowest signal [m]; NaN without any.
    away_m : (rows, columns) float64
        Distance to the nearest cell with ground [m].
    cell_m : float
        Edge of a cell [m].
    """
    if not (away_m >= AWAY_M).any():
        return
    above = np.zeros(dtm.shape)
    _measure(dtm, lowest, away_m == 0.0, REACH_M / cell_m, round(BEYOND_M / cell_m), above)
    for dam in raised_places(above, above >= ABOVE_M, cell_m):
        if dam.area_m2 < LEAST_M2 or dam.height_m < 1.5 * ABOVE_M:
            continue
        if away_m[dam.cells[0], dam.cells[1]].max() >= AWAY_M:
            yield dam


@njit()
def _measure(dtm: Grid, lowest: Grid, held: Mask, reach: float, beyond: int, above: Grid) -> None:
    """How far cells without ground stand above that on both sides, where it is no lower ahead."""
    rows, columns = dtm.shape
    for r in range(rows):
        for c in range(columns):
            if held[r, c] or np.isnan(dtm[r, c]) or np.isnan(lowest[r, c]):
                continue
            for k in range(AXES):
                north, east = np.sin(np.pi * k / AXES), np.cos(np.pi * k / AXES)
                one, fall_one = _next_ground(dtm, held, r, c, north, east, reach, beyond)
                two, fall_two = _next_ground(dtm, held, r, c, -north, -east, reach, beyond)
                if np.isnan(one) or np.isnan(two) or min(fall_one, fall_two) > FALL_M:
                    continue
                tall = dtm[r, c] - max(one, two)
                if tall <= above[r, c]:
                    continue
                ahead, _ = _next_ground(dtm, held, r, c, east, -north, reach, beyond)
                behind, _ = _next_ground(dtm, held, r, c, -east, north, reach, beyond)
                # One end of a long deck may be out of reach.
                ahead = behind if np.isnan(ahead) else ahead
                behind = ahead if np.isnan(behind) else behind
                if np.isnan(ahead) or min(ahead, behind) < dtm[r, c] - ABOVE_M / 2:
                    continue
                if lowest[r, c] <= max(ahead, behind) + DECK_M:
                    above[r, c] = tall


@njit()
def _next_ground(
    dtm: Grid,
    held: Mask,
    row: int,
    column: int,
    north: float,
    east: float,
    reach: float,
    beyond: int,
) -> tuple[float, float]:
    """Height of the nearest ground on the way from a cell, and how far it falls beyond [m, m].

    NaN if a void or none is there.
    """
    rows, columns = dtm.shape
    first = np.nan
    steps, k = int(reach), 0
    while k < steps:
        k += 1
        r, c = row + int(np.rint(k * north)), column + int(np.rint(k * east))
        if r < 0 or c < 0 or r >= rows or c >= columns or np.isnan(dtm[r, c]):
            return np.nan, np.nan
        if np.isnan(first) and held[r, c]:
            first = dtm[r, c]
            steps = k + beyond
    return first, first - dtm[r, c]
