"""Ends of decks that an opening leaves."""

import numpy as np
import pytest
from numpy.typing import NDArray

from spl_batch.airborne.ground.decks import on_decks
from spl_batch.airborne.ground.ground_methods import ground_mask
from spl_batch.airborne.settings import GroundSettings
from spl_batch.lattice.tables import PointTable

Float = NDArray[np.float64]


def cut_at(height: Float, row: int, column: int) -> bool:
    """Whether a node of a grid of ground, one in each cell of a metre, is taken off."""
    rows, columns = height.shape
    y, x = np.mgrid[:rows, :columns] + 0.5
    xyz = np.column_stack([x.ravel(), y.ravel(), height.ravel()])
    grid = np.arange(height.size).reshape(height.shape)
    every = np.ones(height.size, np.bool_)
    return bool(on_decks(xyz, grid, grid, every, 1.0)[grid[row, column]])


def decks_of(height: Float, ground: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Cells of decks, of a node in each cell of a metre."""
    y, x = np.indices(height.shape) + 0.5
    xyz = np.column_stack([x.ravel(), y.ravel(), height.ravel()])
    grid = np.arange(height.size).reshape(height.shape)
    found: NDArray[np.bool_] = on_decks(xyz, grid, grid, ground.ravel(), 1.0)[grid]
    return found


def across(profile: Float) -> Float:
    """The same heights along each row."""
    return np.tile(profile, (50, 1))


AWAY = np.abs(np.arange(60) - 30.0)


@pytest.mark.parametrize(
    ("profile", "cut"),
    [
        (5.0 * (AWAY < 9), True),
        (5.0 * (AWAY < 15), False),
        (5.0 * (AWAY < 1), False),
        (1.9 * (AWAY < 9), False),
        (5.0 * (np.arange(60) > 25), False),
        (-1.7 * AWAY, False),
        (-0.7 * np.maximum(AWAY - 6, 0), False),
    ],
    ids=["deck", "too wide", "wall", "too low", "rim", "ridge of 60 degrees", "bank"],
)
def test_level_between_two_sharp_falls_is_a_deck(profile: Float, *, cut: bool) -> None:
    assert cut_at(across(profile), 25, 30) is cut
    assert cut_at(across(profile).T.copy(), 30, 25) is cut


@pytest.mark.parametrize("turn_deg", [0.0, 20.0, 45.0])
def test_a_deck_of_any_direction_is_cut_to_where_it_lies_a_metre_above_the_ground(
    turn_deg: float,
) -> None:
    y, x = np.indices((70, 70)) - 34.5
    turn = np.radians(turn_deg)
    along, aside = x * np.cos(turn) + y * np.sin(turn), y * np.cos(turn) - x * np.sin(turn)
    valley = -np.clip(15.0 - np.abs(along), 0.0, 6.0)
    deck = (np.abs(along) < 17.0) & (np.abs(aside) < 7.5)
    height = np.where(deck, 0.0, valley)
    hole = tuple(np.argwhere(deck & (np.abs(along) < 1) & (np.abs(aside) < 1))[0])
    height[hole] = 0.2
    found = decks_of(height, np.ones_like(deck))
    inside = deck & (np.abs(aside) < 6.5)
    assert found[inside & (valley < -2.5)].all()
    # Aslant the sides are seen up to an eighth of a turn off.
    assert found[inside & (valley < -1.5)].mean() > (0.9 if turn_deg == 20.0 else 0.99)
    assert not found[~deck | (valley == 0.0)].any()


def test_an_end_goes_on_from_a_deck_alone() -> None:
    bank = 1.2 * (AWAY < 8)
    deck = 5.0 * (AWAY < 8)
    height = np.tile(bank, (50, 1))
    assert not decks_of(height, np.ones_like(height, np.bool_)).any()
    height[20:] += 5.0 - 1.2
    height[20:] = np.tile(deck, (30, 1))
    height[:20] += 5.0 - 1.2
    found = decks_of(height, np.ones_like(height, np.bool_))
    assert found[25, 30]
    assert found[15, 30]
    assert not found[5, 30]


def test_a_wide_deck_over_a_valley_with_slopes_is_no_ground() -> None:
    rng = np.random.default_rng(3)
    x, y = rng.uniform(0, 100, (2, 40_000))
    ground = -np.clip(0.7 * (24 - np.abs(x - 50)), 0, 12)
    aside = y - 50 - 0.15 * (x - 50)
    deck = (np.abs(x - 50) < 30) & (np.abs(aside) < 9)
    z = np.where(deck, 0.0, ground) + rng.normal(0, 0.03, len(x))
    columns = {
        name: np.rint(1000 * v).astype(np.int64) for name, v in zip("xyz", (x, y, z), strict=True)
    }
    found = ground_mask(PointTable(columns), np.ones(len(x), np.bool_), GroundSettings())
    above = deck & (ground < -3.0)
    assert found[above].mean() < 0.05
    assert found[~deck & (np.abs(aside) < 25)].mean() > 0.97
