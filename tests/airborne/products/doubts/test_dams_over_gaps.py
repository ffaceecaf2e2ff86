"""Dams that a terrain model builds where a bridge was cut off."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage
from scipy.interpolate import griddata

from spl_batch.airborne.products.doubts.dams_over_gaps import (
    ABOVE_M,
    AWAY_M,
    AXES,
    BEYOND_M,
    DECK_M,
    FALL_M,
    LEAST_M2,
    REACH_M,
    dams_over_gaps,
)
from spl_batch.airborne.products.doubts.raised_places import RaisedPlace

Grid = NDArray[np.float64]
Mask = NDArray[np.bool_]


def places(turn_deg: float) -> tuple[Grid, Grid]:
    """Places along a bridge and aside of it [m]."""
    y, x = np.indices((60, 60)) - 29.5
    turn = np.radians(turn_deg)
    return x * np.cos(turn) + y * np.sin(turn), y * np.cos(turn) - x * np.sin(turn)


def spanned(height: Grid, gap: Mask) -> tuple[Grid, Grid]:
    """Terrain by triangles across a gap, and the distance to the ground."""
    held = np.argwhere(~gap)
    # No three on a line, no four on a circle.
    jitter = np.random.default_rng(1).normal(0, 1e-3, held.shape)
    dtm: Grid = griddata(held + jitter, height[~gap], tuple(np.indices(gap.shape)))
    return np.where(gap, dtm, height), ndimage.distance_transform_edt(gap)


def found_below(deck_m: float, dtm: Grid, away_m: Grid) -> list[RaisedPlace]:
    """Dams where the gap is hidden by what lies at a height."""
    return list(dams_over_gaps(dtm, np.where(away_m > 0, deck_m, dtm), away_m, 1.0))


def dams_by_hand(dtm: Grid, away_m: Grid) -> list[tuple[float, int, int, float]]:
    """Area, place and height of the same in plain words, below a deck at zero."""

    def ground(row: int, column: int, angle: float) -> tuple[float, float]:
        heights, held = [], []
        for k in range(1, int(REACH_M + BEYOND_M) + 1):
            r, c = row + round(k * np.sin(angle)), column + round(k * np.cos(angle))
            if not (0 <= r < len(dtm) and 0 <= c < len(dtm)) or np.isnan(dtm[r, c]):
                break
            heights.append(float(dtm[r, c]))
            held.append(away_m[r, c] == 0.0)
        first = held.index(True) if any(held) else len(held)
        if first >= REACH_M or first + BEYOND_M >= len(held):
            return np.nan, np.nan
        return heights[first], heights[first] - heights[first + int(BEYOND_M)]

    above = np.zeros(dtm.shape)
    for r, c in np.argwhere((away_m > 0) & ~np.isnan(dtm)):
        for k in range(AXES):
            one, ahead, two, behind = (
                ground(r, c, np.pi * k / AXES + turn * np.pi / 2) for turn in range(4)
            )
            crest = np.minimum(one[1], two[1]) > FALL_M
            low, high = np.fmin(ahead[0], behind[0]), np.fmax(ahead[0], behind[0])
            if not crest and low >= dtm[r, c] - ABOVE_M / 2 and high + DECK_M >= 0.0:
                above[r, c] = np.fmax(above[r, c], dtm[r, c] - np.maximum(one[0], two[0]))
    numbers, many = ndimage.label(above >= ABOVE_M, np.ones((3, 3)))
    found = []
    for number in range(1, many + 1):
        mine = numbers == number
        tall = np.where(mine, above, 0.0)
        if mine.sum() >= LEAST_M2 and tall.max() >= 1.5 * ABOVE_M and away_m[mine].max() >= AWAY_M:
            row, column = np.unravel_index(tall.argmax(), tall.shape)
            found.append((float(mine.sum()), int(row), int(column), float(tall.max())))
    return found


@pytest.mark.parametrize("turn_deg", [0.0, 20.0, 45.0])
def test_a_gap_below_a_bridge_that_triangles_span_is_a_dam(turn_deg: float) -> None:
    along, aside = places(turn_deg)
    valley = -np.clip(11.0 - np.abs(along), 0.0, 6.0)
    gap = (np.abs(along) < 10.5) & (np.abs(aside) < 8)
    dtm, away = spanned(valley, gap)
    found = found_below(0.0, dtm, away)
    assert found
    for dam in found:
        assert gap[dam.row, dam.column]
        assert dam.height_m < 6.0
    assert [dam[:4] for dam in found] == dams_by_hand(dtm, away)
    assert found_below(4.0, dtm, away) == []  # a house


def test_gaps_of_slopes_ridges_and_filled_valleys_are_none() -> None:
    along, aside = places(20.0)
    gap = (np.abs(along) < 10.5) & (np.abs(aside) < 8)
    valley = -np.clip(11.0 - np.abs(along), 0.0, 6.0)
    for height, hidden in (
        (0.7 * along, gap),
        (-0.7 * np.abs(along), gap),
        (valley, (np.abs(aside) < 2.0) & gap),
        (valley, np.random.default_rng(2).random(along.shape) < 0.6),
    ):
        assert list(found_below(0.0, *spanned(height, hidden))) == []


def test_what_ends_in_a_void_is_none() -> None:
    along, aside = places(0.0)
    valley = -np.clip(11.0 - np.abs(along), 0.0, 6.0)
    dtm, away = spanned(valley, (np.abs(along) < 10.5) & (np.abs(aside) < 8))
    dtm[aside > 8] = np.nan
    assert found_below(0.0, dtm, away) == []
