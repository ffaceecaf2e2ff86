"""Ends of decks that stayed ground, while the middle was cut off."""

import functools
import itertools

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage

from spl_batch.airborne.products.doubts.deck_ends import (
    ABOVE_M,
    ASIDE_M,
    BACK_M,
    DIRECTIONS,
    LEAD_M,
    LEAST_M2,
    LEVEL_M,
    LONG,
    LOWER_M,
    RUN_M,
    deck_ends,
)

Grid = NDArray[np.float64]
Mask = NDArray[np.bool_]


def bridge(turn_deg: float, kept_m: float, bank_m: float = 0.0) -> tuple[Grid, Grid, Mask]:
    """Terrain, lowest signal and ground of a valley; of its deck, 5 m wide, ends stayed ground.

    ``bank_m``: width of a bank that leads to the deck on both sides, in a plain.
    """
    y, x = np.indices((56, 56)) - 27.5
    turn = np.radians(turn_deg)
    along, aside = x * np.cos(turn) + y * np.sin(turn), y * np.cos(turn) - x * np.sin(turn)
    true = np.clip(abs(along) - 12.0, -8.0, 0.0)
    if bank_m:
        true = np.where((abs(aside) <= bank_m / 2) & (abs(along) > 12.0), 0.0, -8.0)
    deck = (abs(aside) <= 2.5) & (abs(along) < 13.0)
    kept = deck & (abs(along) >= 12.0 - kept_m)
    held = ~deck | kept
    dtm = np.where(kept, 0.0, true)
    return dtm, np.where(deck, 0.0, true), held


@functools.cache
def steps_along(angle: float, steps: int) -> list[tuple[int, int]]:
    """Rows and columns on the way from a cell."""
    return [(round(k * np.sin(angle)), round(k * np.cos(angle))) for k in range(1, steps + 1)]


class ByHand:
    """The same in plain words, in cells of a metre."""

    def __init__(self, dtm: Grid, lowest: Grid, held: Mask) -> None:
        self.dtm, self.lowest, self.held = dtm, lowest, held

    def way(self, row: int, column: int, angle: float, steps: float) -> list[tuple[int, int]]:
        places = ((row + r, column + c) for r, c in steps_along(angle, int(steps)))
        return list(itertools.takewhile(lambda p: min(p) >= 0 and max(p) < len(self.dtm), places))

    def lower(self, row: int, column: int, angle: float) -> float:
        sides = (self.way(row, column, angle + side * np.pi / 2, ASIDE_M) for side in (-1, 1))
        z = self.dtm[row, column]
        return min(max([0.0, *(z - self.dtm[p] for p in way if self.held[p])]) for way in sides)

    def length(self, row: int, column: int, angle: float) -> int:
        z = self.dtm[row, column]
        places = self.way(row, column, angle, LEAD_M + LONG * RUN_M)
        lead = list(itertools.takewhile(lambda p: self.held[p], places))
        deck = list(
            itertools.takewhile(
                lambda p: not self.held[p] and abs(self.lowest[p] - z) <= LEVEL_M,
                places[len(lead) :],
            )
        )[: int(LONG * RUN_M)]
        if len(lead) > LEAD_M or any(abs(self.dtm[p] - z) > LEVEL_M for p in lead):
            return 0
        return len(deck) if any(self.lowest[p] - self.dtm[p] >= ABOVE_M for p in deck) else 0

    def meets(self, row: int, column: int, angle: float) -> bool:
        z = self.dtm[row, column]
        ground = [p for p in self.way(row, column, angle + np.pi, BACK_M) if self.held[p]]
        level = itertools.takewhile(lambda p: abs(self.dtm[p] - z) <= LEVEL_M, ground)
        return any(self.lower(*p, angle) < LOWER_M / 2 for p in level)

    def above(self, row: int, column: int) -> float:
        angles = 2 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
        lengths = [self.length(row, column, angle) for angle in angles]
        most = max(lengths)
        found = [
            self.lower(row, column, angle)
            for angle, length in zip(angles, lengths, strict=True)
            if length == most >= RUN_M and self.meets(row, column, angle)
        ]
        return max([0.0, *(lower for lower in found if lower >= LOWER_M)])

    def touches(self, mine: Mask) -> bool:
        return any(
            not self.held[r, c] and self.lowest[r, c] - self.dtm[r, c] >= LEVEL_M
            for row, column in np.argwhere(mine).tolist()
            for r in range(max(row - 1, 0), min(row + 2, len(mine)))
            for c in range(max(column - 1, 0), min(column + 2, mine.shape[1]))
        )

    def ends(self) -> list[tuple[float, int, int, float]]:
        above = np.zeros(self.dtm.shape)
        for row, column in np.argwhere(self.held).tolist():
            above[row, column] = self.above(row, column)
        numbers, many = ndimage.label(above > 0, np.ones((3, 3)))
        found = []
        for number in range(1, many + 1):
            tall = np.where(numbers == number, above, 0.0)
            if (tall > 0).sum() >= LEAST_M2 and self.touches(tall > 0):
                row, column = np.unravel_index(tall.argmax(), tall.shape)
                found.append((float((tall > 0).sum()), int(row), int(column), float(tall.max())))
        return found


@pytest.mark.parametrize("turn_deg", [0.0, 20.0, 45.0])
def test_both_ends_of_a_deck_are_found_with_how_far_they_stand_above_the_slope(turn_deg):
    found = list(deck_ends(*bridge(turn_deg, 3.0), 1.0))
    assert len(found) == 2
    for end in found:
        assert 1.5 <= end.height_m <= 4.0
        assert 2.0 <= end.area_m2 <= 30.0
        assert end.cells.shape == (2, int(end.area_m2))
        away = np.hypot(end.row - 27.5, end.column - 27.5)
        assert 8.0 <= away <= 13.0


@pytest.mark.parametrize("turn_deg", [0.0, 20.0, 45.0])
def test_a_deck_that_was_cut_off_whole_has_no_end_and_neither_has_one_between_banks(turn_deg):
    assert list(deck_ends(*bridge(turn_deg, 0.0), 1.0)) == []
    assert list(deck_ends(*bridge(turn_deg, 0.0, bank_m=5.0), 1.0)) == []


def test_what_goes_on_at_another_height_or_beside_level_ground_is_none():
    dtm, lowest, held = bridge(0.0, 3.0)
    roof = np.where(held, lowest, lowest + 2 * LEVEL_M)
    assert list(deck_ends(dtm, roof, held, 1.0)) == []
    plain = np.where(held, 0.0, dtm)
    assert list(deck_ends(plain, np.where(held, plain, lowest), held, 1.0)) == []


def test_an_end_of_a_single_cell_is_told():
    dtm, lowest, held = bridge(0.0, 0.0)
    row, column = 27, 37
    assert lowest[row, column] - dtm[row, column] > 2.0
    dtm[row, column], held[row, column] = 0.0, True
    (end,) = deck_ends(dtm, lowest, held, 1.0)
    assert (end.row, end.column, end.area_m2) == (row, column, 1.0)


def test_raised_cells_that_do_not_touch_what_was_cut_off_are_no_end():
    dtm, lowest, held = bridge(0.0, 2.0)
    assert len(list(deck_ends(dtm, lowest, held, 1.0))) == 2
    # Level ground between the ends and the rest of the deck.
    rim = abs(abs(np.indices(dtm.shape)[1] - 27.5) - 8.0) <= 1.5
    dtm, lowest = np.where(rim, 0.0, dtm), np.where(rim, 0.0, lowest)
    assert ByHand(dtm, lowest, held | rim).above(27, 16) >= LOWER_M
    assert list(deck_ends(dtm, lowest, held | rim, 1.0)) == []


@pytest.mark.parametrize("seed", range(2))
def test_ends_agree_with_looking_along_each_direction_in_plain_words(seed):
    rng = np.random.default_rng(seed)
    dtm, lowest, held = bridge(float(rng.uniform(0, 90)), 3.0)
    dtm, lowest = (grid + rng.normal(0, 0.15, grid.shape) for grid in (dtm, lowest))
    held &= rng.random(held.shape) < 0.9
    mine = slice(6, 50), slice(6, 50)
    some = tuple(np.ascontiguousarray(grid[mine]) for grid in (dtm, lowest, held))
    found = [(e.area_m2, e.row, e.column, e.height_m) for e in deck_ends(*some, 1.0)]
    assert found == ByHand(*some).ends()
    assert found
